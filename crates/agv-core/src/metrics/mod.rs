//! How good was it: errors of trajectories against a reference, and figures of merit of paths.
//!
//! - [`absolute_error`]: ATE, the distance between two trajectories after the best rigid alignment;
//! - [`relative_error`]: RPE, the error of motions over a fixed delta;
//! - [`relation_errors`]: the benchmark of Kümmerle et al. against relative poses that a human verified;
//! - [`PathQuality`]: length, turns, smoothness and clearance of a planned path;
//! - [`chi_square_quantile`]: bounds for the squares of normalised errors.
//!
//! Trajectories are slices of `(Stamp, pose)`, in any order of time; [`associate`] pairs two of them.

mod ate;
mod chi_square;
mod path;
mod pose;
mod relations;
mod rpe;
mod statistics;

pub use ate::{AbsoluteError, PosePair, TrajectoryAlignment, absolute_error, associate};
pub use chi_square::{chi_square_cdf, chi_square_quantile};
pub use path::{PathQuality, PathQualityParams};
pub use pose::TrajectoryPose;
pub use relations::{Relation, RelationErrors, relation_errors};
pub use rpe::{Delta, RelativeError, relative_error};
pub use statistics::Statistics;
