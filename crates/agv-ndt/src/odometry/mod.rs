//! Following a moving lidar: what its methods share.

mod follow;
mod point_map;
mod prior;
mod tracker;
mod window;

pub use follow::{Follow, FollowParams};
pub use point_map::PointMap;
use prior::{MotionPrior, is_skewed, sweep};
pub(crate) use tracker::{LEAST_SIGMA, Matcher, Tracked, Tracker};
pub(crate) use window::Window;
