//! Shortening: curves between points of a path in the place of what the search put there.
//!
//! The search moves by whole steps and turns by whole headings, which shows. The knots between its motions are joined anew:
//! of all sequences of knots, joined by the cheapest curves that touch nothing or by the motions that are there, the cheapest
//! is found by dynamic programming. Curvature stays within bounds by construction.

use super::{lattice::Lattice, motion::Leg, shot::Curves, site::Site};
use agv_core::geometry::Se2;

/// Most knots that one curve leads over.
const WINDOW: usize = 40;

/// Memory for paths of any length.
#[derive(Debug, Clone, Default)]
pub(super) struct Shortener {
    /// Cost of the cheapest sequence to each knot, the knot before, and whether a curve joins them.
    best: Vec<(f64, usize, bool)>,
    chosen: Vec<usize>,
    shorter: Vec<Leg>,
}

impl Shortener {
    /// Shortens legs that end at `goal`; they stay as they are where nothing is gained.
    pub(super) fn run(&mut self, lattice: &Lattice<'_>, site: &Site, curves: &Curves, legs: &mut Vec<Leg>, goal: &Se2) {
        for _ in 0..2 {
            if !self.pass(lattice, site, curves, legs, goal) {
                break;
            }
        }
    }

    fn pass(&mut self, lattice: &Lattice<'_>, site: &Site, curves: &Curves, legs: &mut Vec<Leg>, goal: &Se2) -> bool {
        let n = legs.len();
        let knot = |i: usize| legs.get(i).map_or(*goal, |leg| leg.start);
        self.best.clear();
        self.best.push((0.0, 0, false));
        for j in 1..=n {
            let Some(&leg) = legs.get(j - 1) else { return false };
            let before = j.checked_sub(2).and_then(|i| legs.get(i)).map(|leg| leg.twist);
            let mut best = (self.best[j - 1].0 + lattice.cost_of(before, [leg]), j - 1, false);
            let end = knot(j);
            for i in (j.saturating_sub(WINDOW)..j.saturating_sub(1)).rev() {
                let from = knot(i);
                let limit = best.0 - 1e-6 - self.best[i].0;
                // No curve is shorter than the line.
                if (end.translation() - from.translation()).norm() >= limit {
                    continue;
                }
                let Some(curve) = curves.cheapest(&from, &end) else { continue };
                if curve.cost(&lattice.params().weights()) >= limit {
                    continue;
                }
                // A curve of several arcs turns the wheels between them; what it joins on to is not looked at.
                let cost = lattice.cost_of(None, curves.legs(&from, &curve));
                if cost < limit
                    && curves.legs(&from, &curve).all(|leg| site.is_free_along(&leg.start, &leg.twist, leg.length))
                {
                    best = (self.best[i].0 + cost, i, true);
                }
            }
            self.best.push(best);
        }
        self.chosen.clear();
        let mut at = n;
        while at > 0 {
            self.chosen.push(at);
            at = self.best[at].1;
        }
        self.shorter.clear();
        let mut from = 0;
        for &to in self.chosen.iter().rev() {
            if self.best[to].2 {
                if let Some(curve) = curves.cheapest(&knot(from), &knot(to)) {
                    self.shorter.extend(curves.legs(&knot(from), &curve));
                }
            } else {
                self.shorter.extend(legs.get(to - 1));
            }
            from = to;
        }
        let gains =
            lattice.cost_of(None, self.shorter.iter().copied()) < lattice.cost_of(None, legs.iter().copied()) - 1e-6;
        if gains {
            std::mem::swap(legs, &mut self.shorter);
        }
        gains
    }
}
