//! Maps of sites that are larger than a lidar sees: key frames, loops, and the map that they make.
//!
//! Odometry drifts, and a place that is met again is met elsewhere. [`KeyFrameMapper`] follows any
//! [`LidarOdometry`](agv_core::roles::LidarOdometry) and
//!
//! 1. keeps a thinned cloud every metre or so, as a pose of a graph that odometry ties to the one before (a *key
//!    frame*),
//! 2. seeks each key frame among older ones, around where it should be and by how it looks
//!    ([`ScanContexts`](agv_ndt::places::ScanContexts)), and verifies what it finds by a
//!    [`Registration`](agv_core::roles::Registration) with the clouds around it,
//! 3. believes a find that the graph can explain, that others agree with, and that no other find contradicts,
//! 4. solves the graph, and takes out what contradicts the rest,
//! 5. forgets a key frame that was found right at an older one, and follows that one instead: memory grows with the
//!    site, not with the way.
//!
//! [`KeyFrameMap`] is what it knows, a value: the corrected trajectory, and maps of it by tile.
//! [`SiteMapper`](crate::pipeline::csns::SiteMapper) is the shorter way where all of a site is in sight of its map.

mod candidates;
#[cfg(feature = "serde")]
mod checkpoint;
mod closures;
mod drift;
mod known;
mod map;
mod mapper;
mod neighbours;
mod params;
#[cfg(test)]
mod tests;

pub use map::{KeyFrame, KeyFrameMap};
pub use mapper::{KeyFrameMapper, KeyFrameStep};
pub use params::{KeyFrameParams, LidarDrift, LoopParams};
