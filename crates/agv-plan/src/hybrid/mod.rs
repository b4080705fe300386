//! Planning for vehicles that steer: curves of bounded curvature, and hybrid A* on the lattice of poses.

mod curve;
mod dubins;
mod reeds_shepp;

pub use curve::{Curve, CurvePiece, CurveSample, CurveWeights, Turn};
pub use dubins::Dubins;
pub use reeds_shepp::ReedsShepp;
