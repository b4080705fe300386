//! Following a moving lidar: what its methods share.

mod follow;
mod point_map;
mod prior;

pub use follow::{Follow, FollowParams};
pub use point_map::PointMap;
pub(crate) use prior::MotionPrior;
