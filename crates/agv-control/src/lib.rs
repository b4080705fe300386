//! How do I get there: controllers, their tuning, and path trackers.
//!
//! # Overview
//! - [`pid`]: discrete PID controllers, the [`Controller`](agv_core::roles::Controller) role.
//! - [`plant`]: what a controller drives, as models: transfer functions, the AGV's own, the stand-ins of the papers.
//! - [`step_response`]: how well a loop follows a step, and what a tuner minimises.
//! - [`margin`]: how far a loop is from instability.
//! - [`tune`]: the gains of a PID controller, or any parameters, for a step test or the user's cost; once, or while driving.
//! - [`optimize`]: what tuning rests on, minimising an [`Objective`] without derivatives, by particle swarms ([`pso`]),
//!   differential evolution or CMA-ES ([`evolution`]).
//! - [`track`]: path trackers, the [`PathTracker`](agv_core::roles::PathTracker) role. A tracker is a
//!   [`Follower`](track::Follower), which knows the path, the progress and the speed, and a
//!   [`Steering`](track::Steering) law, which knows how to turn.
//!
//! # Usage
//! ```
//! use agv_control::track::{PurePursuit, PurePursuitParams};
//! use agv_core::kinematics::MotionLimits;
//! use agv_core::nalgebra::Vector2;
//! use agv_core::path::Path;
//! use agv_core::roles::{PathTracker, TrackStatus, VehicleState};
//!
//! let path = Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(2.0, 0.0), Vector2::new(2.0, 2.0)])?;
//! let (limits, dt) = (MotionLimits::default(), 0.05);
//! let mut tracker = PurePursuit::new(PurePursuitParams::default())?;
//! tracker.set_path(&path)?;
//! let mut state = VehicleState::default();
//! loop {
//!     let command = tracker.command(&state, &limits, dt)?;
//!     state = state.after(&command.motion, dt); // the caller's vehicle
//!     if command.status == TrackStatus::Arrived {
//!         break;
//!     }
//! }
//! assert!((state.map_from_base.translation() - Vector2::new(2.0, 2.0)).norm() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod error;
pub mod evolution;
pub mod margin;
mod objective;
pub mod optimize;
pub mod pid;
pub mod plant;
pub mod pso;
pub mod step_response;
pub mod track;
pub mod tune;

pub use error::Error;
pub use objective::{BATCH, Objective};
