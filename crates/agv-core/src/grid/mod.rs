//! Grids: where cells lie, what they hold, and what is computed on them.

mod beam_count;
mod beam_walk;
mod cells;
mod collision;
mod costmap;
mod distance;
mod evidence;
mod footprint;
mod gaussian;
mod inflation;
mod interpolate;
mod inverse_model;
mod layout;
mod likelihood;
mod occupancy;
mod ray_cast;
mod scan_insertion;
mod thresholds;
mod traversal;

pub use cells::{CellState, Grid};
pub use collision::{CollisionChecker, CollisionParams};
pub use costmap::{Costmap, cost};
pub use distance::{DistanceParams, DistanceTransform, distance_field};
pub use evidence::EvidenceGrid;
pub use footprint::Footprint;
pub use gaussian::{Gaussian2, GaussianGrid, GaussianParams, PointSums};
pub use inflation::{Inflation, InflationParams};
pub use inverse_model::{BeamEvidence, InverseModel, InverseModelParams, NoReturn, QUANTUM};
pub use layout::{Cell, GridLayout};
pub use likelihood::{LikelihoodField, LikelihoodFieldParams, UnknownSpace};
pub use occupancy::{OccupancyGrid, OccupancyParams};
pub use ray_cast::{RayCastParams, RayCaster, RayHit};
pub use scan_insertion::ScanInsertion;
pub use thresholds::{MapMode, OccupancyPercent, OccupancyThresholds};
pub use traversal::Traversal;
