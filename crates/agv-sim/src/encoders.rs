//! Encoders on the wheels and the steered axles.

use crate::noise::{Part, normal, own_seed};
use crate::{Error, Vehicle};
use agv_core::{
    check,
    compute::Seed,
    odometry::{EncoderParams, TickCounter},
    sensors::{Observation, SensorId},
    time::Stamp,
};
use std::f64::consts::TAU;

/// What the encoders of a vehicle are like.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelEncodersParams {
    /// Which set of encoders of the vehicle it is.
    pub sensor: SensorId,
    /// Resolution and counter of each wheel's encoder.
    pub encoder: EncoderParams,
    /// Standard deviation of a measured steering angle, in radians.
    pub steering_sigma: f64,
}

/// What all encoders of a vehicle read at one time.
///
/// [`WheelOdometry`](agv_core::odometry::WheelOdometry) makes increments of it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelReading {
    stamp: Stamp,
    sensor: SensorId,
    ticks: [i64; 4],
    steering: [f64; 2],
}

impl WheelReading {
    /// When they were read.
    pub const fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Counts of the first `N` wheels, in the order of [`WheelStates`](crate::WheelStates): as the counters show them,
    /// wrapped around at their width. Zero for wheels that the vehicle does not have.
    pub fn ticks<const N: usize>(&self) -> [i64; N] {
        std::array::from_fn(|wheel| self.ticks.get(wheel).copied().unwrap_or(0))
    }

    /// Measured angles of the first `S` steered axles, front first, in radians; zero for what the vehicle does not have.
    pub fn steering<const S: usize>(&self) -> [f64; S] {
        std::array::from_fn(|axle| self.steering.get(axle).copied().unwrap_or(0.0))
    }
}

impl Observation for WheelReading {
    fn stamp(&self) -> Option<Stamp> {
        Some(self.stamp)
    }

    fn sensor(&self) -> SensorId {
        self.sensor
    }
}

/// The encoders of a [`Vehicle`]: whole ticks, wrapped counters, noisy steering angles.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::kinematics::DifferentialDrive;
/// use agv_core::odometry::{WheelNoise, WheelOdometry};
/// use agv_sim::{Vehicle, VehicleParams, WheelEncoders, WheelEncodersParams};
///
/// let mut vehicle = Vehicle::new(VehicleParams::default(), Se2::default(), Seed(1))?;
/// let params = WheelEncodersParams::default();
/// let mut encoders = WheelEncoders::new(params, Seed(1))?;
/// let mut odometry = WheelOdometry::new(DifferentialDrive::default(), params.encoder, WheelNoise::default())?;
/// let mut odom_from_base = Se2::default();
/// for _ in 0..100 {
///     let reading = encoders.read(&vehicle);
///     if let Some(motion) = odometry.update(reading.stamp(), reading.ticks(), reading.steering())? {
///         odom_from_base = odom_from_base * motion.start_from_end;
///     }
///     vehicle.step(&Twist2::new(0.8, 0.0, 0.2), 0.02)?;
/// }
/// // The floor does not slip: all that is lost is the last step and less than a tick per wheel.
/// assert!((odom_from_base.translation() - vehicle.map_from_base().translation()).norm() < 0.02);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct WheelEncoders {
    params: WheelEncodersParams,
    seed: Seed,
    step: u64,
    last: WheelReading,
}

