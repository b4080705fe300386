//! Which of its eight neighbours a cell may step to, as one byte per cell, and which of them a search need not look at.

use super::step::Step;
use agv_core::grid::{Connectivity, CornerRule};

/// Masks of one row from whether the cells of the row below, the row itself and the row above are passable (0 or 1).
///
/// The inputs are padded by a zero on both sides, so they are two longer than `masks`.
pub(super) fn row_masks(
    below: &[u8],
    row: &[u8],
    above: &[u8],
    connectivity: Connectivity,
    rule: CornerRule,
    masks: &mut [u8],
) {
    match (connectivity, rule) {
        (Connectivity::Four, _) => row_masks_with(below, row, above, masks, |_, _, _| 0),
        (Connectivity::Eight, CornerRule::Never) => row_masks_with(below, row, above, masks, |d, a, b| d & a & b),
        (Connectivity::Eight, CornerRule::OneFree) => row_masks_with(below, row, above, masks, |d, a, b| d & (a | b)),
        (Connectivity::Eight, CornerRule::Free) => row_masks_with(below, row, above, masks, |d, _, _| d),
    }
}

/// Bytes in, bytes out, no branches: the loop is vectorised.
#[inline]
fn row_masks_with(below: &[u8], row: &[u8], above: &[u8], masks: &mut [u8], diagonal: impl Fn(u8, u8, u8) -> u8) {
    let n = masks.len();
    let shifted = |line: &[u8]| -> Option<()> { (line.len() == n + 2).then_some(()) };
    if shifted(below).and(shifted(row)).and(shifted(above)).is_none() {
        return;
    }
    let (sw, s, se) = (&below[..n], &below[1..=n], &below[2..n + 2]);
    let (w, c, e) = (&row[..n], &row[1..=n], &row[2..n + 2]);
    let (nw, north, ne) = (&above[..n], &above[1..=n], &above[2..n + 2]);
    for i in 0..n {
        let straight = e[i] | north[i] << 1 | w[i] << 2 | s[i] << 3;
        let corners = diagonal(ne[i], north[i], e[i]) << 4
            | diagonal(nw[i], north[i], w[i]) << 5
            | diagonal(sw[i], s[i], w[i]) << 6
            | diagonal(se[i], s[i], e[i]) << 7;
        // 0 or 255: a blocked cell has no neighbours.
        masks[i] = (straight | corners) & c[i].wrapping_neg();
    }
}

/// For each step that led to a cell and each mask of the cell, the neighbours still worth a look.
///
/// Where all cells cost the same, a neighbour that the *previous* cell reaches as cheaply without this one can be left
/// out. Of two equally short ways, the one that takes its diagonal first is kept (canonical ordering; Harabor and
/// Grastien 2011, Sturtevant and Rabin 2016). A search with equal costs stays optimal: a straight successor is only
/// left out where going round is strictly shorter, so it cannot be the next cell of an optimal path; a diagonal
/// successor `n` left out for a tie has an optimal path that ends in a straight step, which is not left out.
///
/// With cell weights ([`Pruning::reverse_only`]) only the step back is left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Pruning {
    table: Box<[[u8; 256]; 9]>,
}

impl Pruning {
    /// The table for cells of equal cost.
    pub(super) fn canonical(connectivity: Connectivity, rule: CornerRule) -> Self {
        if connectivity == Connectivity::Four {
            return Self::reverse_only();
        }
        Self::tabulate(
            |step, mask| {
                if step.is_diagonal() { after_diagonal(step, mask) } else { after_straight(step, mask, rule) }
            },
        )
    }

    /// The table that leaves out nothing but the step back.
    pub(super) fn reverse_only() -> Self {
        Self::tabulate(|step, mask| mask & !step.reversed().bit())
    }

    fn tabulate(pruned: impl Fn(Step, u8) -> u8) -> Self {
        let mut table = Box::new([[0; 256]; 9]);
        for (index, row) in table.iter_mut().enumerate() {
            let step = Step::from_bit(index as u32);
            for (mask, slot) in (0_u8..=255).zip(row.iter_mut()) {
                *slot = if step == Step::NONE { mask } else { pruned(step, mask) };
            }
        }
        Self { table }
    }

    /// What is left of `mask` after `arrival`.
    #[inline]
    pub(super) fn successors(&self, arrival: Step, mask: u8) -> u8 {
        self.table[arrival.index()][mask as usize]
    }
}

/// After a straight step from p to x: p reaches what lies beside and behind it at once, and with a diagonal step what
/// lies beside x.
fn after_straight(step: Step, mask: u8, rule: CornerRule) -> u8 {
    let (dx, dy) = (step.dx(), step.dy());
    let mut kept = mask & !step.reversed().bit();
    // The two sides: left (-dy, dx) and right (dy, -dx).
    for (sx, sy) in [(-dy, dx), (dy, -dx)] {
        let (side, behind, ahead) =
            (Step::towards(sx, sy), Step::towards(sx - dx, sy - dy), Step::towards(sx + dx, sy + dy));
        let side_open = mask & side.bit() != 0;
        // From p, the diagonal step to `side` has x on one hand, which is free, and `behind` on the other.
        let reached = match rule {
            CornerRule::Never => side_open && mask & behind.bit() != 0,
            CornerRule::OneFree | CornerRule::Free => side_open,
        };
        kept &= !behind.bit();
        if reached {
            kept &= !(side.bit() | ahead.bit());
        }
    }
    kept
}

/// After a diagonal step from p to x: p reaches its own two straight neighbours at once, and in two straight steps what
/// lies beyond them.
fn after_diagonal(step: Step, mask: u8) -> u8 {
    let (dx, dy) = (step.dx(), step.dy());
    let mut kept = mask & !step.reversed().bit();
    for (near, beyond) in
        [(Step::towards(-dx, 0), Step::towards(-dx, dy)), (Step::towards(0, -dy), Step::towards(dx, -dy))]
    {
        if mask & near.bit() != 0 {
            kept &= !(near.bit() | beyond.bit());
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The branch-free masks against the rules in words, cell by cell.
        #[test]
        fn masks_follow_the_rules(free in proptest::collection::vec(0_u8..2, 27), rule in 0_usize..3, four in any::<bool>()) {
            let rule = [CornerRule::Never, CornerRule::OneFree, CornerRule::Free][rule];
            let connectivity = if four { Connectivity::Four } else { Connectivity::Eight };
            let rows: Vec<&[u8]> = free.chunks(9).collect();
            let mut masks = [0; 7];
            row_masks(rows[0], rows[1], rows[2], connectivity, rule, &mut masks);
            let at = |x: i32, dy: i32| rows[(1 + dy) as usize][x as usize] == 1;
            for (i, mask) in masks.iter().enumerate() {
                let x = i as i32 + 1;
                for step in Step::ALL {
                    let (dx, dy) = (step.dx(), step.dy());
                    let sides = usize::from(at(x + dx, 0)) + usize::from(at(x, dy));
                    let needed = match rule { CornerRule::Never => 2, CornerRule::OneFree => 1, CornerRule::Free => 0 };
                    let corner = !step.is_diagonal() || (!four && sides >= needed);
                    let open = at(x, 0) && at(x + dx, dy) && corner;
                    prop_assert_eq!(mask & step.bit() != 0, open);
                }
            }
        }
    }
}
