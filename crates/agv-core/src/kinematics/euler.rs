//! One Euler step of the unicycle, as the papers print it.
//!
//! ```text
//! x += v dt cos(yaw)        y += v dt sin(yaw)        yaw += w dt
//! ```
//!
//! (paper 000, Eqs. 1–2; paper 002, Eq. 18). The heading of the step's start is used throughout, so a step strays from
//! the arc by about `v w dt² / 2`. It is here for comparison: [`Twist2::integrate`] is exact at the same cost.

use crate::geometry::{LieGroup, Se2, So2, Twist2};
use nalgebra::Vector2;

/// The pose after `dt` seconds at `twist`, by one Euler step in the fixed frame.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::kinematics::euler_step;
///
/// let next = euler_step(&Se2::new(1.0, 2.0, 0.0), &Twist2::new(1.0, 0.0, 0.5), 0.1);
/// assert!((next.x() - 1.1).abs() < 1e-12 && next.y() == 2.0 && (next.yaw() - 0.05).abs() < 1e-12);
/// ```
pub fn euler_step(map_from_base: &Se2, twist: &Twist2, dt: f64) -> Se2 {
    let heading = map_from_base.rotation();
    let step = heading.act(&(Vector2::new(twist.vx, twist.vy) * dt));
    Se2::from_parts(map_from_base.translation() + step, heading.compose(&So2::from_angle(twist.yaw_rate * dt)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of first order: half the step leaves half the error, and the error of one step is `v w dt² / 2`.
    #[test]
    fn euler_is_of_first_order() {
        let twist = Twist2::new(1.0, 0.0, 0.8);
        let exact = twist.integrate(2.0);
        let error = |steps: u32| {
            let dt = 2.0 / f64::from(steps);
            let end = (0..steps).fold(Se2::default(), |pose, _| euler_step(&pose, &twist, dt));
            assert!((end.yaw() - exact.yaw()).abs() < 1e-12);
            (end.translation() - exact.translation()).norm()
        };
        let ratio = error(100) / error(200);
        assert!((ratio - 2.0).abs() < 0.02, "{ratio}");
        let dt = 1e-3;
        let one = (euler_step(&Se2::default(), &twist, dt).translation() - twist.integrate(dt).translation()).norm();
        assert!((one / (0.5 * 0.8 * dt * dt) - 1.0).abs() < 1e-3);
    }
}