impl WheelEncoders {
    /// Encoders with their own source of randomness.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: WheelEncodersParams, seed: Seed) -> Result<Self, Error> {
        TickCounter::new(params.encoder)?;
        check::non_negative("steering_sigma", params.steering_sigma)?;
        let seed = own_seed(seed, Part::Encoders, params.sensor);
        Ok(Self { params, seed, step: 0, last: WheelReading::default() })
    }

    /// What the encoders are like.
    pub const fn params(&self) -> &WheelEncodersParams {
        &self.params
    }

    /// What was read last.
    pub const fn last(&self) -> &WheelReading {
        &self.last
    }

    /// Reads the wheels of a vehicle as they are now.
    pub fn read(&mut self, vehicle: &Vehicle) -> WheelReading {
        let WheelEncodersParams { sensor, encoder, steering_sigma } = self.params;
        let mut stream = self.seed.stream(self.step, 0);
        self.step += 1;
        let mask = (u64::MAX >> (64 - encoder.counter_bits)) as i64;
        let count = |angle: f64| (angle / TAU * encoder.ticks_per_revolution).floor() as i64 & mask;
        self.last = WheelReading {
            stamp: vehicle.now(),
            sensor,
            ticks: vehicle.wheel_angles().map(count),
            steering: vehicle.wheels().steering.map(|angle| angle + normal(steering_sigma, &mut stream)),
        };
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Drive, VehicleParams};
    use agv_core::{
        geometry::{LieGroup, Se2, Twist2},
        kinematics::{DoubleAckermann, DoubleAckermannParams, Mecanum, MecanumParams, TwistLimits},
        odometry::{RollingModel, WheelNoise, WheelOdometry},
    };

    /// Drives a vehicle about and returns how far off the odometry of its encoders ends.
    fn drift<M: RollingModel<N, S>, const N: usize, const S: usize>(drive: Drive, model: M) -> f64 {
        let limits = TwistLimits { lateral_speed: 0.5, ..Default::default() };
        let params = VehicleParams { limits, ..VehicleParams::new(drive) };
        let mut vehicle = Vehicle::new(params, Se2::default(), Seed(1)).unwrap();
        let mut encoders = WheelEncoders::new(WheelEncodersParams::default(), Seed(1)).unwrap();
        let mut odometry = WheelOdometry::new(model, EncoderParams::default(), WheelNoise::default()).unwrap();
        let mut pose = Se2::default();
        for step in 0..=400 {
            let reading = encoders.read(&vehicle);
            if let Some(motion) = odometry.update(reading.stamp(), reading.ticks(), reading.steering()).unwrap() {
                pose = pose * motion.start_from_end;
            }
            if step < 400 {
                let sway = (f64::from(step) * 0.03).sin();
                vehicle.step(&Twist2::new(0.8, 0.2 * sway, 0.3 * sway), 0.02).unwrap();
            }
        }
        assert!(vehicle.map_from_base().translation().norm() > 3.0);
        pose.minus(&vehicle.map_from_base()).norm()
    }

    /// 6 m of bends, through several wraps of a 16-bit counter: whole ticks of 0.15 mm are all that is lost.
    #[test]
    fn odometry_of_the_counts_follows_the_vehicle() {
        let double = DoubleAckermann::new(DoubleAckermannParams::default()).unwrap();
        let mecanum = Mecanum::new(MecanumParams::default()).unwrap();
        let Drive::Differential(differential) = Drive::default() else { unreachable!() };
        for error in [
            drift(Drive::Differential(differential), differential),
            drift(Drive::DoubleAckermann(double), double),
            drift(Drive::Mecanum(mecanum), mecanum),
        ] {
            assert!(error < 0.003, "{error}");
        }
    }

    /// Chi-square over 4000 readings.
    #[test]
    fn steering_noise_has_the_stated_size() {
        let params = WheelEncodersParams { steering_sigma: 0.01, ..Default::default() };
        let mut encoders = WheelEncoders::new(params, Seed(2)).unwrap();
        let vehicle = Vehicle::new(VehicleParams::default(), Se2::default(), Seed(1)).unwrap();
        let squares: f64 = (0..4000).map(|_| (encoders.read(&vehicle).steering::<1>()[0] / 0.01).powi(2)).sum();
        assert!((squares - 4000.0).abs() < 4.5 * 8000_f64.sqrt(), "{squares}");
    }

    #[test]
    fn bad_encoders_are_refused() {
        let good = WheelEncodersParams::default();
        for bad in [
            WheelEncodersParams { steering_sigma: -0.1, ..good },
            WheelEncodersParams { steering_sigma: f64::NAN, ..good },
            WheelEncodersParams { encoder: EncoderParams { counter_bits: 0, ..good.encoder }, ..good },
            WheelEncodersParams { encoder: EncoderParams { ticks_per_revolution: 0.0, ..good.encoder }, ..good },
        ] {
            assert!(WheelEncoders::new(bad, Seed(0)).is_err(), "{bad:?}");
        }
    }
}
