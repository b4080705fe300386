//! Grids: where cells lie, what they hold, and what is computed on them.

mod cells;
mod costmap;
mod distance;
mod layout;
mod likelihood;

pub use cells::{CellState, Grid};
pub use costmap::{Costmap, cost};
pub use distance::{DistanceParams, DistanceTransform, distance_field};
pub use layout::{Cell, GridLayout};
pub use likelihood::{LikelihoodField, LikelihoodFieldParams, UnknownSpace};
