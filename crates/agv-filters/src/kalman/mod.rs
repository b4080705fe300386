//! Kalman filters: a Gaussian belief, moved by a model and corrected by measurements.
//!
//! - [`PoseFilter`]: the pose in the plane from wheel odometry and measured poses, with the odometry's yaw scale.

mod pose_filter;

pub use pose_filter::{PoseFilter, PoseFilterParams};
