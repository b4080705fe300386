//! Range and bearing of a landmark whose place is known.
//!
//! ```text
//! d = l - (p + R(θ) m)          r = |d|          β = atan2(d_y, d_x) - θ - θ_mount
//! ```
//!
//! with the landmark `l`, the vehicle's pose `(p, θ)` and the sensor's mount `(m, θ_mount)` on it.

use super::{Expected, MeasurementModel};
use crate::kalman::PlanarState;
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, angle_difference, wrap_angle},
};
use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2};

/// A landmark that is seen by range, in metres, and bearing, in radians from the sensor's x axis.
///
/// Reads any [`PlanarState`]. Where the vehicle stands on the landmark there is no bearing: filters refuse the reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Landmark {
    position: Vector2<f64>,
    base_from_sensor: Se2,
    range_variance: f64,
    /// Variance of the range per square of the range.
    range_share: f64,
    bearing_variance: f64,
}

impl Landmark {
    /// A landmark at this place of the map, in metres, seen with these standard deviations of range and bearing, in metres
    /// and radians, from the vehicle's origin.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for the place, [`Error::NotPositive`] for a deviation.
    pub fn new(position: Vector2<f64>, sigmas: &Vector2<f64>) -> Result<Self, Error> {
        check::all_finite("landmark", position.iter())?;
        let range = check::positive("range sigma", sigmas.x)?;
        let bearing = check::positive("bearing sigma", sigmas.y)?;
        Ok(Self {
            position,
            base_from_sensor: Se2::default(),
            range_variance: range * range,
            range_share: 0.0,
            bearing_variance: bearing * bearing,
        })
    }

    /// The same seen from a sensor mounted at this pose on the vehicle.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn with_mount(self, base_from_sensor: Se2) -> Result<Self, Error> {
        check::all_finite("mount", &[base_from_sensor.x(), base_from_sensor.y(), base_from_sensor.yaw()])?;
        Ok(Self { base_from_sensor, ..self })
    }

    /// The same with a range whose deviation grows by this share of the range: 0.02 for 2 cm a metre.
    ///
    /// # Errors
    /// [`Error::Negative`].
    pub fn with_range_share(self, share: f64) -> Result<Self, Error> {
        let share = check::non_negative("range share", share)?;
        Ok(Self { range_share: share * share, ..self })
    }

    /// The sensor's lever `R(θ) m`, and from there to the landmark.
    #[inline]
    fn offsets<X: PlanarState<N>, const N: usize>(&self, state: &X) -> (Vector2<f64>, Vector2<f64>) {
        let lever = self.base_from_sensor.translation();
        // Most sensors are looked at from where they are mounted: no sine is needed then.
        let lever = if lever.x == 0.0 && lever.y == 0.0 { lever } else { state.pose().rotation().act(&lever) };
        (lever, self.position - state.position() - lever)
    }

    #[inline]
    fn bearing<X: PlanarState<N>, const N: usize>(&self, state: &X, offset: &Vector2<f64>) -> f64 {
        let mount = self.base_from_sensor.rotation();
        let mount = if mount.sin() == 0.0 && mount.cos() > 0.0 { 0.0 } else { mount.angle() };
        wrap_angle(offset.y.atan2(offset.x) - state.yaw() - mount)
    }

    #[inline]
    fn by_pose(lever: &Vector2<f64>, offset: &Vector2<f64>, range: f64) -> Matrix2x3<f64> {
        let (c, s) = (offset.x / range, offset.y / range);
        // How the sensor moves when the vehicle turns.
        let swing = Vector2::new(-lever.y, lever.x);
        let by_range = -(c * swing.x + s * swing.y);
        let by_bearing = (s * swing.x - c * swing.y) / range - 1.0;
        Matrix2x3::new(-c, -s, by_range, s / range, -c / range, by_bearing)
    }

    #[inline]
    fn noise_at(&self, range: f64) -> Matrix2<f64> {
        Matrix2::new(self.range_variance + self.range_share * range * range, 0.0, 0.0, self.bearing_variance)
    }
}

impl<X: PlanarState<N>, const N: usize> MeasurementModel<X, N, 2> for Landmark {
    type Value = Vector2<f64>;

