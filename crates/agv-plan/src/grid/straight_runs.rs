//! Where straight runs end, as bits: found 64 cells at a time.
//!
//! For each straight step two bits per cell: whether a run that arrives by that step *stops* in the cell (it has successors
//! other than the next cell ahead), and whether it stops for a jump point or in a dead end. Bits of eastward and westward runs
//! lie row by row, those of northward and southward runs column by column, so that a run is a scan of words along its line.
//! One byte per cell in all. The rule of corners is in the bits (as [`Pruning`] has it); blocks of 64 x 64 cells are derived
//! anew where the space has changed.

use super::{
    jumps::{Run, Runs},
    masks::Pruning,
    space::GridSpace,
    step::Step,
};
use agv_core::grid::{Cell, Revision};

/// Cells along a side of a block.
const BLOCK: usize = 64;

/// A word of 64 cells of a line.
#[derive(Debug, Clone, Copy, Default)]
struct Word {
    stops: u64,
    jumps: u64,
}

/// Runs that are scanned for.
#[derive(Debug, Clone, Default)]
pub(super) struct StraightRuns {
    seen: Option<Revision>,
    width: usize,
    height: usize,
    /// By straight step: words of its lines.
    lines: [Vec<Word>; 4],
    /// Words per row, and per column.
    words: [usize; 2],
}

impl StraightRuns {
    /// Follows the space and scans it.
    pub(super) fn scan<'a>(&'a mut self, space: &'a GridSpace) -> Scan<'a> {
        self.update(space);
        Scan { runs: self, masks: space.masks(), strides: space.strides() }
    }

    fn update(&mut self, space: &GridSpace) {
        let Some(layout) = space.layout() else { return };
        let (width, height) = (layout.width(), layout.height());
        let same_size = (width, height) == (self.width, self.height);
        let Some(changed) = space.follow(&mut self.seen) else { return };
        if !same_size {
            (self.width, self.height) = (width, height);
            self.words = [width.div_ceil(BLOCK), height.div_ceil(BLOCK)];
            for (index, lines) in self.lines.iter_mut().enumerate() {
                let len = if index.is_multiple_of(2) { height * self.words[0] } else { width * self.words[1] };
                lines.clear();
                lines.resize(len, Word::default());
            }
        }
        let flags = flags(space.canonical());
        for block_y in changed.min.y as usize / BLOCK..=changed.max.y as usize / BLOCK {
            for block_x in changed.min.x as usize / BLOCK..=changed.max.x as usize / BLOCK {
                self.derive_block(space.masks(), (block_x, block_y), &flags);
            }
        }
    }

    fn derive_block(&mut self, masks: &[u8], (block_x, block_y): (usize, usize), flags: &[u8; 256]) {
        let (x0, y0) = (block_x * BLOCK, block_y * BLOCK);
        let (columns, rows) = ((self.width - x0).min(BLOCK), (self.height - y0).min(BLOCK));
        // By flag: bit x of word y.
        let mut bits = [[0_u64; BLOCK]; 8];
        for y in 0..rows {
            let masks = &masks[(y0 + y) * self.width + x0..][..columns];
            for (index, eight) in masks.chunks(8).enumerate() {
                let mut bytes = [0; 8];
                for (byte, &mask) in bytes.iter_mut().zip(eight) {
                    *byte = flags[mask as usize];
                }
                for (words, byte) in bits.iter_mut().zip(transpose_bytes(bytes)) {
                    words[y] |= u64::from(byte) << (8 * index);
                }
            }
        }
        for step in 0..4 {
            let (mut stops, mut jumps) = (bits[step], bits[step + 4]);
            let (first, count, stride, word) = if step.is_multiple_of(2) {
                (y0, rows, self.words[0], block_x)
            } else {
                (x0, columns, self.words[1], block_y)
            };
            if !step.is_multiple_of(2) {
                transpose(&mut stops);
                transpose(&mut jumps);
            }
            for line in 0..count {
                self.lines[step][(first + line) * stride + word] = Word { stops: stops[line], jumps: jumps[line] };
            }
        }
    }

