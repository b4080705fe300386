//! What moves around the vehicle: obstacles found in laser scans and followed over time.
//!
//! # Parts
//! - [`ScanClusters`]: the hits of a scan in groups, each the surface of one thing.
//! - [`Outline`]: where such a thing is and how large, by a disc fitted to its points, or by their hull.
//! - [`Assignment`]: which cluster belongs to which track, at the least cost.
//! - [`ConstantVelocity`]: the motion between two scans, for the Kalman filters of [`kalman`](crate::kalman).
//! - [`ObstacleTracker`]: puts them together and tells what moves, as [`MovingObstacle`](agv_core::obstacle::MovingObstacle)s.
//!
//! # What counts as moving
//! A velocity alone is no proof: the visible end of a wall moves with the shadow of whoever passes before it. So an obstacle
//! moves only if its velocity is significant *and* it is where earlier scans saw through, or has left where it was: what
//! stands still never does either (see [`ObstacleTracker`]).

mod assignment;
mod clusters;
mod motion;
mod outline;
mod params;
mod track;
mod tracker;
mod views;

pub use assignment::Assignment;
pub use clusters::{Cluster, ClusterParams, ScanClusters};
pub use motion::ConstantVelocity;
pub use outline::Outline;
pub use params::TrackerParams;
pub use tracker::{ObstacleTracker, TrackedObstacle};
