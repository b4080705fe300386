//! The wheel odometry that fits a simulated drive.

use crate::{Drive, Error, WheelReading};
use agv_core::{
    kinematics::{Ackermann, DifferentialDrive, DoubleAckermann, Mecanum, Tricycle},
    odometry::{EncoderParams, OdometryIncrement, WheelNoise, WheelOdometry},
};

/// [`WheelOdometry`] of whatever drive a [`Vehicle`](crate::Vehicle) has, from what its
/// [`WheelEncoders`](crate::WheelEncoders) read.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::odometry::WheelNoise;
/// use agv_sim::{Odometer, Vehicle, VehicleParams, WheelEncoders, WheelEncodersParams};
///
/// let mut vehicle = Vehicle::new(VehicleParams::default(), Se2::default(), Seed(1))?;
/// let mut encoders = WheelEncoders::new(WheelEncodersParams::default(), Seed(1))?;
/// let mut odometer = Odometer::new(&vehicle.params().drive, encoders.params().encoder, WheelNoise::default())?;
/// assert!(odometer.update(&encoders.read(&vehicle))?.is_none()); // the first reading is the reference
/// vehicle.step(&Twist2::new(0.8, 0.0, 0.0), 0.5)?;
/// let motion = odometer.update(&encoders.read(&vehicle))?.expect("there is a reference");
/// assert!((motion.start_from_end.x() - vehicle.map_from_base().x()).abs() < 1e-3);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Odometer(Kind);

#[derive(Debug, Clone, PartialEq)]
enum Kind {
    Differential(WheelOdometry<DifferentialDrive, 2>),
    Ackermann(WheelOdometry<Ackermann, 1, 1>),
    DoubleAckermann(WheelOdometry<DoubleAckermann, 1, 2>),
    Tricycle(WheelOdometry<Tricycle, 1, 1>),
    Mecanum(WheelOdometry<Mecanum, 4>),
}

impl Odometer {
    /// Odometry of a drive with equal encoders on all wheels.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(drive: &Drive, encoder: EncoderParams, noise: WheelNoise) -> Result<Self, Error> {
        Ok(Self(match drive {
            Drive::Differential(model) => Kind::Differential(WheelOdometry::new(*model, encoder, noise)?),
            Drive::Ackermann(model) => Kind::Ackermann(WheelOdometry::new(*model, encoder, noise)?),
            Drive::DoubleAckermann(model) => Kind::DoubleAckermann(WheelOdometry::new(*model, encoder, noise)?),
            Drive::Tricycle(model) => Kind::Tricycle(WheelOdometry::new(*model, encoder, noise)?),
            Drive::Mecanum(model) => Kind::Mecanum(WheelOdometry::new(*model, encoder, noise)?),
        }))
    }

    /// The motion since the last reading, at the steering angles of this one; none for the first.
    ///
    /// # Errors
    /// As [`WheelOdometry::update`].
    pub fn update(&mut self, reading: &WheelReading) -> Result<Option<OdometryIncrement>, Error> {
        let stamp = reading.stamp();
        Ok(match &mut self.0 {
            Kind::Differential(odometry) => odometry.update(stamp, reading.ticks(), reading.steering())?,
            Kind::Ackermann(odometry) => odometry.update(stamp, reading.ticks(), reading.steering())?,
            Kind::DoubleAckermann(odometry) => odometry.update(stamp, reading.ticks(), reading.steering())?,
            Kind::Tricycle(odometry) => odometry.update(stamp, reading.ticks(), reading.steering())?,
            Kind::Mecanum(odometry) => odometry.update(stamp, reading.ticks(), reading.steering())?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Vehicle, VehicleParams, WheelEncoders, WheelEncodersParams};
    use agv_core::{
        compute::Seed,
        geometry::{LieGroup, Se2, Twist2},
        kinematics::{AckermannParams, DoubleAckermannParams, MecanumParams, TricycleParams},
    };

    /// On a floor without slip the odometry of every drive follows its vehicle, up to ticks and the sampling of the steering.
    #[test]
    fn every_drive_has_its_odometry() {
        for drive in [
            Drive::default(),
            Drive::Ackermann(Ackermann::new(AckermannParams::default()).unwrap()),
            Drive::DoubleAckermann(DoubleAckermann::new(DoubleAckermannParams::default()).unwrap()),
            Drive::Tricycle(Tricycle::new(TricycleParams::default()).unwrap()),
            Drive::Mecanum(Mecanum::new(MecanumParams::default()).unwrap()),
        ] {
            let mut vehicle = Vehicle::new(VehicleParams::new(drive), Se2::default(), Seed(1)).unwrap();
            let mut encoders = WheelEncoders::new(WheelEncodersParams::default(), Seed(1)).unwrap();
            let mut odometer = Odometer::new(&drive, encoders.params().encoder, WheelNoise::default()).unwrap();
            let mut odom_from_base = Se2::default();
            for _ in 0..200 {
                if let Some(motion) = odometer.update(&encoders.read(&vehicle)).unwrap() {
                    odom_from_base = odom_from_base * motion.start_from_end;
                }
                vehicle.step(&Twist2::new(0.6, 0.0, 0.2), 0.02).unwrap();
            }
            let end = odometer.update(&encoders.read(&vehicle)).unwrap().unwrap();
            let error = (odom_from_base * end.start_from_end).minus(&vehicle.map_from_base());
            assert!(error.norm() < 2e-3 && vehicle.map_from_base().x() > 1.0, "{drive:?}: {error}");
        }
    }
}
