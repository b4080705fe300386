//! The motion of a body whose twist is held constant, in the map, with its derivatives.
//!
//! Over `dt` the body turns by `2h = ω dt` and moves along the chord of an arc, in the direction of the mean heading
//! `m = θ + h`:
//!
//! ```text
//! (Δx, Δy) = dt sinc(h) R(m) (vx, vy)          sinc(h) = sin(h) / h
//! ```
//!
//! which is Eq. 1 of paper 001 (*Probabilistic Robotics*, Eq. 5.9) without its division by ω, and the straight line where
//! ω vanishes.

use agv_core::geometry::Twist2;
use nalgebra::Vector2;

/// A motion in the map, in metres, and its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arc {
    /// Displacement.
    pub(super) moved: Vector2<f64>,
    /// Derivative by the forward speed, in seconds.
    pub(super) by_forward: Vector2<f64>,
    /// Derivative by the yaw rate, in metre seconds.
    pub(super) by_yaw_rate: Vector2<f64>,
}

impl Arc {
    #[inline]
    pub(super) fn new(yaw: f64, twist: &Twist2, dt: f64) -> Self {
        let half = 0.5 * twist.yaw_rate * dt;
        let (sin, cos) = (yaw + half).sin_cos();
        let (sinc, slope) = sinc_and_slope(half);
        let along = Vector2::new(twist.vx * cos - twist.vy * sin, twist.vx * sin + twist.vy * cos) * dt;
        let moved = along * sinc;
        let by_half = along * slope + across(&moved);
        Self { moved, by_forward: Vector2::new(cos, sin) * (dt * sinc), by_yaw_rate: by_half * (0.5 * dt) }
    }

    /// Derivative by the heading at the start, in metres.
    #[inline]
    pub(super) fn by_yaw(&self) -> Vector2<f64> {
        across(&self.moved)
    }

    /// Derivative by the speed to the left, in seconds.
    #[inline]
    pub(super) fn by_left(&self) -> Vector2<f64> {
        across(&self.by_forward)
    }
}

/// A quarter turn to the left.
#[inline]
fn across(v: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-v.y, v.x)
}

/// `sin(h) / h` and its derivative, by their series near zero, where the quotients lose digits.
#[inline]
fn sinc_and_slope(h: f64) -> (f64, f64) {
    let s = h * h;
    if s < 0.0625 {
        // Reciprocals of constants, which the compiler takes once; quotients would be divisions.
        let sinc = [-1.0 / 39_916_800.0, 1.0 / 362_880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0];
        let slope = [-1.0 / 3_991_680.0, 1.0 / 45_360.0, -1.0 / 840.0, 1.0 / 30.0, -1.0 / 3.0];
        return (horner(sinc, s), h * horner(slope, s));
    }
    let (sin, cos) = h.sin_cos();
    let sinc = sin / h;
    (sinc, (cos - sinc) / h)
}

/// The polynomial with these coefficients, that of the highest power first.
#[inline]
fn horner<const N: usize>(coefficients: [f64; N], x: f64) -> f64 {
    coefficients.into_iter().fold(0.0, |value, coefficient| value * x + coefficient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::Se2;
    use proptest::prelude::*;

    proptest! {
        /// Against the exponential of SE(2), whose sums are others.
        #[test]
        fn arcs_are_the_groups(yaw in -3.0..3.0_f64, vx in -2.0..2.0_f64, vy in -1.0..1.0_f64, rate in -9.0..9.0_f64, dt in 0.0..1.0_f64) {
            let twist = Twist2::new(vx, vy, rate);
            let end = Se2::new(0.0, 0.0, yaw) * twist.integrate(dt);
            prop_assert!((Arc::new(yaw, &twist, dt).moved - end.translation()).norm() < 1e-14);
        }
    }

    #[test]
    fn series_and_quotients_meet() {
        for h in [0.25 - 1e-12, 0.25 + 1e-12, -0.25 - 1e-12] {
            let (sinc, slope) = sinc_and_slope(h);
            assert!((sinc - h.sin() / h).abs() < 1e-15 && (slope - (h.cos() - sinc) / h).abs() < 2e-15, "{h}");
        }
        assert_eq!(sinc_and_slope(0.0), (1.0, 0.0));
    }
}
