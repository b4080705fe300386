//! Small solvers that several crates share.

mod banded;
mod levenberg_marquardt;
mod qp;
mod robust;

pub use banded::{BandedCholesky, BandedMatrix};
pub use levenberg_marquardt::{
    LeastSquares, LeastSquaresTermination, LevenbergMarquardt, LevenbergMarquardtParams, Minimum, NormalEquations,
};
pub use qp::{
    Bound, Constraint, QuadraticOutcome, QuadraticParams, QuadraticSolver, QuadraticStatus, QuadraticVectors,
};
pub use robust::RobustKernel;
