//! The parts that every registration is made of, each for itself.
//!
//! | part | what it does |
//! |---|---|
//! | [`PointDerivatives`] | what a factor says of one point |
//! | [`MotionSums`] | what they add up to, in any parts |
//! | [`Quadratic`] | that as a cost of the pose |
//! | [`Objective`] | a cost over poses |
//! | [`Freedom`] | what of the pose may change |
//! | [`Optimizer`] | walks downhill: in damped steps, or by [`MoreThuente`]'s line search |
//! | [`Descent`] | where that ended, and why |

mod descent;
mod facing;
mod freedom;
mod gauss_newton;
mod more_thuente;
mod newton;
mod optimizer;
pub(crate) mod quadratic;
mod trust_region;

pub(crate) use descent::verdict;
pub use descent::{Descent, DescentParams};
pub(crate) use facing::Facing;
pub use freedom::Freedom;
pub use more_thuente::{LinePoint, LineSearchEnd, LineSearchParams, MoreThuente};
pub use optimizer::Optimizer;
pub use quadratic::{MotionSums, PointDerivatives, Quadratic};

use agv_core::geometry::Se3;

/// 95 % quantile of χ² with three degrees of freedom: squares of distances from a distribution, in its deviations, up to which a point
/// belongs to it.
pub(crate) const INLIER: f64 = 7.815;

/// Points of a source, or of what odometry places, below which they say nothing of the pose, unless the caller knows better.
pub(crate) const MIN_POINTS: usize = 50;

/// A cost over poses, to second order.
pub trait Objective {
    /// The cost near `pose`. What it says must depend on the pose alone.
    fn evaluate(&mut self, pose: &Se3) -> Quadratic;
}
