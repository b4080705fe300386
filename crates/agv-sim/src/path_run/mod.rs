//! A vehicle that a path tracker drives along a path: the closed loop, judged by the ground truth.
//!
//! ```text
//! vehicle -> encoders -> odometry -> localizer -> pose -> tracker -> command -> vehicle
//!         -> pose sensor ----------------^                 ^            |
//!                                                          +-- motion --+
//! ```
//!
//! The tracker sees what a vehicle's computer would: encoders and a noisy pose, through a localizer if there is one, and its own
//! last command as the motion that the next may differ from within the limits. The truth is for the judgement alone.

mod cross_track;
mod params;

use crate::{Error, Odometer, PoseSensor, Vehicle, WheelEncoders};
use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2, angle_difference},
    kinematics::{Motion, MotionLimits},
    odometry::OdometryIncrement,
    path::Path,
    roles::{Correct, LocalizationError, PathTracker, PoseBelief, TrackStatus, VehicleState},
    sensors::PoseObservation,
};
pub use cross_track::CrossTrack;
pub use params::PathRunParams;

/// A localizer that takes measured poses.
pub type PoseLocalizer = dyn Correct<PoseObservation<Se2>, Pose = Se2>;

/// One cycle of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathRunSample {
    /// Seconds since the start.
    pub time: f64,
    /// Where the vehicle was.
    pub truth: Se2,
    /// What it did.
    pub twist: Twist2,
    /// Where it believed itself to be.
    pub estimate: Se2,
    /// What it was told.
    pub command: Motion,
    /// Its true distance from the path, in metres; positive to the left of the direction in which the path runs.
    pub cross_track: f64,
}

/// What became of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct PathRun {
    /// All cycles, from rest at the beginning of the path until the tracker arrived.
    pub samples: Vec<PathRunSample>,
    /// Whether the tracker arrived, in the time that there was.
    pub arrived: bool,
    /// Commands that broke a limit.
    pub violations: usize,
    /// Pose of the end of the path less the one where the vehicle came to rest, in the frame of the former.
    pub end_from_base: Se2,
}

impl PathRun {
    /// Root mean square of the true distance from the path over all cycles, the start from rest included, in metres.
    pub fn rmse(&self) -> f64 {
        let squares: f64 = self.samples.iter().map(|sample| sample.cross_track * sample.cross_track).sum();
        (squares / self.samples.len().max(1) as f64).sqrt()
    }

    /// Greatest true distance from the path, in metres.
    pub fn max(&self) -> f64 {
        self.samples.iter().map(|sample| sample.cross_track.abs()).fold(0.0, f64::max)
    }

    /// Duration, in seconds.
    pub fn duration(&self) -> f64 {
        self.samples.last().map_or(0.0, |sample| sample.time)
    }

    /// Distance between the end of the path and where the vehicle came to rest, in metres.
    pub fn final_position_error(&self) -> f64 {
        self.end_from_base.translation().norm()
    }

    /// Difference between the heading at the end of the path and that in which the vehicle came to rest, in radians, unsigned.
    pub fn final_heading_error(&self) -> f64 {
        self.end_from_base.yaw().abs()
    }
}

impl PathRunParams {
    /// Lets `tracker` drive along `path`, from rest at its beginning, with the pose that `localizer` makes of odometry and
    /// measured poses; without one it gets each pose as it is measured.
    ///
    /// # Errors
    /// A path without two distinct poses, a parameter out of its range, or what tracker and localizer refuse.
    pub fn drive(
        &self,
        tracker: &mut dyn PathTracker,
        localizer: Option<&mut PoseLocalizer>,
        path: &Path,
        seed: Seed,
    ) -> Result<PathRun, Error> {
        self.validate()?;
        let (Some(first), Some(last)) = (path.points().first(), path.points().last()) else {
            return Err(agv_core::Error::Empty { name: "path" }.into());
        };
        tracker.set_path(path)?;
        let mut vehicle = Vehicle::new(self.vehicle, first.pose, seed)?;
        let mut sensors = Sensors::new(self, localizer, seed)?;
        let mut cross_track = CrossTrack::new(path);
        let steers = self.limits.steering.is_some();
        let mut command = Motion { twist: Twist2::ZERO, steering: steers.then_some(0.0) };
        let mut run = PathRun { samples: Vec::new(), arrived: false, violations: 0, end_from_base: Se2::default() };
        let cycles = (self.timeout_for(path) / self.dt) as usize;
        for cycle in 0..cycles {
            let estimate = sensors.read(&vehicle)?;
            let state = VehicleState { map_from_base: estimate, twist: command.twist, steering: command.steering };
            let reply = tracker.command(&state, &self.limits, self.dt)?;
            run.violations += usize::from(!allowed(&self.limits, &command, &reply.motion, self.dt));
            command = reply.motion;
            let truth = vehicle.map_from_base();
            run.samples.push(PathRunSample {
                time: cycle as f64 * self.dt,
                truth,
                twist: vehicle.twist(),
                estimate,
                command,
                cross_track: cross_track.at(&truth.translation()),
            });
            run.arrived = reply.status == TrackStatus::Arrived;
            if run.arrived {
                break;
            }
            vehicle.step(&command.twist, self.dt)?;
        }
        for _ in 0..cycles {
            if vehicle.wheel_twist() == Twist2::ZERO {
                break;
            }
            vehicle.step(&Twist2::ZERO, self.dt)?;
        }
        run.end_from_base = last.pose.between(&vehicle.map_from_base());
        Ok(run)
    }
}