    /// The scan ahead from the cell after `at` on, along a line of `words`.
    #[inline]
    fn ahead(words: &[Word], at: u32) -> Run {
        let from = at + 1;
        let mut index = (from / 64) as usize;
        let mut mask = u64::MAX << (from % 64);
        while let Some(word) = words.get(index) {
            let stops = word.stops & mask;
            if stops != 0 {
                let bit = stops.trailing_zeros();
                return Run { steps: index as u32 * 64 + bit - at, is_jump: word.jumps >> bit & 1 != 0 };
            }
            mask = u64::MAX;
            index += 1;
        }
        Run::default()
    }

    /// The scan back from the cell before `at` on.
    #[inline]
    fn back(words: &[Word], at: u32) -> Run {
        let Some(from) = at.checked_sub(1) else { return Run::default() };
        let mut index = (from / 64) as usize;
        let mut mask = u64::MAX >> (63 - from % 64);
        while let Some(word) = words.get(index) {
            let stops = word.stops & mask;
            if stops != 0 {
                let bit = stops.ilog2();
                return Run { steps: at - (index as u32 * 64 + bit), is_jump: word.jumps >> bit & 1 != 0 };
            }
            mask = u64::MAX;
            index = index.wrapping_sub(1);
        }
        Run::default()
    }

    #[inline]
    fn line(&self, step: Step, line: i32) -> &[Word] {
        let stride = self.words[step.index() & 1];
        let first = line as usize * stride;
        self.lines[step.index() & 3].get(first..first + stride).unwrap_or(&[])
    }

    #[inline]
    fn straight(&self, at: Cell, step: Step) -> Run {
        match step {
            Step::EAST => Self::ahead(self.line(step, at.y), at.x as u32),
            Step::WEST => Self::back(self.line(step, at.y), at.x as u32),
            Step::NORTH => Self::ahead(self.line(step, at.x), at.y as u32),
            _ => Self::back(self.line(step, at.x), at.y as u32),
        }
    }
}

/// Runs of a space: the straight ones are scanned for in words, the diagonal ones step by step through the masks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scan<'a> {
    runs: &'a StraightRuns,
    masks: &'a [u8],
    strides: [u32; 8],
}

impl Runs for Scan<'_> {
    #[inline]
    fn straight(&self, at: Cell, step: Step) -> Run {
        self.runs.straight(at, step)
    }

    #[inline]
    fn diagonal(&self, at: Cell, step: Step) -> (Run, [Run; 2]) {
        match step {
            Step::NORTH_EAST => self.diagonal_towards::<1, 1>(at),
            Step::NORTH_WEST => self.diagonal_towards::<-1, 1>(at),
            Step::SOUTH_WEST => self.diagonal_towards::<-1, -1>(at),
            _ => self.diagonal_towards::<1, -1>(at),
        }
    }
}

impl Scan<'_> {
    #[inline]
    fn diagonal_towards<const DX: i32, const DY: i32>(&self, at: Cell) -> (Run, [Run; 2]) {
        let step = const { Step::towards(DX, DY) };
        let sides = const { [Step::towards(DX, 0), Step::towards(0, DY)] };
        let behind = const { Step::towards(-DX, 0).bit() | Step::towards(0, -DY).bit() };
        let stride = self.strides[step.index() & 7];
        let (mut cell, mut node) = (at, at.y as u32 * self.runs.width as u32 + at.x as u32);
        let mut steps = 0;
        let mut open = self.masks.get(node as usize).is_some_and(|mask| mask & step.bit() != 0);
        while open {
            node = node.wrapping_add(stride);
            cell = Cell::new(cell.x + DX, cell.y + DY);
            steps += 1;
            let mask = self.masks.get(node as usize).copied().unwrap_or(0);
            let scan = |side: Step| if mask & side.bit() == 0 { Run::default() } else { self.straight(cell, side) };
            let side_runs = sides.map(scan);
            // A closed side behind is what may force a neighbour.
            if side_runs[0].is_jump || side_runs[1].is_jump || mask & behind != behind {
                return (Run { steps, is_jump: true }, side_runs);
            }
            open = mask & step.bit() != 0;
        }
        (Run { steps, is_jump: false }, [Run::default(); 2])
    }
}

