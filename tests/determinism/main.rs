//! Same inputs and seed, same bits: for any number of threads, and with or without the `rayon` feature.
//!
//! A component is added by a call of `digest::assert_same_bits` with a function that runs it under a `Par` and digests
//! all that it says. Every digest is printed, so that `.ci/run` compares the builds with and without `rayon`; those that
//! no `sin` or `exp` of the platform can change are stated in the test.

mod digest;
mod grids;
mod lidar_odometry;
mod local_planning;
mod localization;
mod mapping;
mod particle_models;
mod planning;
mod registration;
mod sensing;
mod slam;
mod threads;
mod tuning;

#[path = "../scenes/mod.rs"]
mod scenes;
