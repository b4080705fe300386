//! A deterministic simulator: worlds, sensors and vehicles with ground truth, for examples, tests and benches.
//!
//! - **Planar**: [`World2d`] of exact shapes or [`GridWorld`] over an occupancy map, scanned by a [`Laser`]; a [`Body`]
//!   for contact and clearance; [`MovingDiscs`] along key frames.
//! - **Spatial**: [`World3d`] of boxes, cylinders, ramps and planes, a generated [`Factory`], scanned by a [`Lidar`]; its
//!   sections are planar worlds and maps, so that 2D and 3D see one hall.
//! - **Vehicle**: a [`Vehicle`] of any [`Drive`] with lagging wheels and steering, slip and noisy odometry,
//!   [`WheelEncoders`], an [`Imu`], a [`FloorCamera`] over QR codes, a [`CodeCamera`] for their pixels and a
//!   [`FrontCamera`] towards landmarks.
//! - **Tracking**: [`PathRunParams::drive`] lets a path tracker drive a vehicle along a path, with the encoders and a noisy
//!   [`PoseSensor`] in the loop, and judges it by the ground truth.
//! - [`Simulator2d`] and [`Simulator3d`] put world, vehicle and any number of sensors together, one step at a time. Ground
//!   truth can be asked of every part.
//!
//! Sensors report the types of [`agv_core::sensors`]; what only a simulator knows stays here.
//!
//! Units are metres, seconds and radians; frames follow REP-103, and poses are named `target_from_source`. All
//! randomness comes from a [`Seed`](agv_core::compute::Seed), keyed by the step: a run can be replayed bit by bit, on
//! any number of threads.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod bvh;
mod cloud_pair;
mod clutter;
mod code_camera;
mod collision;
mod drive;
mod encoders;
mod error;
mod factory;
mod floor_camera;
mod front_camera;
mod imu;
mod inertial;
mod laser;
mod lidar;
mod markers;
mod noise;
mod obstacles;
mod odometer;
mod odometry_noise;
mod onboard;
mod path_run;
mod pose_sensor;
mod simulator2d;
mod simulator3d;
mod vehicle;
mod vehicle_params;
mod world2d;
mod world3d;

pub use cloud_pair::CloudPair;
pub use clutter::{Clutter, ClutterParams};
pub use code_camera::{CodeCamera, CodeCameraParams};
pub use collision::Body;
pub use drive::{Drive, WheelStates};
pub use encoders::{WheelEncoders, WheelEncodersParams, WheelReading};
pub use error::Error;
pub use factory::{Factory, FactoryParams};
pub use floor_camera::{FloorCamera, FloorCameraParams};
pub use front_camera::{FrontCamera, FrontCameraParams};
pub use imu::{Imu, ImuParams, InertialNoise};
pub use inertial::InertialTruth;
pub use laser::{Laser, LaserParams, NoReturnReading};
pub use lidar::{Lidar, LidarParams};
pub use markers::{FloorCode, Landmark};
pub use obstacles::{KeyFrame, MovingDisc, MovingDiscs};
pub use odometer::Odometer;
pub use odometry_noise::OdometryErrors;
pub use path_run::{CrossTrack, PathRun, PathRunParams, PathRunSample, PoseLocalizer};
pub use pose_sensor::{PoseSensor, PoseSensorParams};
pub use simulator2d::{Observed2d, Simulator2d};
pub use simulator3d::{CloudTruth, Observed3d, Simulator3d};
pub use vehicle::{GroundTruth, Vehicle};
pub use vehicle_params::{SlipParams, VehicleParams};
pub use world2d::{GridWorld, PlanarWorld, Populated, Shape, World2d};
pub use world3d::{Fixture, Hit, Solid, World3d};
