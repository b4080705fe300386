//! Following a moving lidar: what its methods share.

mod point_map;
mod prior;

pub use point_map::PointMap;
pub(crate) use prior::MotionPrior;
