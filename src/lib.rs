//! Navigation algorithms for automated guided vehicles: where am I, what does the world look like, where do I go, and
//! how do I get there.
//!
//! # Overview
//! The facade gathers the crates of the workspace under one name and adds ready-made compositions in [`pipeline`]:
//!
//! | module | crate | subject |
//! |---|---|---|
//! | [`core`] | `agv-core` | geometry, frames, kinematics, odometry, sensors, grids, metrics, and the roles of all parts |
//! | `filters` | `agv-filters` | localisation: Kalman and particle filters, sensor fusion, landmarks, codes on the floor |
//! | `plan` | `agv-plan` | planners on grids, ant colonies, hybrid A* for vehicles that steer, smoothing |
//! | `control` | `agv-control` | controllers and their tuning, path trackers |
//! | `ndt` | `agv-ndt` | 3D perception: multi-line clouds to single-line scans |
//!
//! Everything is a value with a documented contract: no I/O, no clock, no global state, no `unsafe`; the same inputs
//! and seed give the same bits for any number of threads.
//!
//! # Usage
//! Compose your own pipeline out of the roles in [`core::roles`], or take one from [`pipeline`]. The examples of the
//! repository are whole programs: `cargo run --release --example navigate` maps a building from a recorded log,
//! localises in it, plans across it and drives.
//!
//! # Features
//! - `filters`, `plan`, `control`, `ndt` (all default): one per capability.
//! - `rayon` (default): parallel loops; the results have the same bits without it.
//! - `serde`: parameters, maps and filter states round-trip, and a resumed run continues bit-identically.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod error;
pub mod pipeline;
pub mod prelude;

#[cfg(feature = "control")]
pub use agv_control as control;
pub use agv_core as core;
#[cfg(feature = "filters")]
pub use agv_filters as filters;
#[cfg(feature = "ndt")]
pub use agv_ndt as ndt;
#[cfg(feature = "plan")]
pub use agv_plan as plan;

pub use agv_core::nalgebra;
pub use error::Error;

/// The README's pipeline is compiled and run with the tests.
#[cfg(all(doctest, feature = "filters", feature = "plan", feature = "control"))]
#[doc = include_str!("../README.md")]
struct Readme;
