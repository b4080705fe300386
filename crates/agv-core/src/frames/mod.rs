//! Frames: where sensors, vehicle, odometry and map lie to each other, over time.
//!
//! [`FrameTree`] is to this library what tf2 is to ROS, as a value: no clock, no threads, no messages.

#[cfg(feature = "serde")]
mod checkpoint;
mod error;
mod history;
mod lookup;
mod tree;

pub use error::FrameError;
pub use history::Insertion;
pub use tree::{FrameTree, FrameTreeParams};
