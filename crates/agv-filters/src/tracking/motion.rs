//! Nearly constant velocity in the plane.

use crate::kalman::ProcessModel;
use agv_core::{Error, check};
use nalgebra::{Matrix4, Vector4};

/// A point `(x, y, vx, vy)` whose velocity wanders: white noise of power density `q` accelerates it along each axis,
///
/// ```text
/// F = [1 dt; 0 1]      Q = q [dt³/3 dt²/2; dt²/2 dt]      per axis
/// ```
///
/// (Bar-Shalom, Li and Kirubarajan 2001, *Estimation with applications to tracking and navigation*, section 6.2.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantVelocity {
    density: f64,
}

impl ConstantVelocity {
    /// A point whose velocity changes by `wander` metres per second, one standard deviation, within a second.
    ///
    /// # Errors
    /// [`Error::Negative`].
    pub fn new(wander: f64) -> Result<Self, Error> {
        check::non_negative("wander", wander).map(|wander| Self { density: wander * wander })
    }
}

impl ProcessModel<Vector4<f64>, 4> for ConstantVelocity {
    type Control = ();

    #[inline]
    fn transition(&self, x: &Vector4<f64>, (): &(), dt: f64) -> Vector4<f64> {
        Vector4::new(x[0] + x[2] * dt, x[1] + x[3] * dt, x[2], x[3])
    }

    #[inline]
    fn jacobian(&self, _: &Vector4<f64>, (): &(), dt: f64) -> Matrix4<f64> {
        let mut jacobian = Matrix4::identity();
        (jacobian[(0, 2)], jacobian[(1, 3)]) = (dt, dt);
        jacobian
    }

    #[inline]
    fn noise(&self, _: &Vector4<f64>, (): &(), dt: f64) -> Matrix4<f64> {
        let q = self.density;
        let (near, cross, far) = (q * dt * dt * dt / 3.0, q * dt * dt / 2.0, q * dt);
        let mut noise = Matrix4::from_diagonal(&Vector4::new(near, near, far, far));
        for axis in 0..2 {
            (noise[(axis, axis + 2)], noise[(axis + 2, axis)]) = (cross, cross);
        }
        noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Ekf, laws};

    #[test]
    fn jacobians_are_slopes_and_two_steps_are_one() {
        let (model, start) = (ConstantVelocity::new(0.7).unwrap(), Vector4::new(1.0, -2.0, 0.3, 0.8));
        laws::process_jacobian(&model, &start, &(), 0.3);
        let mut once = Ekf::new(start, Matrix4::identity() * 0.1).unwrap();
        let mut twice = once;
        once.predict(&model, &(), 0.5).unwrap();
        twice.predict(&model, &(), 0.2).unwrap();
        twice.predict(&model, &(), 0.3).unwrap();
        assert!(
            (once.covariance() - twice.covariance()).norm() < 1e-12 && (once.state() - twice.state()).norm() < 1e-12
        );
        assert!(ConstantVelocity::new(-0.1).is_err() && ConstantVelocity::new(f64::NAN).is_err());
    }
}