    #[inline]
    fn predict(&self, state: &X) -> Vector2<f64> {
        let (_, offset) = self.offsets(state);
        Vector2::new(offset.norm(), self.bearing(state, &offset))
    }

    #[inline]
    fn jacobian(&self, state: &X) -> SMatrix<f64, 2, N> {
        let (lever, offset) = self.offsets(state);
        state.lift(&Self::by_pose(&lever, &offset, offset.norm()))
    }

    #[inline]
    fn noise(&self, state: &X) -> Matrix2<f64> {
        self.noise_at(self.offsets(state).1.norm())
    }

    #[inline]
    fn residual(&self, measured: &Vector2<f64>, expected: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(measured.x - expected.x, angle_difference(measured.y, expected.y))
    }

    #[inline]
    fn linearize(&self, state: &X) -> Expected<Vector2<f64>, N, 2> {
        let (lever, offset) = self.offsets(state);
        let range = offset.norm();
        Expected {
            value: Vector2::new(range, self.bearing(state, &offset)),
            jacobian: state.lift(&Self::by_pose(&lever, &offset, range)),
            noise: self.noise_at(range),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{PlanarPose, Wrapped, laws};
    use nalgebra::{SVector, Vector3};
    use proptest::prelude::*;

    fn mounted() -> Landmark {
        let landmark = Landmark::new(Vector2::new(4.0, 3.0), &Vector2::new(0.1, 0.02)).unwrap();
        landmark.with_mount(Se2::new(0.3, -0.2, 0.8)).unwrap().with_range_share(0.05).unwrap()
    }

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(x in -3.0..3.0_f64, y in -3.0..2.0_f64, yaw in -3.1..3.1_f64) {
            let pose = Vector3::new(x, y, yaw);
            prop_assert!(laws::measurement_jacobian(&mounted(), &PlanarPose::from(pose)) < 1e-8);
            prop_assert!(laws::measurement_jacobian(&mounted(), &Se2::new(x, y, yaw)) < 1e-8);
            // Behind a speed, with a yaw rate after it.
            let longer = Wrapped::<5, 0b01000>::from(SVector::<f64, 5>::new(x, y, 0.5, yaw, 0.1));
            prop_assert!(laws::measurement_jacobian(&mounted(), &longer) < 1e-8);
        }

        /// The reading is where the landmark is in the sensor's frame.
        #[test]
        fn readings_are_places_in_the_sensors_frame(x in -3.0..3.0_f64, y in -3.0..2.0_f64, yaw in -3.1..3.1_f64) {
            let pose = Se2::new(x, y, yaw);
            let seen = mounted().predict(&pose);
            let place = (pose * mounted().base_from_sensor).act(&(Vector2::new(seen.y.cos(), seen.y.sin()) * seen.x));
            prop_assert!((place - mounted().position).norm() < 1e-12);
        }
    }

    #[test]
    fn ranges_are_noisier_afar() {
        let noise = |x| {
            MeasurementModel::<PlanarPose, 3, 2>::noise(
                &mounted().with_mount(Se2::default()).unwrap(),
                &Wrapped::from(Vector3::new(x, 3.0, 0.0)),
            )
        };
        assert!(
            (noise(0.0)[(0, 0)] - (0.01 + 0.04)).abs() < 1e-12 && (noise(2.0)[(0, 0)] - (0.01 + 0.01)).abs() < 1e-12
        );
    }

    #[test]
    fn bad_landmarks_are_refused() {
        let sigmas = Vector2::new(0.1, 0.1);
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(Landmark::new(Vector2::new(0.0, bad), &sigmas).is_err());
            assert!(mounted().with_mount(Se2::new(bad, 0.0, 0.0)).is_err());
        }
        for bad in [f64::NAN, f64::INFINITY, -0.1] {
            assert!(Landmark::new(Vector2::zeros(), &Vector2::new(bad, 0.1)).is_err());
            assert!(Landmark::new(Vector2::zeros(), &Vector2::new(0.1, bad)).is_err());
            assert!(mounted().with_range_share(bad).is_err());
        }
        assert!(Landmark::new(Vector2::zeros(), &Vector2::new(0.0, 0.1)).is_err());
    }
}
