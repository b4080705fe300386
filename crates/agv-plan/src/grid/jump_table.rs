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
        let Some(CellRect { min, max }) = space.follow(&mut self.seen) else { return };
        if !same_size {
            (self.width, self.height, self.strides) = (width, height, space.strides());
            self.records.clear();
            self.records.resize(layout.len(), Record::default());
        }
        let (rows, columns) = (min.y as usize..max.y as usize + 1, min.x as usize..max.x as usize + 1);
        let (masks, ends) = (space.masks(), Step::ALL.map(|step| ends(space.canonical(), step)));
        // Towards the rows that are done, so that all runs of a row are made while it is at hand.
        for y in (0..height).rev() {
            if rows.contains(&y) {
                self.sweep_straight(masks, (Step::EAST, &ends[0]), (0..width, y));
                self.sweep_straight(masks, (Step::WEST, &ends[2]), (0..width, y));
            }
            self.sweep_straight(masks, (Step::NORTH, &ends[1]), (columns.clone(), y));
            self.sweep_diagonal(masks, (Step::NORTH_EAST, &ends[4]), y);
            self.sweep_diagonal(masks, (Step::NORTH_WEST, &ends[5]), y);
        }
        for y in 0..height {
            self.sweep_straight(masks, (Step::SOUTH, &ends[3]), (columns.clone(), y));
            self.sweep_diagonal(masks, (Step::SOUTH_WEST, &ends[6]), y);
            self.sweep_diagonal(masks, (Step::SOUTH_EAST, &ends[7]), y);
        }
    }

    fn sweep_straight(&mut self, masks: &[u8], (step, ends): (Step, &Ends), (columns, y): (Range<usize>, usize)) {
        self.sweep(masks, step, (columns, y), |_, mask| ends[mask as usize]);
    }

    fn sweep_diagonal(&mut self, masks: &[u8], (step, ends): (Step, &Ends), y: usize) {
        let sides = [Step::towards(step.dx(), 0), Step::towards(0, step.dy())].map(|side| side.index() & 7);
        // A closed side's run has no steps, and no jump.
        let turns = |record: &Record| (record[sides[0]] | record[sides[1]]) & 1 != 0;
        self.sweep(masks, step, (0..self.width, y), |record, mask| if turns(record) { 1 } else { ends[mask as usize] });
    }

    /// One direction of the cells of a row; `end` says of a cell that is arrived at what stops the run there.
    #[inline]
    fn sweep(
        &mut self,
        masks: &[u8],
        step: Step,
        (columns, y): (Range<usize>, usize),
        end: impl Fn(&Record, u8) -> u16,
    ) {
        let (slot, bit, stride) = (step.index() & 7, step.bit(), self.strides[step.index() & 7]);
        for k in 0..columns.len() {
            let x = if step.dx() > 0 { columns.end - 1 - k } else { columns.start + k };
            let node = y * self.width + x;
            let run = if masks[node] & bit == 0 {
                0
            } else {
                let next = (node as u32).wrapping_add(stride) as usize;
                let record = &self.records[next];
                match end(record, masks[next]) {
                    GOES_ON if record[slot] < LONGEST => record[slot] + 2,
                    GOES_ON => 2 | 1,
                    jump => 2 | jump,
                }
            };
            self.records[node][slot] = run;
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

/// By mask of the cell that is arrived at, what stops a run there: something to do (1), a dead end (0), or nothing.
type Ends = [u16; 256];

const GOES_ON: u16 = 2;

/// What stops runs of a step; diagonal ones, if no straight run to their sides does.
fn ends(pruning: &Pruning, step: Step) -> Ends {
    let sides = Step::towards(step.dx(), 0).bit() | Step::towards(0, step.dy()).bit();
    let natural = if step.is_diagonal() { step.bit() | sides } else { step.bit() };
    let mut ends = [GOES_ON; 256];
    for (mask, end) in (0..=u8::MAX).zip(ends.iter_mut()) {
        let successors = pruning.successors(step, mask);
        if successors & !natural != 0 {
            *end = 1;
        } else if successors & step.bit() == 0 {
            *end = 0;
        }
    }
    ends
}
