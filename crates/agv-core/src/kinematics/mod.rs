//! How wheels move a vehicle, and what a vehicle can do.

mod limits;

use crate::{Error, geometry::Twist2};

pub use limits::TwistLimits;

/// The relation between wheel commands and the twist of the base.
///
/// Laws: `inverse` of a twist that the vehicle can do is undone by `forward`; `forward` is linear in the wheel speeds.
pub trait Kinematics {
    /// Speeds and steering angles of the wheels.
    type Wheels;

    /// Twist of the base for these wheel speeds and steering angles.
    fn forward(&self, wheels: &Self::Wheels) -> Twist2;

    /// Wheel speeds and steering angles for the twist.
    ///
    /// Components that the vehicle cannot do (sideways motion of a differential drive) are left out, as every vehicle
    /// does; a twist that has no solution at all is an error.
    ///
    /// # Errors
    /// A twist that is not finite, or that no wheel command comes near to.
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error>;
}
