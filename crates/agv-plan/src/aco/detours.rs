//! Shortening an ant's way by the cells it has been to: an addition to the paper.
//!
//! Ants that may not tread twice on a cell still walk beside their own way. Of all ways that lead through some of an ant's
//! own cells in the order it came to them, the shortest is found by one sweep (dynamic programming over the way, where
//! every cell looks at its open neighbours that lie earlier). Of equally short ones the straighter is kept.

use super::{
    ant::{Rules, price_of},
    marks::Marks,
};
use crate::grid::Step;

/// Memory of the sweep.
#[derive(Debug, Clone, Default)]
pub(super) struct Detours {
    on_way: Marks,
    /// Where on the way a cell lies; of meaning for cells on it.
    places: Vec<u32>,
    /// For every place: the least cost from the start, and the place before with the step that leads here.
    costs: Vec<u32>,
    before: Vec<(u32, u8)>,
}

impl Detours {
    /// Replaces a way from the start by the shortest one over its own cells; never longer.
    pub(super) fn erase(&mut self, rules: &Rules<'_>, steps: &mut Vec<u8>) {
        let cells = rules.masks.len();
        self.places.resize(cells, 0);
        self.on_way.clear(cells);
        self.costs.clear();
        self.before.clear();
        let mut node = rules.start;
        self.enter(node, 0, (u32::MAX, 8));
        for &taken in steps.iter() {
            node = node.wrapping_add(rules.strides[usize::from(taken & 7)]);
            let mut least = (u32::MAX, true, (u32::MAX, 8));
            let mut open = rules.masks.get(node as usize).copied().unwrap_or(0);
            while open != 0 {
                let bit = open.trailing_zeros() as usize & 7;
                open &= open - 1;
                let neighbour = node.wrapping_add(rules.strides[bit]);
                if !self.on_way.contains(neighbour) {
                    continue;
                }
                let place = self.places.get(neighbour as usize).copied().unwrap_or(0);
                let Some((&cost, &(_, last))) = self.costs.get(place as usize).zip(self.before.get(place as usize))
                else {
                    continue;
                };
                // From the neighbour to here, against the bit.
                let step = REVERSED[bit];
                let cost = cost.saturating_add(price_of(step));
                let candidate = (cost, last != step && last != 8, (place, step));
                if (candidate.0, candidate.1) < (least.0, least.1) {
                    least = candidate;
                }
            }
            self.enter(node, least.0, least.2);
        }
        // Back from the goal; what remains is written in reverse and turned.
        steps.clear();
        let mut place = self.before.len().saturating_sub(1);
        while let Some(&(before, step)) = self.before.get(place).filter(|(_, step)| *step < 8) {
            steps.push(step);
            place = before as usize;
        }
        steps.reverse();
    }

    fn enter(&mut self, node: u32, cost: u32, before: (u32, u8)) {
        self.on_way.insert(node);
        if let Some(slot) = self.places.get_mut(node as usize) {
            *slot = self.costs.len() as u32;
        }
        self.costs.push(cost);
        self.before.push(before);
    }
}

/// The step back of each step.
const REVERSED: [u8; 8] = {
    let mut table = [0; 8];
    let mut bit = 0;
    while bit < 8 {
        table[bit] = Step::ALL[bit].reversed().index() as u8;
        bit += 1;
    }
    table
};
