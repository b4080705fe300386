//! Where all runs from all cells end, computed beforehand.
//!
//! Per cell and step one `u16`: its steps, and a bit for whether it ends in a jump point; 16 bytes per cell in all. The run
//! from a cell is one step longer than that from the next cell, so that each direction is one sweep:
//!
//! ```text
//! run(c, s) = 0                    if the step s from c is closed
//!           = 1, jump or dead end  if a run stops in c + s
//!           = 1 + run(c + s, s)    otherwise
//! ```
//!
//! Longer runs than the number can tell end early in a cell that is run on from.

use super::{
    jumps::{Run, Runs},
    masks::Pruning,
    space::GridSpace,
    step::Step,
};
use agv_core::grid::{Cell, CellRect, Revision};
use std::ops::Range;

/// Runs of one cell by step: twice the steps, and one for a jump.
type Record = [u16; 8];

/// Longest run, a multiple of which ends in a jump point.
const LONGEST: u16 = u16::MAX - 1;

/// Runs that are looked up.
#[derive(Debug, Clone, Default)]
pub(super) struct JumpTable {
    seen: Option<Revision>,
    width: usize,
    height: usize,
    strides: [u32; 8],
    records: Vec<Record>,
}

impl JumpTable {
    /// Follows the space: straight runs along the rows and columns that changed, and all diagonal ones.
    pub(super) fn update(&mut self, space: &GridSpace) {
        let Some(layout) = space.layout() else { return };
        let (width, height) = (layout.width(), layout.height());
        let same_size = (width, height) == (self.width, self.height);
        let whole = CellRect::whole(width, height);
        let seen = self.seen.replace(space.revision().clone()).filter(|_| same_size);
        let Some(CellRect { min, max }) = seen.map_or(Some(whole), |seen| space.changed_since(&seen)) else { return };
        if !same_size {
            (self.width, self.height, self.strides) = (width, height, space.strides());
            self.records.clear();
            self.records.resize(layout.len(), Record::default());
        }
        let (rows, columns) = (min.y as usize..max.y as usize + 1, min.x as usize..max.x as usize + 1);
        for step in [Step::EAST, Step::WEST] {
            let ends = straight_ends(space.canonical(), step);
            self.sweep(space.masks(), step, (0..width, rows.clone()), |_, mask| ends[mask as usize]);
        }
        for step in [Step::NORTH, Step::SOUTH] {
            let ends = straight_ends(space.canonical(), step);
            self.sweep(space.masks(), step, (columns.clone(), 0..height), |_, mask| ends[mask as usize]);
        }
        for step in &Step::ALL[4..] {
            let sides = [Step::towards(step.dx(), 0), Step::towards(0, step.dy())];
            let ends = diagonal_ends(space.canonical(), *step, sides);
            self.sweep(space.masks(), *step, (0..width, 0..height), |record, mask| {
                // A closed side's run has no steps, and no jump.
                if sides.iter().any(|side| record[side.index() & 7] & 1 != 0) { Some(1) } else { ends[mask as usize] }
            });
        }
    }

    /// One direction of the cells in `columns` and `rows`; `end` says of a cell that is arrived at what stops the run there:
    /// something to do (1), a dead end (0) or nothing.
    #[inline]
    fn sweep(
        &mut self,
        masks: &[u8],
        step: Step,
        (columns, rows): (Range<usize>, Range<usize>),
        end: impl Fn(&Record, u8) -> Option<u16>,
    ) {
        let (slot, bit, stride) = (step.index() & 7, step.bit(), self.strides[step.index() & 7]);
        for i in 0..rows.len() {
            let y = if step.dy() > 0 { rows.end - 1 - i } else { rows.start + i };
            for k in 0..columns.len() {
                let x = if step.dx() > 0 { columns.end - 1 - k } else { columns.start + k };
                let node = y * self.width + x;
                let run = if masks[node] & bit == 0 {
                    0
                } else {
                    let next = (node as u32).wrapping_add(stride) as usize;
                    let record = &self.records[next];
                    match end(record, masks[next]) {
                        Some(jump) => 2 | jump,
                        None if record[slot] < LONGEST => record[slot] + 2,
                        None => 2 | 1,
                    }
                };
                self.records[node][slot] = run;
            }
        }
    }

    #[inline]
    fn record(&self, cell: Cell) -> Record {
        self.records.get(cell.y as usize * self.width + cell.x as usize).copied().unwrap_or_default()
    }
}

#[inline]
fn run(record: &Record, step: Step) -> Run {
    let run = record[step.index() & 7];
    Run { steps: u32::from(run >> 1), is_jump: run & 1 != 0 }
}

impl Runs for JumpTable {
    #[inline]
    fn straight(&self, at: Cell, step: Step) -> Run {
        run(&self.record(at), step)
    }

    #[inline]
    fn diagonal(&self, at: Cell, step: Step) -> (Run, [Run; 2]) {
        let diagonal = run(&self.record(at), step);
        if !diagonal.is_jump {
            return (diagonal, [Run::default(); 2]);
        }
        let (columns, rows) = (step.dx() * diagonal.steps as i32, step.dy() * diagonal.steps as i32);
        let turn = self.record(Cell::new(at.x + columns, at.y + rows));
        (diagonal, [run(&turn, Step::towards(step.dx(), 0)), run(&turn, Step::towards(0, step.dy()))])
    }
}

/// By mask of the cell that is arrived at, what stops a straight run there.
fn straight_ends(pruning: &Pruning, step: Step) -> [Option<u16>; 256] {
    tabulate(|mask| {
        let successors = pruning.successors(step, mask);
        (successors != step.bit()).then_some(u16::from(successors != 0))
    })
}

/// By mask of the cell that is arrived at, what stops a diagonal run there, if no straight run to the sides does.
fn diagonal_ends(pruning: &Pruning, step: Step, sides: [Step; 2]) -> [Option<u16>; 256] {
    let natural = step.bit() | sides[0].bit() | sides[1].bit();
    tabulate(|mask| {
        let successors = pruning.successors(step, mask);
        if successors & !natural != 0 {
            Some(1)
        } else if successors & step.bit() == 0 {
            Some(0)
        } else {
            None
        }
    })
}

fn tabulate(end: impl Fn(u8) -> Option<u16>) -> [Option<u16>; 256] {
    let mut ends = [None; 256];
    for (mask, slot) in (0..=u8::MAX).zip(ends.iter_mut()) {
        *slot = end(mask);
    }
    ends
}
