//! The parts that every registration is made of, each for itself.
//!
//! | part | what it does |
//! |---|---|
//! | [`PointDerivatives`] | what a factor says of one point |
//! | [`Quadratic`] | what they add up to at a pose |
//! | [`Objective`] | a cost over poses |
//! | [`LevenbergMarquardt`] | walks downhill |

pub(crate) mod quadratic;
mod trust_region;

pub use quadratic::{PointDerivatives, Quadratic};
pub use trust_region::{Descent, DescentParams, LevenbergMarquardt};

use agv_core::geometry::Se3;

/// A cost over poses, to second order.
pub trait Objective {
    /// The cost near `pose`. What it says must depend on the pose alone.
    fn evaluate(&mut self, pose: &Se3) -> Quadratic;
}
