//! Grids: where cells lie, what they hold, and what is computed on them.

mod cells;
mod collision;
mod costmap;
mod distance;
mod footprint;
mod gaussian;
mod inflation;
mod layout;
mod ray_cast;

pub use cells::{CellState, Grid};
pub use collision::{CollisionChecker, CollisionParams};
pub use costmap::{Costmap, cost};
pub use distance::{DistanceParams, DistanceTransform, distance_field};
pub use footprint::Footprint;
pub use gaussian::{Gaussian2, GaussianGrid, GaussianParams, PointSums};
pub use inflation::{Inflation, InflationParams};
pub use layout::{Cell, GridLayout};
pub use ray_cast::{RayCastParams, RayCaster, RayHit};
