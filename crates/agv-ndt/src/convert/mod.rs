//! From 3D to 2D.

mod to_grid;
mod to_scan;

pub use to_grid::{CloudToGrid, CloudToGridParams, CloudToGridReport};
pub use to_scan::{CloudToScan, CloudToScanParams, CloudToScanReport};
