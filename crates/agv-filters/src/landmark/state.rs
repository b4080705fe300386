//! A pose together with what is not known of odometry and sensor.

use crate::{
    kalman::{Manifold, PlanarState},
    particle::ParticleState,
};
use agv_core::geometry::{LieGroup, Se2};
use nalgebra::{SMatrix, SVector, Vector2};

/// Parameters beside the pose.
pub const PARAMETERS: usize = 12;

/// Degrees of freedom of a [`CalibratedPose`]: three of the pose, then the parameters.
pub const DEGREES: usize = 3 + PARAMETERS;

/// What is estimated beside the pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Parameter {
    /// Share by which ways are longer than the odometry says.
    SpeedScale,
    /// Way lost per radian of turn, in metres: wheels that scrub, or a drive that slows down in bends.
    TurnLoss,
    /// Share by which turns are greater than the odometry says.
    YawScale,
    /// Yaw rate beyond what the odometry says whenever it says that the vehicle turns, in rad/s: a gyro's bias, or turn rates that
    /// the drives round to their steps. Odometry that says straight on, or standing, is believed.
    YawBias,
    /// Seconds by which the motion is later than the odometry's stamps on the landmark sensor's clock: positive where the
    /// odometry states commands, or where the sensor's stamps are those of arrival.
    Latency,
    /// Share by which measured ranges are too long.
    RangeScale,
    /// Metres by which measured ranges are too long.
    RangeBias,
    /// Radians by which measured bearings are too great: how the sensor is turned on the vehicle.
    BearingBias,
    /// Bearing error that goes with the sine of the bearing, in radians: a focal length or an encoder's eccentricity.
    BearingSine,
    /// Bearing error that goes with one less the cosine of the bearing, in radians: a tilt or an encoder's eccentricity.
    BearingCosine,
    /// Speed beyond what scale and loss explain, in m/s; wanders.
    SpeedError,
    /// Yaw rate beyond what the scale explains, in rad/s; wanders.
    YawRateError,
}

impl Parameter {
    /// All of them, in the order of the state.
    pub const ALL: [Self; PARAMETERS] = [
        Self::SpeedScale,
        Self::TurnLoss,
        Self::YawScale,
        Self::YawBias,
        Self::Latency,
        Self::RangeScale,
        Self::RangeBias,
        Self::BearingBias,
        Self::BearingSine,
        Self::BearingCosine,
        Self::SpeedError,
        Self::YawRateError,
    ];

    /// Place among the parameters.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Place in an increment of the state.
    pub const fn row(self) -> usize {
        3 + self as usize
    }
}

/// A pose and the parameters of odometry and sensor.
///
/// Increments are along the axes of the vehicle, then the parameters in the order of [`Parameter::ALL`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CalibratedPose {
    /// Pose of the vehicle in the map, at the odometry's time.
    pub map_from_base: Se2,
    /// The parameters, in the order of [`Parameter::ALL`].
    pub parameters: SVector<f64, PARAMETERS>,
}

impl CalibratedPose {
    /// Value of a parameter.
    #[inline]
    pub fn get(&self, parameter: Parameter) -> f64 {
        self.parameters[parameter.index()]
    }
}

impl ParticleState for CalibratedPose {
    #[inline]
    fn is_finite(&self) -> bool {
        LieGroup::is_finite(&self.map_from_base) && self.parameters.iter().all(|value| value.is_finite())
    }
}

impl Manifold<DEGREES> for CalibratedPose {
    #[inline]
    fn boxplus(&self, increment: &SVector<f64, DEGREES>) -> Self {
        Self {
            map_from_base: self.map_from_base.plus(&increment.fixed_rows::<3>(0).into_owned()),
            parameters: self.parameters + increment.fixed_rows::<PARAMETERS>(3),
        }
    }

    #[inline]
    fn boxminus(&self, origin: &Self) -> SVector<f64, DEGREES> {
        let mut increment = SVector::<f64, DEGREES>::zeros();
        increment.fixed_rows_mut::<3>(0).copy_from(&self.map_from_base.minus(&origin.map_from_base));
        increment.fixed_rows_mut::<PARAMETERS>(3).copy_from(&(self.parameters - origin.parameters));
        increment
    }

    #[inline]
    fn reset_jacobian(correction: &SVector<f64, DEGREES>) -> Option<SMatrix<f64, DEGREES, DEGREES>> {
        let mut reset = SMatrix::<f64, DEGREES, DEGREES>::identity();
        let by_pose = Se2::right_jacobian(&correction.fixed_rows::<3>(0).into_owned());
        reset.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_pose);
        Some(reset)
    }
}

impl PlanarState<DEGREES> for CalibratedPose {
    #[inline]
    fn position(&self) -> Vector2<f64> {
        self.map_from_base.translation()
    }

    #[inline]
    fn yaw(&self) -> f64 {
        self.map_from_base.yaw()
    }

    #[inline]
    fn pose(&self) -> Se2 {
        self.map_from_base
    }

    #[inline]
    fn lift<const M: usize>(&self, by_pose: &SMatrix<f64, M, 3>) -> SMatrix<f64, M, DEGREES> {
        let mut by_state = SMatrix::<f64, M, DEGREES>::zeros();
        by_state.fixed_view_mut::<M, 3>(0, 0).copy_from(&self.map_from_base.lift(by_pose));
        by_state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::laws;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_laws_of_a_manifold_hold(x in prop::array::uniform15(-1.0..1.0_f64), step in prop::array::uniform15(-1.0..1.0_f64)) {
            let zero = CalibratedPose { map_from_base: Se2::default(), parameters: SVector::zeros() };
            let state = zero.boxplus(&SVector::from(x));
            prop_assert!(laws::manifold(&state, &SVector::from(step)) < 1e-8);
        }
    }

    #[test]
    fn every_parameter_has_its_place() {
        for (index, parameter) in Parameter::ALL.into_iter().enumerate() {
            assert_eq!((parameter.index(), parameter.row()), (index, index + 3));
        }
    }
}
