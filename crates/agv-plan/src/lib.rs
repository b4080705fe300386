//! Where do I go: planners on grids and in the neighbourhood of the vehicle.
//!
//! - [`aco`]: ant colonies, which [`AntColony`](aco::AntColony) makes a planner of.
//! - [`dwa`]: the dynamic window approach, which plays [`LocalPlanner`](agv_core::roles::LocalPlanner).
//! - [`grid`]: best-first search on costmaps. [`AStar`](grid::AStar), [`Jps`](grid::Jps), [`DStarLite`](grid::DStarLite) and others play
//!   [`GlobalPlanner`](agv_core::roles::GlobalPlanner); the parts they are made of (space, queue, heuristic, search) are
//!   open for use on their own.
//! - [`hybrid`]: [`HybridAStar`](hybrid::HybridAStar) for vehicles with a turning circle, which plays `GlobalPlanner` too, and
//!   the curves of Dubins and of Reeds and Shepp.
//! - [`local`]: what local planners share: the guard that keeps them safe, and what the path asks for.
//! - [`mppi`]: model predictive path integral control, [`Mppi`](mppi::Mppi), which plays [`LocalPlanner`](agv_core::roles::LocalPlanner).
//! - [`smooth`]: what turns a path of cells into one that a vehicle likes to follow.
//! - [`teb`]: the timed elastic band, [`Teb`](teb::Teb), which plays [`LocalPlanner`](agv_core::roles::LocalPlanner).
//!
//! Features: `rayon` (parallel loops, on by default) and `serde` (parameters round-trip).
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod aco;
pub mod dwa;
mod error;
pub mod grid;
pub mod hybrid;
pub mod local;
pub mod mppi;
pub mod smooth;
pub mod teb;

pub use error::Error;
