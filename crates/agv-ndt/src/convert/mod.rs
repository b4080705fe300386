//! From 3D to 2D: what planar filters and planners need of a cloud.

mod to_scan;

pub use to_scan::{CloudToScan, CloudToScanParams, CloudToScanReport};
