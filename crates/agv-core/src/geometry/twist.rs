//! Velocities of a body, expressed in its own frame.

use super::{LieGroup, Se2, Se3};
use nalgebra::{Vector3, Vector6};

/// Planar velocity in the base frame.
///
/// ```
/// use agv_core::geometry::Twist2;
///
/// // Half a second on a circle of 2 m radius.
/// let twist = Twist2::new(1.0, 0.0, 0.5);
/// let start_from_end = twist.integrate(0.5);
/// assert!((start_from_end.yaw() - 0.25).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Twist2 {
    /// Forward velocity, in metres per second.
    pub vx: f64,
    /// Velocity to the left, in metres per second; zero for vehicles that cannot move sideways.
    pub vy: f64,
    /// Counter-clockwise turn rate, in radians per second.
    pub yaw_rate: f64,
}

impl Twist2 {
    /// A vehicle at rest.
    pub const ZERO: Self = Self { vx: 0.0, vy: 0.0, yaw_rate: 0.0 };

    /// A twist from its three components.
    pub const fn new(vx: f64, vy: f64, yaw_rate: f64) -> Self {
        Self { vx, vy, yaw_rate }
    }

    /// The motion of `dt` seconds at this twist, exactly: an arc, or a line where the turn rate vanishes.
    #[inline]
    pub fn integrate(&self, dt: f64) -> Se2 {
        Se2::exp(&(Vector3::from(*self) * dt))
    }

    /// Speed over ground, in metres per second.
    pub fn speed(&self) -> f64 {
        // The same, and most vehicles cannot move sideways.
        if self.vy == 0.0 { self.vx.abs() } else { self.vx.hypot(self.vy) }
    }

    /// Whether all three components are finite.
    pub fn is_finite(&self) -> bool {
        self.vx.is_finite() && self.vy.is_finite() && self.yaw_rate.is_finite()
    }
}

impl From<Twist2> for Vector3<f64> {
    #[inline]
    fn from(twist: Twist2) -> Self {
        Self::new(twist.vx, twist.vy, twist.yaw_rate)
    }
}

impl From<Vector3<f64>> for Twist2 {
    #[inline]
    fn from(v: Vector3<f64>) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

/// Velocity in space, in the body frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Twist3 {
    /// Linear velocity, in metres per second.
    pub linear: Vector3<f64>,
    /// Angular velocity, in radians per second.
    pub angular: Vector3<f64>,
}

impl Twist3 {
    /// The motion of `dt` seconds at this twist, exactly: a screw.
    pub fn integrate(&self, dt: f64) -> Se3 {
        Se3::exp(&(Vector6::from(*self) * dt))
    }
}

impl From<Twist3> for Vector6<f64> {
    fn from(twist: Twist3) -> Self {
        let (v, w) = (twist.linear, twist.angular);
        Self::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }
}

impl From<Twist2> for Twist3 {
    fn from(twist: Twist2) -> Self {
        Self { linear: Vector3::new(twist.vx, twist.vy, 0.0), angular: Vector3::new(0.0, 0.0, twist.yaw_rate) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planar_and_spatial_motion_agree() {
        let twist = Twist2::new(0.7, -0.2, 0.9);
        let (planar, spatial) = (twist.integrate(0.3), Twist3::from(twist).integrate(0.3));
        assert!((spatial.to_planar().translation() - planar.translation()).norm() < 1e-12);
        assert!((spatial.to_planar().yaw() - planar.yaw()).abs() < 1e-12);
        assert!(spatial.translation().z.abs() < 1e-15);
    }
}
