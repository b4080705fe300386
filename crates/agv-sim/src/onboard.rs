//! What rides on a vehicle whatever world it drives in: inertial units and encoders, each at its own rate.

use crate::{Error, Imu, InertialTruth, Vehicle, WheelEncoders, WheelReading};
use agv_core::{
    check,
    geometry::Twist2,
    odometry::OdometryIncrement,
    sensors::{ImuSample, SensorId},
};

/// A sensor that reads after every so many steps.
#[derive(Debug, Clone)]
pub(crate) struct Scheduled<S> {
    pub(crate) sensor: S,
    every: u64,
    /// Whether it has read in the step that was taken last.
    pub(crate) due: bool,
}

impl<S> Scheduled<S> {
    pub(crate) const fn new(sensor: S, every: u64) -> Self {
        Self { sensor, every, due: false }
    }

    /// Whether it reads after this step; `every` of zero means never.
    pub(crate) const fn tick(&mut self, step: u64) -> bool {
        self.due = self.every > 0 && step.is_multiple_of(self.every);
        self.due
    }
}

/// Refuses a second sensor of one kind with one number: their readings and their noise would be the same stream.
pub(crate) fn admit(
    kind: &'static str,
    sensor: SensorId,
    mut present: impl Iterator<Item = SensorId>,
) -> Result<(), Error> {
    if present.any(|taken| taken == sensor) { Err(Error::SensorTaken { kind, sensor }) } else { Ok(()) }
}

/// A vehicle with its inertial units and encoders, in steps of `dt` seconds.
#[derive(Debug, Clone)]
pub(crate) struct Onboard {
    pub(crate) vehicle: Vehicle,
    pub(crate) dt: f64,
    pub(crate) steps: u64,
    imus: Vec<Scheduled<Imu>>,
    encoders: Vec<Scheduled<WheelEncoders>>,
}

impl Onboard {
    pub(crate) fn new(vehicle: Vehicle, dt: f64) -> Result<Self, Error> {
        check::positive("dt", dt)?;
        Ok(Self { vehicle, dt, steps: 0, imus: Vec::new(), encoders: Vec::new() })
    }

    pub(crate) fn add_imu(&mut self, imu: Imu, every: u64) -> Result<(), Error> {
        admit("IMU", imu.params().sensor, self.imus.iter().map(|s| s.sensor.params().sensor))?;
        self.imus.push(Scheduled::new(imu, every));
        Ok(())
    }

    pub(crate) fn add_encoders(&mut self, encoders: WheelEncoders, every: u64) -> Result<(), Error> {
        admit("set of encoders", encoders.params().sensor, self.encoders.iter().map(|s| s.sensor.params().sensor))?;
        self.encoders.push(Scheduled::new(encoders, every));
        Ok(())
    }

    /// Drives for one step and reads what is due. A refused command changes nothing.
    pub(crate) fn step(&mut self, command: &Twist2) -> Result<OdometryIncrement, Error> {
        let odometry = self.vehicle.step(command, self.dt)?;
        self.steps += 1;
        let truth = self.vehicle.truth();
        let inertial = InertialTruth::planar(truth.map_from_base.yaw(), &truth.twist, &truth.acceleration);
        for imu in &mut self.imus {
            if imu.tick(self.steps) {
                imu.sensor.sample(&inertial, truth.stamp, self.dt * imu.every as f64)?;
            }
        }
        for encoders in &mut self.encoders {
            if encoders.tick(self.steps) {
                encoders.sensor.read(&self.vehicle);
            }
        }
        Ok(odometry)
    }

    /// Reads the encoders as the vehicle stands: the reference of their odometry. An IMU has no reading of a moment.
    pub(crate) fn look(&mut self) {
        self.imus.iter_mut().for_each(|imu| imu.due = false);
        for encoders in &mut self.encoders {
            encoders.due = true;
            encoders.sensor.read(&self.vehicle);
        }
    }

    pub(crate) fn imu_samples(&self) -> impl Iterator<Item = &ImuSample> {
        self.imus.iter().filter(|imu| imu.due).filter_map(|imu| imu.sensor.last())
    }

    pub(crate) fn wheel_readings(&self) -> impl Iterator<Item = &WheelReading> {
        self.encoders.iter().filter(|encoders| encoders.due).map(|encoders| encoders.sensor.last())
    }
}
