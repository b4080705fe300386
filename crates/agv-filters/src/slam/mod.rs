//! Where am I, and what does the place look like: maps made on the way, of laser scans and odometry that drifts.
//!
//! [`graph`] ties scans together in a pose graph, closes loops and draws the map from the corrected poses.

pub mod graph;