/// Encoders, pose sensor and what is made of them.
struct Sensors<'a> {
    encoders: WheelEncoders,
    odometer: Odometer,
    pose_sensor: PoseSensor,
    localizer: Option<&'a mut PoseLocalizer>,
}

impl<'a> Sensors<'a> {
    fn new(params: &PathRunParams, localizer: Option<&'a mut PoseLocalizer>, seed: Seed) -> Result<Self, Error> {
        let odometer = Odometer::new(&params.vehicle.drive, params.encoders.encoder, params.wheel_noise)?;
        let encoders = WheelEncoders::new(params.encoders, seed)?;
        Ok(Self { encoders, odometer, pose_sensor: PoseSensor::new(params.pose_sensor, seed)?, localizer })
    }

    /// Pose in the map.
    fn read(&mut self, vehicle: &Vehicle) -> Result<Se2, Error> {
        let motion = self.odometer.update(&self.encoders.read(vehicle))?;
        let seen = self.pose_sensor.read(vehicle)?;
        let Some(localizer) = self.localizer.as_deref_mut() else { return Ok(*seen.map_from_base().mean()) };
        Ok(localize(localizer, motion.as_ref(), &seen)?)
    }
}

/// The estimate after a motion and a measured pose, which begins the belief where there was no motion yet.
fn localize(
    localizer: &mut PoseLocalizer,
    motion: Option<&OdometryIncrement>,
    seen: &PoseObservation<Se2>,
) -> Result<Se2, LocalizationError> {
    match motion {
        Some(motion) => {
            localizer.predict(motion)?;
            localizer.update(seen)?;
        }
        None => localizer.initialize(&PoseBelief::Around(seen.map_from_base()))?,
    }
    localizer.estimate().map(|estimate| *estimate.map_from_base()).ok_or(LocalizationError::NotInitialized)
}

/// Whether a command may follow another, by the limits' own judgement and, where they are plain, by their numbers.
fn allowed(limits: &MotionLimits, from: &Motion, to: &Motion, dt: f64) -> bool {
    const HAIR: f64 = 1e-9;
    let (speed, twist) = (&limits.twist, &to.twist);
    let fast = twist.vx > speed.forward_speed + HAIR
        || twist.vx < -speed.reverse_speed - HAIR
        || twist.vy.abs() > speed.lateral_speed + HAIR
        || twist.yaw_rate.abs() > speed.yaw_rate + HAIR;
    let greatest = speed.acceleration.max(speed.deceleration) * dt + HAIR;
    let change = (twist.vx - from.twist.vx).abs().max((twist.vy - from.twist.vy).abs());
    let turned = (twist.yaw_rate - from.twist.yaw_rate).abs();
    let abrupt = change > greatest || (limits.steering.is_none() && turned > speed.yaw_acceleration * dt + HAIR);
    let swung = match (&limits.steering, from.steering, to.steering) {
        (Some(steering), Some(from), Some(to)) => {
            angle_difference(to, from).abs() > steering.max_rate * dt + HAIR || to.abs() > steering.max_angle + HAIR
        }
        _ => false,
    };
    limits.allows_step(from, to, dt) && !(fast || abrupt || swung)
}

#[cfg(test)]
mod tests;
