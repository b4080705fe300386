//! A sensor of the vehicle's pose: a laser tracker over reflectors, radio beacons, or a localizer as its user sees it.

use crate::noise::{Part, normal, own_seed};
use crate::{Error, Vehicle};
use agv_core::{
    check,
    compute::Seed,
    geometry::{LieGroup, Se2, UncertainPose},
    sensors::{PoseObservation, SensorId},
};
use nalgebra::{Matrix3, Vector3};

/// What a pose sensor is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSensorParams {
    /// Which sensor of the vehicle it is.
    pub sensor: SensorId,
    /// Standard deviation along each axis, in metres.
    pub position_sigma: f64,
    /// Standard deviation of the heading, in radians.
    pub yaw_sigma: f64,
}

impl Default for PoseSensorParams {
    /// 1 cm and half a degree: laser navigation by reflectors, or a good scan matcher.
    fn default() -> Self {
        Self { sensor: SensorId::default(), position_sigma: 0.01, yaw_sigma: 0.5_f64.to_radians() }
    }
}

/// Measures the pose of a [`Vehicle`] in the map, with white noise, and states its covariance.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_sim::{PoseSensor, PoseSensorParams, Vehicle, VehicleParams};
///
/// let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(3.0, 1.0, 0.2), Seed(1))?;
/// let seen = PoseSensor::new(PoseSensorParams::default(), Seed(1))?.read(&vehicle)?;
/// assert!((seen.map_from_base().mean().translation() - vehicle.map_from_base().translation()).norm() < 0.06);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct PoseSensor {
    params: PoseSensorParams,
    seed: Seed,
    step: u64,
}

impl PoseSensor {
    /// A sensor with its own source of randomness.
    ///
    /// # Errors
    /// A deviation that is not finite, or negative.
    pub fn new(params: PoseSensorParams, seed: Seed) -> Result<Self, Error> {
        check::non_negative("position_sigma", params.position_sigma)?;
        check::non_negative("yaw_sigma", params.yaw_sigma)?;
        Ok(Self { params, seed: own_seed(seed, Part::PoseSensor, params.sensor), step: 0 })
    }

    /// What the sensor is like.
    pub const fn params(&self) -> &PoseSensorParams {
        &self.params
    }

    /// Measures the pose of a vehicle as it is now.
    ///
    /// # Errors
    /// A vehicle that has left what numbers can hold.
    pub fn read(&mut self, vehicle: &Vehicle) -> Result<PoseObservation<Se2>, Error> {
        let PoseSensorParams { sensor, position_sigma, yaw_sigma } = self.params;
        let mut stream = self.seed.stream(self.step, 0);
        self.step += 1;
        let sigmas = Vector3::new(position_sigma, position_sigma, yaw_sigma);
        let error = sigmas.map(|sigma| normal(sigma, &mut stream));
        let covariance = Matrix3::from_diagonal(&sigmas.component_mul(&sigmas));
        let seen = UncertainPose::new(vehicle.map_from_base().plus(&error), covariance)?;
        Ok(PoseObservation::new(vehicle.now(), seen).with_sensor(sensor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::VehicleParams;

    /// Sample variances over 10 000 readings, each within 4.5 deviations of its own estimate, √(2/n).
    #[test]
    fn the_noise_has_the_stated_covariance() {
        let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(2.0, 1.0, 2.5), Seed(3)).unwrap();
        let mut sensor = PoseSensor::new(PoseSensorParams::default(), Seed(3)).unwrap();
        let n = 10_000_u32;
        let (mut squares, mut stated) = (Vector3::zeros(), Vector3::zeros());
        for _ in 0..n {
            let seen = sensor.read(&vehicle).unwrap().map_from_base();
            squares += seen.mean().minus(&vehicle.map_from_base()).map(|e| e * e);
            stated = seen.covariance().diagonal();
        }
        for (square, variance) in squares.iter().zip(stated.iter()) {
            let ratio = square / f64::from(n) / variance;
            assert!((ratio - 1.0).abs() < 4.5 * (2.0 / f64::from(n)).sqrt(), "{ratio}");
        }
    }

    #[test]
    fn bad_sensors_are_refused() {
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            let good = PoseSensorParams::default();
            assert!(PoseSensor::new(PoseSensorParams { position_sigma: bad, ..good }, Seed(0)).is_err());
            assert!(PoseSensor::new(PoseSensorParams { yaw_sigma: bad, ..good }, Seed(0)).is_err());
        }
    }
}
