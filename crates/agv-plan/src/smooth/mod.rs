//! What turns a path of cells into one that a vehicle likes to follow.

mod key_nodes;
mod line_of_sight;
mod straightened;

pub use key_nodes::{KeyNodes, KeyNodesParams};
pub use line_of_sight::LineOfSight;
pub use straightened::Straightened;
