//! Sensor fusion: any mix of odometry, inertial units, poses, places and velocities, each with its own time, rate, noise and
//! mount.
//!
//! [`FusionFilter`] is what users of `robot_localization` know as its EKF node (Moore and Stouch 2014), in the plane:
//!
//! - every source has its own [`SourceParams`]: which numbers count ([`Components`]), what poses refer to ([`Reference`]: the map,
//!   the measurement before, the first one), noise, gate, latency, time-out; mounts come with the measurements;
//! - measurements come in any order and are applied in the order of their stamps, from a bounded history;
//! - what users of such filters meet is mended by construction: a motion is measured between two poses of the state, so its
//!   covariance is right however it is sampled; velocities that nobody measures do not grow without bound; a clock that jumps is
//!   noticed; and [`SourceDiagnostics`] say which source disagrees.
//! - behind [`Localizer`](agv_core::roles::Localizer) and [`Correct`](agv_core::roles::Correct) it can take any other filter's
//!   place: [`FusionFilter::connect`] says which source is meant.
//!
//! Beside pose and velocity it estimates, where asked for, the gyro's bias, the scales of the wheels, and by how much one source of
//! poses in the map is later than it says ([`SourceParams::late`]). What it does not have: noise that grows with a range. A pose, a
//! place or a velocity has no range, and its driver states a covariance; ranges and bearings are those of landmarks, and
//! [`LandmarkFilter`](crate::landmark::LandmarkFilter) takes them in with noise in proportion to the range
//! ([`range_share`](crate::landmark::LandmarkFilterParams::range_share)), and hands its pose on to this filter.
//!
//! The covariance is one of right increments, in the frame of the base.

mod answers;
#[cfg(feature = "serde")]
mod checkpoint;
mod correct;
mod filter;
mod happen;
mod history;
mod linearize;
mod measurement;
mod params;
mod process;
mod report;
mod role;
mod source;
mod state;

pub use filter::FusionFilter;
pub use measurement::Measurement;
pub use params::{FusionParams, MotionParams, Wander};
pub use report::{FusedState, FusionOutcome, SourceDiagnostics};
pub use role::RoleInput;
pub use source::{Components, MotionNoise, NoiseFloor, Reference, SourceId, SourceParams};

#[cfg(test)]
mod tests;
