//! What every crate of `agv-nav` speaks: geometry, frames, kinematics, odometry, sensors, grids, small solvers,
//! trajectory metrics, and the roles that localizers, planners and controllers play.
//!
//! # Overview
//! The crate is a value library: no I/O, no clock, no global state, no threads of its own. Everything that can be
//! wrong with an input is checked once, where the value is built, and named by [`Error`].
//!
//! # Usage
//! ```
//! use agv_core::geometry::Se2;
//!
//! // Frames: a pose is named `target_from_source` and maps points of `source` into `target`.
//! let map_from_odom = Se2::new(1.0, 2.0, 0.0);
//! let odom_from_base = Se2::new(0.5, 0.0, std::f64::consts::FRAC_PI_2);
//! let map_from_base = map_from_odom * odom_from_base;
//! assert!((map_from_base.x() - 1.5).abs() < 1e-12);
//! ```
//!
//! # Conventions
//! SI units and radians. Poses, covariances and normal equations are `f64`; stored scans, clouds and fields are `f32`.
//! Frames follow REP-103 (x forward, y left, z up). Time is a [`Stamp`](time::Stamp) in the caller's epoch.
//!
//! # Features
//! - `rayon` (default): parallel loops behind [`Par`](compute::Par); the results have the same bits without it.
//! - `serde`: parameters, maps and states round-trip; loading validates.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod check;
pub mod compute;
mod error;
pub mod frames;
pub mod geometry;
pub mod grid;
pub mod kinematics;
pub mod metrics;
pub mod obstacle;
pub mod odometry;
pub mod path;
pub mod roles;
pub mod sensors;
pub mod solve;
#[cfg(feature = "serde")]
mod stored_readings;
pub mod time;
pub mod trajectory;

pub use error::Error;
pub use nalgebra;
