//! Grids: where cells lie, what they hold, and what is computed on them.

mod beam_walk;
mod cells;
mod costmap;
mod evidence;
mod inverse_model;
mod layout;
mod occupancy;
mod scan_insertion;
mod thresholds;
mod traversal;

pub use cells::{CellState, Grid};
pub use costmap::{Costmap, cost};
pub use evidence::EvidenceGrid;
pub use inverse_model::{BeamEvidence, InverseModel, InverseModelParams, NoReturn, QUANTUM};
pub use layout::{Cell, GridLayout};
pub use occupancy::{OccupancyGrid, OccupancyParams};
pub use scan_insertion::ScanInsertion;
pub use thresholds::{MapMode, OccupancyPercent, OccupancyThresholds};
pub use traversal::Traversal;