/// By neighbour mask: a bit per straight step for a run that stops, and four bits further one for a jump point.
fn flags(pruning: &Pruning) -> [u8; 256] {
    let mut flags = [0; 256];
    for (mask, flags) in (0_u8..=255).zip(flags.iter_mut()) {
        for step in &Step::ALL[..4] {
            let successors = pruning.successors(*step, mask);
            *flags |= u8::from(successors != step.bit()) << step.index();
            *flags |= u8::from(successors != step.bit() && successors != 0) << (step.index() + 4);
        }
    }
    flags
}

/// Bit k of byte i becomes bit i of byte k.
fn transpose_bytes(bytes: [u8; 8]) -> [u8; 8] {
    let mut x = u64::from_le_bytes(bytes);
    for (shift, mask) in [(7, 0x00AA_00AA_00AA_00AA), (14, 0x0000_CCCC_0000_CCCC), (28, 0x0000_0000_F0F0_F0F0)] {
        let swapped = (x ^ (x >> shift)) & mask;
        x ^= swapped ^ (swapped << shift);
    }
    x.to_le_bytes()
}

/// Bit x of word y becomes bit y of word x.
fn transpose(words: &mut [u64; BLOCK]) {
    let (mut half, mut mask) = (BLOCK / 2, u64::MAX >> 32);
    while half != 0 {
        for y in (0..BLOCK).filter(|y| y & half == 0) {
            let swapped = ((words[y] >> half) ^ words[y + half]) & mask;
            words[y] ^= swapped << half;
            words[y + half] ^= swapped;
        }
        half /= 2;
        mask ^= mask << half;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Connectivity, CornerRule, GridParams};
    use agv_core::{
        compute::Seed,
        geometry::Se2,
        grid::{Costmap, Grid, GridLayout, cost},
    };
    use rand_distr::{Bernoulli, Distribution};

    #[test]
    fn transposing_swaps_columns_and_rows() {
        let mut words = [0_u64; BLOCK];
        for (y, word) in words.iter_mut().enumerate() {
            *word = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(2 * y as u64 + 1);
        }
        let mut turned = words;
        transpose(&mut turned);
        for (y, word) in words.iter().enumerate() {
            for (x, column) in turned.iter().enumerate() {
                assert_eq!(word >> x & 1, column >> y & 1, "({x}, {y})");
            }
        }
        let bytes = [0x12, 0xFF, 0x00, 0x81, 0x7E, 0x3C, 0xA5, 0x5A];
        let turned = transpose_bytes(bytes);
        assert!((0..8).all(|i| (0..8).all(|k| bytes[i] >> k & 1 == turned[k] >> i & 1)));
    }

    /// Scans of maps wider and higher than a block, against single steps.
    #[test]
    fn scans_end_where_single_steps_do() {
        let mut stream = Seed(5).stream(0, 0);
        for (density, rule) in [(0.002, CornerRule::Never), (0.02, CornerRule::OneFree), (0.2, CornerRule::Free)] {
            let layout = GridLayout::new(150, 131, 1.0, Se2::default()).unwrap();
            let blocked = Bernoulli::new(density).unwrap();
            let costs = (0..layout.len()).map(|_| if blocked.sample(&mut stream) { cost::LETHAL } else { 0 }).collect();
            let mut costmap = Costmap::from_costs(Grid::new(layout, costs).unwrap());
            let params = GridParams { corner_rule: rule, connectivity: Connectivity::Eight, ..Default::default() };
            let (mut space, mut runs) = (GridSpace::new(params).unwrap(), StraightRuns::default());
            for round in 0..3 {
                space.update(&costmap);
                runs.update(&space);
                for node in (0..layout.len() as u32).step_by(7) {
                    for step in Step::ALL.into_iter().take(4).filter(|step| space.mask(node) & step.bit() != 0) {
                        let mut run = Run::default();
                        let mut cell = space.cell(node);
                        loop {
                            cell = step.from(cell);
                            run.steps += 1;
                            let mask = space.mask(space.node(cell).unwrap());
                            let successors = space.canonical().successors(step, mask);
                            run.is_jump = successors != 0;
                            if successors != step.bit() {
                                break;
                            }
                        }
                        assert_eq!(runs.straight(space.cell(node), step), run, "{node} {step:?}, round {round}");
                    }
                }
                costmap.set(Cell::new(70 + round, 60), cost::LETHAL);
            }
        }
    }
}
