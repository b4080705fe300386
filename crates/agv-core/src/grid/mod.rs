//! Grids: where cells lie, what they hold, and what is computed on them.

mod beam_walk;
mod cells;
mod costmap;
mod layout;
mod traversal;

pub use cells::{CellState, Grid};
pub use costmap::{Costmap, cost};
pub use layout::{Cell, GridLayout};
pub use traversal::Traversal;
