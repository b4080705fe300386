//! Analytic expansion: a curve from a pose straight to the goal.

use super::{
    curve::Curve, dubins::Dubins, lattice::Lattice, motion::Leg, params::HybridAStarParams, reeds_shepp::ReedsShepp,
    site::Site,
};
use crate::Error;
use agv_core::geometry::{Se2, Twist2};

/// The curves of a vehicle.
#[derive(Debug, Clone)]
pub(super) struct Curves {
    both_ways: ReedsShepp,
    forward: Dubins,
    may_reverse: bool,
}

impl Curves {
    pub(super) fn new(params: &HybridAStarParams) -> Result<Self, Error> {
        Ok(Self {
            both_ways: ReedsShepp::new(params.turning_radius)?.with_weights(params.weights())?,
            forward: Dubins::new(params.turning_radius)?,
            may_reverse: params.may_reverse,
        })
    }

    /// The cheapest curve; none for poses that are not finite.
    pub(super) fn cheapest(&self, from: &Se2, to: &Se2) -> Option<Curve> {
        if self.may_reverse { self.both_ways.shortest(from, to).ok() } else { self.forward.shortest(from, to).ok() }
    }

    fn for_each(&self, from: &Se2, to: &Se2, mut take: impl FnMut(Curve)) {
        if self.may_reverse {
            // Poses here are finite.
            let _ = self.both_ways.for_each_word(from, to, take);
        } else if let Some(curve) = self.cheapest(from, to) {
            take(curve);
        }
    }

    /// The curve's pieces that are driven, in the map.
    #[expect(clippy::unused_self, reason = "reads as what it is: the legs of one of these curves")]
    pub(super) fn legs<'a>(&self, from: &Se2, curve: &'a Curve) -> impl Iterator<Item = Leg> + 'a {
        let mut pose = *from;
        curve.driven().map(move |piece| {
            let leg = Leg { start: pose, twist: curve.twist(&piece), length: piece.length.abs() };
            pose = leg.end();
            leg
        })
    }
}

/// A curve to the goal that touches nothing, and the cost of the whole way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shot {
    pub(super) node: u32,
    pub(super) curve: Curve,
    /// In metres, from the start of the search.
    pub(super) cost: f64,
}

/// Tries curves to the goal; keeps the memory of the words it tried.
#[derive(Debug, Clone, Default)]
pub(super) struct Shooter {
    words: Vec<(f64, Curve)>,
}

/// Words that are tried where the cheapest is blocked.
const TRIED: usize = 4;

impl Shooter {
    /// A free curve from a pose to the goal that makes the whole way cheaper than `limit` metres. Where `all_words`, others
    /// are tried if the cheapest is blocked.
    pub(super) fn shoot(
        &mut self,
        lattice: &Lattice<'_>,
        site: &Site,
        curves: &Curves,
        (from, cost, before): (&Se2, f64, Option<Twist2>),
        goal: &Se2,
        (limit, all_words): (f64, bool),
    ) -> Option<(Curve, f64)> {
        let attempt = |curve: &Curve| {
            let total = cost + lattice.cost_of(before, curves.legs(from, curve));
            let free = total < limit
                && curves.legs(from, curve).all(|leg| site.is_free_along(&leg.start, &leg.twist, leg.length));
            free.then_some((*curve, total))
        };
        let weights = lattice.params().weights();
        let cheapest = curves.cheapest(from, goal)?;
        if cost + cheapest.cost(&weights) >= limit {
            return None;
        }
        if let Some(hit) = attempt(&cheapest) {
            return Some(hit);
        }
        if !all_words {
            return None;
        }
        self.words.clear();
        curves.for_each(from, goal, |curve| {
            let total = cost + curve.cost(&weights);
            if total < limit {
                self.words.push((total, curve));
            }
        });
        self.words.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        // The first is the one that is blocked.
        self.words.iter().take(TRIED).skip(1).find_map(|(_, curve)| attempt(curve))
    }
}
