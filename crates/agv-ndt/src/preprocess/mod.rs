//! What clouds go through before they are aligned. Down-sampling is in the core: [`VoxelGrid`](agv_core::sensors::VoxelGrid).

mod ground;
mod kd_tree;
mod lines;
mod normals;
mod outliers;
mod segment;
mod sparse;

pub use ground::{GroundFilter, GroundParams, GroundPlane};
pub use kd_tree::{KdTree, MAX_NEIGHBOURS, Neighbour};
pub use lines::LineFinder;
pub use normals::NormalParams;
pub use outliers::{OutlierFilter, OutlierParams};
pub use segment::{SegmentParams, Segmenter};
pub(crate) use sparse::is_one_of_every;
pub use sparse::one_of_every;
