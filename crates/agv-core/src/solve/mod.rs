//! Small solvers that several crates share.

mod banded;
mod banded_normal;
mod levenberg_marquardt;
mod normal;
mod qp;
mod robust;

pub use banded::{BandedCholesky, BandedMatrix};
pub use banded_normal::BandedNormalEquations;
pub use levenberg_marquardt::{
    LeastSquares, LeastSquaresReport, LeastSquaresTermination, LeastSquaresWorkspace, LevenbergMarquardt,
    LevenbergMarquardtParams, Minimum, StructuredLeastSquares,
};
pub use normal::{FIXED, NormalEquations, NormalSystem, diagonal_damping};
pub use qp::{
    Bound, Constraint, QuadraticOutcome, QuadraticParams, QuadraticSolver, QuadraticStatus, QuadraticVectors,
};
pub use robust::RobustKernel;
