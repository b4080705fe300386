//! Graph SLAM: scans matched to the ones before, loops closed, all poses corrected together.
//!
//! [`GraphSlam`] takes one scan after the other, with odometry or without, and does four things (Grisetti et al., *A tutorial on
//! graph-based SLAM*, 2010; the division of labour is that of Hess et al., *Real-time loop closure in 2D lidar SLAM*, 2016):
//!
//! 1. *Front end.* Each scan is matched against a target of the last key scans, from where odometry says the vehicle is: points onto
//!    lines first, an exhaustive search of a window where that does not fit.
//! 2. *Key scans.* Every third of a metre or so a scan is kept as a pose of the graph, related to the one before by the match and by
//!    odometry, each with its covariance; along a corridor that the match does not see, odometry alone counts where there is any, and
//!    where the match stands in for it, wheels that slip far beyond what they are trusted with pull next to nothing.
//! 3. *Loop closures.* A key scan is sought in groups of older ones around it by branch and bound, on wider cells than the front end's.
//!    What is found counts at once where the graph expected it; elsewhere it waits for others, of key scans a metre apart, that agree
//!    with it and with each other (the pairwise consistency of Mangelson et al., 2018, with sets gathered one by one from each that
//!    waits, and the largest of these taken).
//! 4. *Correction.* The pose graph is solved, closures that contradict the rest are taken out, and
//!    [`map`](GraphSlam::map) draws all key scans from their corrected poses.
//!
//! Time stamps are carried along and never computed with: clocks may jump. Readings know the geometry of their scanner, so that lasers
//! may be mounted upside down, off the vehicle's middle, or see a part of the surroundings only.

#[cfg(feature = "serde")]
mod checkpoint;
mod closures;
mod confirm;
mod correction;
mod key_scan;
mod params;
mod places;
mod results;
mod slam;
#[cfg(test)]
mod tests;

pub use params::{ClosureParams, GraphSlamParams, OdometryTrust};
pub use slam::{GraphSlam, SlamStep, TrackingOutcome};
