//! What clouds go through before they are aligned. Down-sampling is in the core: [`VoxelGrid`](agv_core::sensors::VoxelGrid).

mod kd_tree;
mod lines;
mod normals;

pub use kd_tree::{KdTree, MAX_NEIGHBOURS, Neighbour};
pub use lines::LineFinder;
pub use normals::NormalParams;
