//! Where am I: Kalman filters, sensor fusion, Monte Carlo localisation, landmarks and markers, in a known map; and pose graphs, of
//! which maps are made.
//!
//! # Overview
//! [`kalman`] holds the Kalman filters over any state, motion and reading (extended, iterated, unscented, error-state), a
//! smoother and a bootstrap filter; [`kalman::PoseFilter`] smooths measured poses by odometry.
//!
//! [`fusion`] joins any mix of odometry, inertial units, poses, places and velocities ([`fusion::FusionFilter`]).
//!
//! [`landmark`] holds the filter for landmarks of which range and bearing are measured, which calibrates odometry and sensor on
//! the way: [`landmark::LandmarkFilter`].
//!
//! [`particle`] holds Monte Carlo localisation: a set of weighted poses that odometry moves ([`particle::MotionModel`])
//! and scans weigh ([`particle::SensorModel`]), put together by [`particle::Mcl`], which plays the roles
//! [`Localizer`](agv_core::roles::Localizer) and [`Correct`](agv_core::roles::Correct); [`particle::Amcl`] adapts the number of
//! particles and finds a vehicle that may be anywhere, or was carried away.
//!
//! [`graph`] holds poses that relations tie together, and corrects them all where a place is met again ([`graph::PoseGraph`],
//! [`graph::PoseGraphSolver`]), in the plane and in space.
//!
//! [`matching`] tells where a laser scan was taken by other scans or a map: [`matching::CorrelativeMatcher`] by a search,
//! [`matching::FieldMatcher`] from a guess.
//!
//! [`slam`] makes the map on the way: [`slam::GraphSlam`] ties scans together in a pose graph, [`slam::Rbpf`] gives each particle of a
//! filter a map of its own; [`slam::LandmarkSlam`] maps landmarks in place of scans.
//!
//! [`tracking`] finds what moves around the vehicle: [`tracking::ObstacleTracker`].
//!
//! [`marker`] turns codes and landmarks into poses: [`marker::CodeReader`] locates floor codes in an image,
//! [`marker::MarkerLocalizer`] makes a pose of them that a Kalman filter takes.
//!
//! # Features
//! - `rayon` (default): parallel loops behind [`Par`](agv_core::compute::Par); the results have the same bits without it.
//! - `serde`: parameters and whole filter states round-trip; loading validates.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod fusion;
pub mod graph;
pub mod kalman;
pub mod landmark;
pub mod marker;
pub mod matching;
pub mod particle;
pub mod slam;
pub mod tracking;
