//! What clouds go through before they are aligned. Down-sampling is in the core: [`VoxelGrid`](agv_core::sensors::VoxelGrid).

mod kd_tree;
mod normals;

pub use kd_tree::{KdTree, MAX_NEIGHBOURS, Neighbour};
pub use normals::NormalParams;
