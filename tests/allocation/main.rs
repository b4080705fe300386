//! After warm-up, updates allocate nothing on the heap: a counting allocator proves it.
//!
//! A component is added by a test in the file of its subject: warm it up, then `counter::count` around its updates.

mod counter;
mod elastic_band;
mod frames_and_solvers;
mod gaussian;
mod grids;
mod kalman;
mod lidar_odometry;
mod localization;
mod mapping;
mod navigation;
mod particle_models;
mod planning;
mod registration;
#[path = "../scenes/mod.rs"]
mod scenes;
mod seeing;
mod sensors;
mod simulation;
mod tracking;
mod tuning;
