//! A deterministic simulator: worlds, sensors and vehicles with ground truth, for examples, tests and benches.
//!
//! - **Planar**: [`World2d`] of exact shapes or [`GridWorld`] over an occupancy map, scanned by a [`Laser`]; a [`Body`]
//!   for contact and clearance; [`MovingDiscs`] along key frames.
//! - **Spatial**: [`World3d`] of boxes, cylinders, ramps and planes, a generated [`Factory`], scanned by a [`Lidar`]; its
//!   sections are planar worlds and maps, so that 2D and 3D see one hall.
//! - **Vehicle**: a [`Vehicle`] with lagging drives, slip and noisy odometry, an [`Imu`], a [`FloorCamera`] over QR codes
//!   and a [`FrontCamera`] towards landmarks.
//! - [`Simulator2d`] puts world, vehicle and laser together, one step at a time. Ground truth can be asked of every part.
//!
//! Units are metres, seconds and radians; frames follow REP-103, and poses are named `target_from_source`. All
//! randomness comes from a [`Seed`](agv_core::compute::Seed), keyed by the step: a run can be replayed bit by bit, on
//! any number of threads.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod bvh;
mod camera;
mod collision;
mod error;
mod factory;
mod imu;
mod laser;
mod lidar;
mod markers;
mod noise;
mod obstacles;
mod odometry_noise;
mod simulator;
mod vehicle;
mod world2d;
mod world3d;

pub use camera::{FloorCamera, FloorCameraParams, FrontCamera, FrontCameraParams};
pub use collision::Body;
pub use error::Error;
pub use factory::{Factory, FactoryParams};
pub use imu::{GRAVITY, Imu, ImuParams, ImuReading, InertialNoise, InertialTruth};
pub use laser::{Laser, LaserParams, NoReturnReading};
pub use lidar::{Lidar, LidarParams};
pub use markers::{CodeSighting, FloorCode, Landmark, LandmarkSighting};
pub use obstacles::{KeyFrame, MovingDisc, MovingDiscs};
pub use odometry_noise::OdometryErrors;
pub use simulator::{Observation, Simulator2d};
pub use vehicle::{SlipParams, Vehicle, VehicleParams};
pub use world2d::{GridWorld, PlanarWorld, Populated, Shape, World2d};
pub use world3d::{Fixture, Hit, Solid, World3d};
