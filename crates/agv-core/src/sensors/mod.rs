//! What sensors report: laser scans and point clouds, each with the pose of the sensor on the vehicle.

mod laser_scan;
mod point_cloud;

pub use laser_scan::{Beam, LaserScan, ScanGeometry};
pub use point_cloud::{LidarReturn, PointCloud, PointSource};
