//! Pose graphs: poses that relations between them tie together, and the poses that explain all relations best.
//!
//! A trajectory with loops is a graph: odometry or scan matching relates each pose to the next, a place that is met again two
//! that are far apart in time. [`PoseGraph`] holds it on SE(2) or SE(3) and minimises
//!
//! ```text
//! ½ Σ ϱ( |log(measured⁻¹ ∘ (xᵢ⁻¹ ∘ xⱼ))|²_Ω )
//! ```
//!
//! over the poses by [`LevenbergMarquardt`](agv_core::solve::LevenbergMarquardt) on a sparse Hessian (Grisetti et al., *A tutorial
//! on graph-based SLAM*, 2010), with a robust kernel `ϱ` for each relation that may be false. One back end for the plane and for
//! space: maps of key scans, of sub-maps and of feature clouds are corrected by it.
//!
//! | to | call |
//! |---|---|
//! | correct the poses from where they are | [`optimize`](PoseGraphSolver::optimize) |
//! | find them from the relations alone | [`initialize`](PoseGraphSolver::initialize), then `optimize` |
//! | find out which of many closures are false | [`optimize_graduated`](PoseGraphSolver::optimize_graduated), bounded kernels |
//! | know how certain a pose is, or a relation | [`covariance`](PoseGraphSolver::covariance), [`relative_covariance`](PoseGraphSolver::relative_covariance) |
//! | say where the map lies | [`hold`](PoseGraph::hold), [`add_prior`](PoseGraph::add_prior), or neither: the first pose stays |

mod chordal;
mod covariance;
mod pose_graph;
mod problem;
mod relation;
mod solver;
mod sparse;

pub use chordal::RigidMotion;
pub use pose_graph::{PoseGraph, PoseId};
pub(crate) use problem::GraphProblem;
pub use relation::{Prior, Relation};
pub(crate) use solver::free_steps;
pub use solver::{PoseGraphSolver, PoseGraphSolverParams};
pub(crate) use sparse::{Layout, SparseNormalEquations};
