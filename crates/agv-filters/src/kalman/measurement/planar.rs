//! Readings of the pose in the plane, or of a part of it: heading, position, pose.

use super::MeasurementModel;
use crate::kalman::{Manifold, PlanarPose, PlanarState};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose, UncertainVector, angle_difference},
};
use nalgebra::{Matrix1, Matrix2, Matrix2x3, Matrix3, RowVector3, SMatrix, Vector1, Vector2, Vector3};

/// The heading in the map, in radians, as a compass or an integrated IMU reads it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct YawReading {
    variance: f64,
}

impl YawReading {
    /// A heading that is read with this standard deviation, in radians.
    ///
    /// # Errors
    /// [`Error::NotPositive`].
    pub fn new(sigma: f64) -> Result<Self, Error> {
        let sigma = check::positive("yaw sigma", sigma)?;
        Ok(Self { variance: sigma * sigma })
    }
}

impl<X: PlanarState<N>, const N: usize> MeasurementModel<X, N, 1> for YawReading {
    type Value = f64;

    #[inline]
    fn predict(&self, state: &X) -> f64 {
        state.yaw()
    }

    #[inline]
    fn jacobian(&self, state: &X) -> SMatrix<f64, 1, N> {
        state.lift(&RowVector3::new(0.0, 0.0, 1.0))
    }

    #[inline]
    fn noise(&self, _: &X) -> Matrix1<f64> {
        Matrix1::new(self.variance)
    }

    #[inline]
    fn residual(&self, measured: &f64, expected: &f64) -> Vector1<f64> {
        Vector1::new(angle_difference(*measured, *expected))
    }
}

/// The position in the map of a point of the vehicle, in metres: satellites, UWB, a total station.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionReading {
    noise: Matrix2<f64>,
    antenna: Vector2<f64>,
}

impl PositionReading {
    /// The position of the vehicle's origin, read with noise of this covariance, in m².
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::NotCovariance`].
    pub fn new(noise: Matrix2<f64>) -> Result<Self, Error> {
        check::covariance("position noise", &noise)?;
        Ok(Self { noise, antenna: Vector2::zeros() })
    }

    /// The noise of a reading that states its own.
    pub fn of(reading: &UncertainVector<2>) -> Self {
        Self { noise: *reading.covariance(), antenna: Vector2::zeros() }
    }

    /// The same of an antenna at this place on the vehicle, in metres.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn with_antenna(self, antenna: Vector2<f64>) -> Result<Self, Error> {
        check::all_finite("antenna", antenna.iter())?;
        Ok(Self { antenna, ..self })
    }

    #[inline]
    fn lever<X: PlanarState<N>, const N: usize>(&self, state: &X) -> Vector2<f64> {
        if self.antenna == Vector2::zeros() { self.antenna } else { state.pose().rotation().act(&self.antenna) }
    }
}

impl<X: PlanarState<N>, const N: usize> MeasurementModel<X, N, 2> for PositionReading {
    type Value = Vector2<f64>;

    #[inline]
    fn predict(&self, state: &X) -> Vector2<f64> {
        state.position() + self.lever(state)
    }

    #[inline]
    fn jacobian(&self, state: &X) -> SMatrix<f64, 2, N> {
        let lever = self.lever(state);
        state.lift(&Matrix2x3::new(1.0, 0.0, -lever.y, 0.0, 1.0, lever.x))
    }

    #[inline]
    fn noise(&self, _: &X) -> Matrix2<f64> {
        self.noise
    }

    #[inline]
    fn residual(&self, measured: &Vector2<f64>, expected: &Vector2<f64>) -> Vector2<f64> {
        measured - expected
    }
}

/// The pose in the map, `(x, y, yaw)`: another localizer, a floor code.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseReading {
    noise: Matrix3<f64>,
}

impl PoseReading {
    /// A pose whose `(x, y, yaw)` in the map is read with noise of this covariance, in m², m rad and rad².
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::NotCovariance`].
    pub fn new(noise: Matrix3<f64>) -> Result<Self, Error> {
        check::covariance("pose noise", &noise)?;
        Ok(Self { noise })
    }

    /// The noise of a pose that states its own, as all poses here do along the axes of the vehicle.
    pub fn of(reading: &UncertainPose<Se2>) -> Self {
        let turn = reading.mean().rotation_adjoint();
        Self { noise: crate::kalman::matrix::sandwich_plus(&turn, reading.covariance(), &Matrix3::zeros()) }
    }
}

