//! A vehicle that somebody drives along a path, and what its sensors say.

use crate::{Args, Result, hall};
use agv_nav::{
    control::track::{FollowerParams, PurePursuit, PurePursuitParams},
    core::{
        kinematics::Motion,
        path::Path,
        roles::{PathTracker as _, TrackStatus},
    },
    filters::fusion::{FusionParams, MotionNoise, SourceParams},
    pipeline::csns::InertialOdometry,
    prelude::{Seed, VehicleState},
};
use agv_sim::{Imu, ImuParams, Observed3d, Simulator3d, Vehicle, World3d};

/// Step of the simulation, in seconds.
pub(crate) const STEP: f64 = 0.02;

/// Longest drive, in seconds.
const LONGEST: f64 = 900.0;

/// Wheels and inertial unit of the vehicle as one odometry.
pub(crate) fn odometry() -> Result<InertialOdometry> {
    let motion =
        MotionNoise { position_per_metre: 1e-4, yaw_per_metre: 2e-4, yaw_per_radian: 1e-3, position_per_radian: 1e-4 };
    let wheels = SourceParams { motion, ..SourceParams::wheels() };
    Ok(InertialOdometry::new(FusionParams::default(), wheels, SourceParams::imu())?)
}

/// The vehicle with its sensors at the beginning of a path.
pub(crate) fn simulator<'a>(
    args: &Args,
    world: &'a World3d,
    start: agv_nav::prelude::Se2,
    speed: f64,
    seed: Seed,
) -> Result<Simulator3d<&'a World3d>> {
    let vehicle = Vehicle::new(hall::vehicle(speed)?, start, seed)?;
    let simulator = Simulator3d::new(world, vehicle, STEP)?;
    Ok(simulator.with_lidar(hall::lidar(args, seed)?)?.with_imu(Imu::new(ImuParams::default(), seed)?, 1)?)
}

/// Drives along `path` by the true pose, and hands over each step; says how long it took, in seconds.
pub(crate) fn along(
    args: &Args,
    world: &World3d,
    path: &Path,
    speed: f64,
    seed: Seed,
    mut each: impl FnMut(&Observed3d<'_>) -> Result<()>,
) -> Result<f64> {
    let start = path.points().first().ok_or("a path without points")?.pose;
    let mut simulator = simulator(args, world, start, speed, seed)?;
    let follower = FollowerParams {
        lateral_acceleration: 1.5,
        arrival_tolerance: 1.0,
        arrival_heading_tolerance: 1.0,
        goal_tolerance: 0.3,
        max_cross_track: 2.0,
        ..FollowerParams::default()
    };
    let params = PurePursuitParams { look_ahead_max: 4.0, follower, ..PurePursuitParams::default() };
    let (mut tracker, limits, mut motion) = (PurePursuit::new(params)?, hall::limits(speed), Motion::REST);
    tracker.set_path(path)?;
    // A moment of rest first, as before every drive.
    for step in 0..(LONGEST / STEP) as usize {
        let seen = simulator.step(&motion.twist)?;
        let truth = seen.truth;
        each(&seen)?;
        if step as f64 * STEP < 0.3 {
            continue;
        }
        let Motion { twist, steering } = motion;
        let state = VehicleState { map_from_base: truth.map_from_base, twist, steering };
        let command = tracker.command(&state, &limits, STEP)?;
        motion = command.motion;
        match command.status {
            TrackStatus::Tracking => {}
            TrackStatus::Arrived => return Ok((step + 1) as f64 * STEP),
            _ => return Err("the vehicle left its path".into()),
        }
    }
    Err("the drive does not end".into())
}
