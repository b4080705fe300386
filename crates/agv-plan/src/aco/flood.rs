//! What can be reached from a cell: so that ants are sent only where there is a way.

use super::{detours::REVERSED, marks::Marks};
use crate::grid::{DIAGONAL, GridSpace, STRAIGHT};
use std::iter::successors;

/// Cells reached from a start, breadth first, and the steps that led there.
#[derive(Debug, Clone, Default)]
pub(super) struct Flood {
    reached: Marks,
    /// Step that led to a cell; of meaning for reached ones.
    steps: Vec<u8>,
    queue: Vec<u32>,
    start: u32,
    strides: [u32; 8],
}

impl Flood {
    /// Spreads from the start until the goal is reached, if it can be.
    pub(super) fn spread(&mut self, space: &GridSpace, start: u32, goal: u32) -> bool {
        (self.start, self.strides) = (start, space.strides());
        self.reached.clear(space.len());
        self.steps.resize(space.len(), 8);
        self.queue.clear();
        self.enter(start, 8);
        let mut head = 0;
        while let Some(&node) = self.queue.get(head) {
            head += 1;
            if node == goal {
                return true;
            }
            let mut open = space.mask(node);
            while open != 0 {
                let step = open.trailing_zeros() as usize & 7;
                open &= open - 1;
                let next = node.wrapping_add(self.strides[step]);
                if !self.reached.contains(next) {
                    self.enter(next, step as u8);
                }
            }
        }
        false
    }

    fn enter(&mut self, node: u32, step: u8) {
        self.reached.insert(node);
        if let Some(slot) = self.steps.get_mut(node as usize) {
            *slot = step;
        }
        self.queue.push(node);
    }

    /// Cells that were reached.
    pub(super) fn len(&self) -> usize {
        self.queue.len()
    }

    fn contains(&self, node: u32) -> bool {
        self.reached.contains(node)
    }

    /// The cell before a reached one, and the step from there; none for the start.
    fn before(&self, node: u32) -> Option<(u32, u8)> {
        let step = self.steps.get(node as usize).copied()?;
        let back = REVERSED.get(usize::from(step))?;
        Some((node.wrapping_add(self.strides[usize::from(*back)]), step))
    }

    /// Cost of the way to a cell, in the integers of the search, if it was reached.
    pub(super) fn cost(&self, node: u32) -> Option<u32> {
        let back = successors(self.before(node), |&(node, _)| self.before(node));
        let price = |step| if step >= 4 { DIAGONAL } else { STRAIGHT };
        self.contains(node).then(|| back.fold(0_u32, |cost, (_, step)| cost.saturating_add(price(step))))
    }

    /// The way to a reached cell, from the start; empty if it was not reached.
    pub(super) fn way_into(&self, node: u32, way: &mut Vec<u32>) {
        way.clear();
        if self.contains(node) {
            way.extend(successors(Some(node), |&node| self.before(node).map(|(before, _)| before)));
            way.reverse();
        }
    }
}
