//! Reeds–Shepp curves: the shortest way from pose to pose of a vehicle that turns no tighter than a circle and may reverse.

mod words;

#[cfg(test)]
mod tests;

use super::{
    curve::{Curve, CurveWeights},
    dubins::{self, Relative},
};
use agv_core::{Error, check, geometry::Se2};

/// Shortest curves of a vehicle that drives both ways, or cheapest ones where reversing has a price.
///
/// With weights, the curve is the cheapest of all words of Reeds and Shepp and of Dubins' (driven either way); no word outside of
/// them is looked at, though with weights one might be cheaper still. Allocates nothing.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_plan::hybrid::{CurveWeights, ReedsShepp};
///
/// let (start, beside) = (Se2::default(), Se2::new(0.0, 1.0, 0.0)); // one metre to the left, as in a parking lot
/// let car = ReedsShepp::new(2.0)?;
/// let curve = car.shortest(&start, &beside)?;
/// assert_eq!(curve.gear_changes(), 2);
/// assert!((curve.start_from_end().y() - 1.0).abs() < 1e-9);
///
/// let hates_cusps = car.with_weights(CurveWeights { gear_change: 20.0, ..Default::default() })?;
/// assert_eq!(hates_cusps.shortest(&start, &beside)?.gear_changes(), 0); // a full loop
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "Raw", into = "Raw"))]
pub struct ReedsShepp {
    radius: f64,
    weights: CurveWeights,
}

#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct Raw {
    radius: f64,
    weights: CurveWeights,
}

#[cfg(feature = "serde")]
impl TryFrom<Raw> for ReedsShepp {
    type Error = Error;

    fn try_from(raw: Raw) -> Result<Self, Error> {
        Self::new(raw.radius)?.with_weights(raw.weights)
    }
}

#[cfg(feature = "serde")]
impl From<ReedsShepp> for Raw {
    fn from(curves: ReedsShepp) -> Self {
        Self { radius: curves.radius, weights: curves.weights }
    }
}

impl ReedsShepp {
    /// Shortest curves of this least turning radius, in metres.
    ///
    /// # Errors
    /// A radius that is not finite and positive.
    pub fn new(radius: f64) -> Result<Self, Error> {
        Ok(Self { radius: check::positive("radius", radius)?, weights: CurveWeights::default() })
    }

    /// The cheapest curves under these weights instead of the shortest.
    ///
    /// # Errors
    /// Weights out of range.
    pub fn with_weights(self, weights: CurveWeights) -> Result<Self, Error> {
        weights.validate()?;
        Ok(Self { weights, ..self })
    }

    /// Least turning radius, in metres.
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// What is added to the length.
    pub const fn weights(&self) -> &CurveWeights {
        &self.weights
    }

    /// The cheapest curve between two poses; the shortest one without weights.
    ///
    /// # Errors
    /// A pose that is not finite, or one more than 1e12 radii away.
    pub fn shortest(&self, from: &Se2, to: &Se2) -> Result<Curve, Error> {
        Ok(self.best(&Relative::between(from, to, self.radius)?))
    }

    /// Cost of the cheapest curve, in metres: its length without weights.
    ///
    /// # Errors
    /// As [`shortest`](Self::shortest).
    pub fn cost(&self, from: &Se2, to: &Se2) -> Result<f64, Error> {
        Ok(self.least_cost(&Relative::between(from, to, self.radius)?))
    }

    /// Calls `take` for all words that lead from one pose to the other, in no order that matters: for who needs another one
    /// where the shortest is blocked.
    ///
    /// # Errors
    /// As [`shortest`](Self::shortest).
    pub fn for_each_word(&self, from: &Se2, to: &Se2, mut take: impl FnMut(Curve)) -> Result<(), Error> {
        let goal = Relative::between(from, to, self.radius)?;
        words::for_each(&goal, f64::INFINITY, |word| {
            take(word.curve(self.radius));
            f64::INFINITY
        });
        self.for_each_loop(&goal, f64::INFINITY, &mut |curve| {
            take(curve);
            f64::INFINITY
        });
        Ok(())
    }

    pub(super) fn best(&self, goal: &Relative) -> Curve {
        let weights = self.weights_in_radii();
        let (mut best, mut limit) = (None, f64::INFINITY);
        words::for_each(goal, limit, |word| {
            let cost = weights.of_lengths(word.lengths());
            if cost < limit {
                (best, limit) = (Some(*word), cost);
            }
            limit
        });
        let mut curve = best.map_or(Curve::nowhere(self.radius), |word| word.curve(self.radius));
        self.for_each_loop(goal, limit, &mut |turn| {
            let cost = turn.cost(&self.weights) / self.radius;
            if cost < limit {
                (curve, limit) = (turn, cost);
            }
            limit
        });
        curve
    }

    #[inline]
    pub(super) fn least_cost(&self, goal: &Relative) -> f64 {
        let weights = self.weights_in_radii();
        let mut limit = f64::INFINITY;
        if self.is_weighted() {
            words::for_each(goal, limit, |word| {
                limit = limit.min(weights.of_lengths(word.lengths()));
                limit
            });
            self.for_each_loop(goal, limit, &mut |curve| {
                limit = limit.min(curve.cost(&self.weights) / self.radius);
                limit
            });
        } else {
            words::for_each(goal, limit, |word| {
                limit = limit.min(word.lengths().iter().map(|length| length.abs()).sum());
                limit
            });
        }
        limit * self.radius
    }

    fn is_weighted(&self) -> bool {
        self.weights != CurveWeights::default()
    }

    fn weights_in_radii(&self) -> CurveWeights {
        CurveWeights { gear_change: self.weights.gear_change / self.radius, ..self.weights }
    }

    /// Curves without a change of gear, whose arcs may be longer than half a circle: never the shortest, but perhaps the
    /// cheapest.
    fn for_each_loop(&self, goal: &Relative, limit: f64, take: &mut dyn FnMut(Curve) -> f64) {
        if !self.is_weighted() {
            return;
        }
        let mut limit = limit;
        // Backwards: the goal seen by who looks the other way.
        let flipped = Relative { x: -goal.x, yaw: -goal.yaw, sin: -goal.sin, ..*goal };
        for (goal, direction) in [(*goal, 1.0), (flipped, -1.0)] {
            let word = dubins::Word::best(goal);
            if word.length() < limit {
                let mut curve = Curve::nowhere(self.radius);
                for (turn, length) in word.turns.into_iter().zip(word.lengths) {
                    curve.push(turn, direction * length);
                }
                limit = take(curve);
            }
        }
    }
}
