//! Rotations and rigid motions of the plane and of space, with the calculus that filters and optimisers need.
//!
//! Notation and equation numbers follow Solà, Deray and Atchuthan, *A micro Lie theory for state estimation in
//! robotics* (2018, arXiv:1812.01537). Increments are right increments throughout: `x ⊕ τ = x ∘ exp(τ)`, so a tangent
//! vector, a covariance or a Jacobian of a pose `target_from_source` is expressed in `source`. Tangent vectors hold
//! the translation first: `(x, y, yaw)` on SE(2), `(x, y, z, rx, ry, rz)` on SE(3).

mod angle;
mod covariance;
mod group;
mod mean;
mod observability;
pub(crate) mod outline;
mod se2;
mod se3;
mod series;
pub mod small_angle;
mod so2;
mod so3;
mod twist;
mod uncertain_vector;

pub use angle::{angle_difference, wrap_angle};
pub use covariance::{UncertainPose, propagate_covariance};
pub use group::LieGroup;
pub use mean::{CircularMean, PoseMean, circular_mean, pose_mean};
pub use observability::{PoseSigma, bounded_covariance, observed_information, unobserved_directions};
pub use outline::nearest_on_segment;
pub use se2::Se2;
pub use se3::Se3;
pub use so2::So2;
pub use so3::{So3, skew};
pub use twist::{Twist2, Twist3};
pub use uncertain_vector::UncertainVector;

/// Accepts the squared norm of a stored rotation. Compositions keep it within a few units in the last place, so
/// anything beyond is a damaged or a rounded file; normalising it would change the bits of a sound one.
#[cfg(feature = "serde")]
fn check_unit_norm(name: &'static str, norm_squared: f64) -> Result<(), crate::Error> {
    crate::check::in_range(name, norm_squared, 1.0 - 1e-9, 1.0 + 1e-9).map(|_| ())
}
