//! Minimising a cost without derivatives: the [`Optimizer`] role, the space it searches, and the loop that drives it.
//!
//! An optimiser proposes points of the unit cube and is told their costs; [`SearchSpace`] maps the cube to the user's
//! units, so that gains that span decades are searched evenly; [`Search`] joins the two with an
//! [`Objective`](crate::Objective), counts evaluations and says why it stopped. Swarms are in [`crate::pso`],
//! differential evolution and CMA-ES in [`crate::evolution`].
//!
//! ```
//! use agv_control::optimize::{Search, SearchSpace, Stopping, Termination};
//! use agv_control::pso::{Swarm, SwarmParams};
//! use agv_core::compute::Seed;
//!
//! let rosenbrock = |p: &[f64]| 100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2);
//! let swarm = Swarm::new(2, SwarmParams::improved(), Seed(1))?;
//! let mut search = Search::new(SearchSpace::cube(2, -5.0, 5.0)?, swarm)?;
//! let outcome = search.run(&rosenbrock, &Stopping { target: 1e-6, max_evaluations: 10_000, ..Stopping::default() })?;
//! assert_eq!(outcome.termination, Termination::Target);
//! assert!((outcome.point[0] - 1.0).abs() < 1e-2);
//! # Ok::<(), agv_core::Error>(())
//! ```

mod history;
mod search;
mod space;
mod stopping;
#[cfg(feature = "serde")]
pub(crate) mod stored_costs;

pub use history::{History, Record};
pub use search::{Outcome, Search};
pub use space::{Interval, Scale, SearchSpace};
pub use stopping::{Stopping, Termination};

use agv_core::{Error, compute::Stream};
use rand::RngExt;

/// Proposes points and learns from their costs.
///
/// Points lie in the unit cube, one after another. A generation is asked for, its costs are told, and so on: between the
/// two the caller may take all the time it needs, evaluate on threads, or let a vehicle drive with each point.
pub trait Optimizer {
    /// Number of coordinates of a point.
    fn dimension(&self) -> usize;

    /// The points of this generation; the same until their costs are told. Never empty.
    fn ask(&self) -> &[f64];

    /// Takes the costs of the points of [`ask`](Self::ask), in their order, and moves on to the next generation. NaN
    /// counts as infinity.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`] if there is not one cost for each point; the state is as before.
    fn tell(&mut self, costs: &[f64]) -> Result<(), Error>;

    /// The best point told so far and its cost; none before the first generation.
    fn best(&self) -> Option<(&[f64], f64)>;

    /// How widely the search is spread, as a part of the cube's edge: the greatest standard deviation of a coordinate.
    fn spread(&self) -> f64;
}

impl<O: Optimizer + ?Sized> Optimizer for Box<O> {
    fn dimension(&self) -> usize {
        (**self).dimension()
    }

    fn ask(&self) -> &[f64] {
        (**self).ask()
    }

    fn tell(&mut self, costs: &[f64]) -> Result<(), Error> {
        (**self).tell(costs)
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        (**self).best()
    }

    fn spread(&self) -> f64 {
        (**self).spread()
    }
}

/// A cost that can be compared: NaN loses.
pub(crate) fn comparable(cost: f64) -> f64 {
    if cost.is_nan() { f64::INFINITY } else { cost }
}

/// A coordinate moved away from `start`; past a bound it goes half of the way there, so that bounds can be approached but
/// do not collect what is sent past them.
pub(crate) fn inside(moved: f64, start: f64) -> f64 {
    if moved < 0.0 {
        0.5 * start
    } else if moved > 1.0 {
        0.5 * (start + 1.0)
    } else {
        moved
    }
}

/// Three different indices below `count`, none of them `own`; `count` is at least four.
pub(crate) fn three_others(own: usize, count: usize, stream: &mut Stream) -> [usize; 3] {
    let mut picked = [own; 3];
    for k in 0..3 {
        loop {
            let candidate = stream.random_range(0..count);
            if candidate != own && !picked[..k].contains(&candidate) {
                picked[k] = candidate;
                break;
            }
        }
    }
    picked
}

/// The greatest standard deviation over the coordinates of points that lie one after another.
pub(crate) fn spread_of(points: &[f64], dimension: usize) -> f64 {
    let count = (points.len() / dimension.max(1)).max(1) as f64;
    let deviation = |d: usize| {
        let values = || points.iter().skip(d).step_by(dimension);
        let mean = values().sum::<f64>() / count;
        (values().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count).sqrt()
    };
    (0..dimension).map(deviation).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn three_others_are_three_others(own in 0_usize..4, seed in 0_u64..1000) {
            let mut picked = three_others(own, 4, &mut Seed(seed).stream(0, 0)).to_vec();
            picked.push(own);
            picked.sort_unstable();
            prop_assert_eq!(picked, [0, 1, 2, 3]);
        }
    }
}
