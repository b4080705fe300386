//! Planning for vehicles that steer: curves of bounded curvature, and hybrid A* on the lattice of poses.
//!
//! [`Dubins`] and [`ReedsShepp`] give the shortest way between two poses where nothing is in it; [`HybridAStar`] finds one
//! among obstacles and plays [`GlobalPlanner`](agv_core::roles::GlobalPlanner).
//!
//! ```text
//! Costmap, Footprint -> Site (what may be touched, coarse grid) -> Potential \
//! turning radius     -> CurveTable                               ------------> Guide \
//!                       motions                                  -> Lattice ----------> Workspace -> legs -> Path
//! Potential, Site                                                -> Gates  /
//!                       Curves                                   -> Shooter (to the goal), Shortener
//! ```

mod astar;
mod curve;
mod dubins;
mod gate;
mod goal;
mod guide;
mod lattice;
mod motion;
mod params;
mod reeds_shepp;
mod shorten;
mod shot;
mod site;
mod table;

pub use astar::HybridAStar;
pub use curve::{Curve, CurvePiece, CurveSample, CurveWeights, Turn};
pub use dubins::Dubins;
pub use params::HybridAStarParams;
pub use reeds_shepp::ReedsShepp;

/// Units of the search per metre: it counts in whole millimetres.
const UNIT: f64 = 1000.0;
