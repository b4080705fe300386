//! Small solvers that several crates share.

mod banded;
mod levenberg_marquardt;

pub use banded::{BandedCholesky, BandedMatrix};
pub use levenberg_marquardt::{
    LeastSquares, LeastSquaresTermination, LevenbergMarquardt, LevenbergMarquardtParams, Minimum, NormalEquations,
};