impl<X: PlanarState<N>, const N: usize> MeasurementModel<X, N, 3> for PoseReading {
    type Value = PlanarPose;

    #[inline]
    fn predict(&self, state: &X) -> PlanarPose {
        let position = state.position();
        PlanarPose::from(Vector3::new(position.x, position.y, state.yaw()))
    }

    #[inline]
    fn jacobian(&self, state: &X) -> SMatrix<f64, 3, N> {
        state.lift(&Matrix3::identity())
    }

    #[inline]
    fn noise(&self, _: &X) -> Matrix3<f64> {
        self.noise
    }

    #[inline]
    fn residual(&self, measured: &PlanarPose, expected: &PlanarPose) -> Vector3<f64> {
        measured.boxminus(expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Ekf, Gate, PoseFilter, PoseFilterParams, TurningState, laws};
    use agv_core::{
        roles::{Correct, Localizer, PoseBelief},
        sensors::PoseObservation,
        time::Stamp,
    };
    use nalgebra::SVector;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(x in -3.0..3.0_f64, y in -3.0..3.0_f64, yaw in -3.1..3.1_f64) {
            let position = PositionReading::new(Matrix2::identity()).unwrap().with_antenna(Vector2::new(0.4, -0.7)).unwrap();
            let (heading, pose) = (YawReading::new(0.1).unwrap(), PoseReading::new(Matrix3::identity()).unwrap());
            let on_map = PlanarPose::from(Vector3::new(x, y, yaw));
            let turning = TurningState::from(SVector::<f64, 5>::new(x, y, 1.0, yaw, 0.3));
            let on_base = Se2::new(x, y, yaw);
            for worst in [
                laws::measurement_jacobian(&position, &on_map),
                laws::measurement_jacobian(&position, &turning),
                laws::measurement_jacobian(&position, &on_base),
                laws::measurement_jacobian(&heading, &on_map),
                laws::measurement_jacobian(&heading, &turning),
                laws::measurement_jacobian(&heading, &on_base),
                laws::measurement_jacobian(&pose, &on_map),
                laws::measurement_jacobian(&pose, &turning),
                laws::measurement_jacobian(&pose, &on_base),
            ] {
                prop_assert!(worst < 1e-8, "{}", worst);
            }
        }
    }

    /// A measured pose corrects as it does in the pose filter; to first order, since the residual there is along the vehicle's
    /// axes.
    #[test]
    fn poses_correct_as_in_the_pose_filter() {
        let (start, spread) =
            (Se2::new(1.0, 2.0, 0.7), Matrix3::new(4e-4, 1e-4, 0.0, 1e-4, 2e-4, 1e-5, 0.0, 1e-5, 1e-4));
        let seen = UncertainPose::new(Se2::new(1.004, 1.997, 0.702), spread * 0.5).unwrap();
        let mut special = PoseFilter::new(PoseFilterParams { yaw_scale_sigma: 0.0, ..Default::default() }).unwrap();
        special.initialize(&PoseBelief::around(start, spread).unwrap()).unwrap();
        special.update(&PoseObservation::new(Stamp::default(), seen)).unwrap();
        let expected = special.estimate().unwrap().pose;
        let mut ekf = Ekf::new(start, spread).unwrap();
        ekf.update(&PoseReading::of(&seen), &(*seen.mean()).into(), &Gate::OPEN).unwrap();
        assert!(ekf.state().minus(expected.mean()).amax() < 2e-5);
        assert!((ekf.covariance() - expected.covariance()).amax() < 1e-6);
    }

    #[test]
    fn bad_noise_is_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(YawReading::new(bad).is_err(), "{bad}");
        }
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(PositionReading::new(Matrix2::identity() * bad).is_err(), "{bad}");
            assert!(PoseReading::new(Matrix3::identity() * bad).is_err(), "{bad}");
        }
        let position = PositionReading::new(Matrix2::identity()).unwrap();
        assert!(position.with_antenna(Vector2::new(f64::NAN, 0.0)).is_err());
    }
}
