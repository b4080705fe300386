//! What turns a path of cells into one that a vehicle likes to follow.
//!
//! | | keeps | gives |
//! |---|---|---|
//! | [`KeyNodes`] | points of the path | fewer of them, joined by straight lines |
//! | [`TautString`] | the side on which it passes each obstacle | the shortest such path |
//! | [`CurvatureSmoother`] | its ends | even steps of bounded curvature, checked with the vehicle's outline |
//!
//! The first two look at a costmap that is inflated for the vehicle, or keep a margin of their own.

mod curvature;
mod key_nodes;
mod line_of_sight;
mod path_smoother;
mod straight;
mod straightened;
mod taut_string;

pub use curvature::{CurvatureSmoother, CurvatureSmootherParams, SmoothOutcome};
pub use key_nodes::KeyNodes;
pub use line_of_sight::{LineOfSight, LineOfSightParams};
pub use path_smoother::PathSmoother;
pub use straightened::Straightened;
pub use taut_string::TautString;
