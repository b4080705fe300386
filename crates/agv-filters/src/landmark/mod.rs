//! Where am I, from landmarks of which range and bearing are measured: reflectors, barcode tubes, pillars.
//!
//! [`LandmarkFilter`] is an extended Kalman filter over the pose and all that is not known of odometry and sensor:
//!
//! ```text
//! state       pose  X in SE(2), right increments
//!             odometry   speed scale s_v, way lost in turns c, yaw scale s_ω and bias b_ω, latency τ
//!             sensor     range scale s_r and bias b_r, bearing bias b_0 and first harmonic b_1, b_2
//!             wander     speed error e_v, yaw rate error e_ω (first-order Gauss-Markov)
//! motion      v' = (1 + s_v) v - c |ω| + e_v       ω' = (1 + s_ω) ω + b_ω + e_ω
//! sighting    z_r = (1 + s_r) ρ + b_r              z_β = β + b_0 + b_1 sin β + b_2 (1 - cos β)
//!             of the pose at the odometry's time  t - τ
//! ```
//!
//! with `ρ` the distance of the landmark, or its depth along the sensor's axis ([`RangeKind`]), and `β` its bearing. Each
//! unknown is learnt from the sightings, from a prior of [`CalibrationPriors`]; a prior of zero deviation takes it out.
//!
//! - [`LandmarkMap`]: where the landmarks are.
//! - [`CalibratedOdometry`] and [`Sighting`]: the models, for filters of your own.
//! - [`CalibratedPose`]: the state; [`Parameter`]: what it holds beside the pose.

mod filter;
mod history;
mod map;
mod odometry;
mod params;
mod sighting;
mod state;
mod track;
mod view;

pub use filter::{LandmarkFilter, Learnt};
pub use map::LandmarkMap;
pub use odometry::{CalibratedOdometry, MotionPiece};
pub use params::{CalibrationPriors, EstimateClock, LandmarkFilterParams, OdometryNoise, Prior, RangeKind};
pub use sighting::Sighting;
pub use state::{CalibratedPose, DEGREES, PARAMETERS, Parameter};
pub(crate) use view::View;
