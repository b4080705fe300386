//! Where was this scan taken: matching laser scans against scans at known poses, or against a map.
//!
//! [`CorrelativeMatcher`] searches a window of poses exhaustively, and fast: branch and bound over grids of several resolutions (Olson,
//! *Real-time correlative scan matching*, 2009; Hess et al., *Real-time loop closure in 2D lidar SLAM*, 2016). No guess within the
//! window leads it astray, so that it serves odometry that slips as well as loop closures. What it finds to a cell is refined to a
//! fraction of one by a descent that puts points on lines (Censi, *An ICP variant using a point-to-line metric*, 2008), whose Hessian
//! is the information of the [`Alignment`](agv_core::roles::Alignment); directions that no surface fixes, as in a long corridor, are
//! named.
//!
//! [`FieldMatcher`] needs a guess and follows the slope of an interpolated likelihood field instead (the class of Hector SLAM and of
//! Cartographer's scan matcher): for surfaces that are no lines, and where no search is wanted. [`ClimbingMatcher`] needs one too, and
//! climbs over the score by small moves (the class of `GMapping`); [`PointToLineMatcher`] iterates closest points from farther off
//! (Censi 2008). `agv_ndt::ndt::NdtScanMatcher` matches by normal distributions. All play
//! [`ScanMatcher`](agv_core::roles::ScanMatcher), and state their results alike.

mod climb;
mod correlative;
mod field;
mod line;
mod nearest;
mod params;
mod point_to_line;
mod pyramid;
mod refine;
mod search;
mod squares;
mod surfaces;
mod target;
#[cfg(test)]
mod tests;
mod verdict;

pub use climb::{ClimbingMatcher, ClimbingMatcherParams};
pub use correlative::CorrelativeMatcher;
pub use field::{FieldMatcher, FieldMatcherParams};
pub(crate) use line::LineSums;
pub use params::{CorrelativeParams, SearchWindow};
pub use point_to_line::{PointToLineMatcher, PointToLineParams};
pub(crate) use squares::{Squares, room_of, thin_into};
