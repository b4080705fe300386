//! A deterministic simulator: worlds, sensors and vehicles with ground truth, for examples, tests and benches.
//!
//! - **Planar**: [`World2d`] of exact shapes or [`GridWorld`] over an occupancy map, scanned by a [`Laser`]; a [`Body`]
//!   for contact and clearance; [`MovingDiscs`] along key frames.
//!
//! Units are metres, seconds and radians; frames follow REP-103, and poses are named `target_from_source`. All
//! randomness comes from a [`Seed`](agv_core::compute::Seed), keyed by the step: a run can be replayed bit by bit, on
//! any number of threads.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod bvh;
mod collision;
mod error;
mod factory;
mod laser;
mod lidar;
mod noise;
mod obstacles;
mod world2d;
mod world3d;

pub use collision::Body;
pub use error::Error;
pub use factory::{Factory, FactoryParams};
pub use laser::{Laser, LaserParams, NoReturnReading};
pub use lidar::{Lidar, LidarParams};
pub use obstacles::{KeyFrame, MovingDisc, MovingDiscs};
pub use world2d::{GridWorld, PlanarWorld, Populated, Shape, World2d};
pub use world3d::{Fixture, Hit, Solid, World3d};
