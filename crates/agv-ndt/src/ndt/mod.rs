//! The normal distributions transform.

mod eigen;
mod gaussian;
mod kernel;
mod level;
mod map;
mod mixture;
mod objective;
mod registration;
mod search;
mod table;

pub use gaussian::{Gaussian3, VoxelParams, VoxelSums};
pub use map::NdtMap;
pub use registration::{NdtParams, NdtRegistration};
pub use search::VoxelSearch;
