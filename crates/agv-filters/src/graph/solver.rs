//! The poses that explain a graph best, and how certain they are.

use super::{PoseGraph, PoseId, SparseNormalEquations, problem::GraphProblem};
use agv_core::{
    Error,
    geometry::LieGroup,
    solve::{LeastSquaresReport, LeastSquaresWorkspace, LevenbergMarquardt, LevenbergMarquardtParams, NormalSystem},
};

/// Parameters of a [`PoseGraphSolver`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseGraphSolverParams {
    /// When to stop, and how boldly to start.
    pub descent: LevenbergMarquardtParams,
}

impl Default for PoseGraphSolverParams {
    /// Steps of Gauss and Newton while they lower the cost, until a step promises less than a thousand-millionth of it.
    fn default() -> Self {
        let descent = LevenbergMarquardtParams {
            initial_damping: 1e-6,
            cost_tolerance: 1e-9,
            gradient_tolerance: 1e-9,
            ..LevenbergMarquardtParams::default()
        };
        Self { descent }
    }
}

/// Moves the poses of graphs to where their relations fit best; keeps its memory, and the order of elimination while a graph's
/// pattern stays.
///
/// See [`PoseGraph`] for an example.
#[derive(Debug)]
pub struct PoseGraphSolver<G: LieGroup> {
    descent: LevenbergMarquardt,
    workspace: LeastSquaresWorkspace<SparseNormalEquations, Vec<G>>,
    blocks: Vec<Option<u32>>,
}

impl<G: LieGroup> PoseGraphSolver<G> {
    /// A solver.
    ///
    /// # Errors
    /// Tolerances that cannot be some.
    pub fn new(params: PoseGraphSolverParams) -> Result<Self, Error> {
        let descent = LevenbergMarquardt::new(params.descent)?;
        let workspace = LeastSquaresWorkspace::new(SparseNormalEquations::default(), Vec::new());
        Ok(Self { descent, workspace, blocks: Vec::new() })
    }

    /// Moves the poses to a minimum near where they are; [`initialize`](Self::initialize) first where they are no good guess. A step
    /// is linear in poses and relations, but for the factor's fill.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for poses so far off that their residuals overflow, [`Error::TooMany`] for a graph that memory has no
    /// room for. The poses are then as they were.
    pub fn optimize(&mut self, graph: &mut PoseGraph<G>) -> Result<LeastSquaresReport, Error> {
        let report = self.descend(graph);
        if report.is_err() {
            // What was summed up is of no minimum: nothing is known of any pose.
            self.blocks.clear();
        }
        report
    }

    fn descend(&mut self, graph: &mut PoseGraph<G>) -> Result<LeastSquaresReport, Error> {
        let free = graph.blocks_into(&mut self.blocks);
        let pairs = graph
            .relations()
            .iter()
            .filter_map(|relation| self.blocks[relation.from.index()].zip(self.blocks[relation.to.index()]));
        self.workspace.system.reset(G::DOF, free, pairs)?;
        let mut poses = graph.poses().to_vec();
        let mut problem = GraphProblem { relations: graph.relations(), priors: graph.priors(), blocks: &self.blocks };
        let report = self.descent.minimize_structured(&mut problem, &mut poses, &mut self.workspace)?;
        *graph.poses_mut() = poses;
        Ok(report)
    }

    /// Covariance of a pose of the graph that was optimised last, in the frame of that pose, given the poses that stay; none if
    /// the relations do not determine it. The sums are factored anew at each call, then solved once per degree of freedom.
    ///
    /// Robust kernels count as they did at the minimum.
    pub fn covariance(&mut self, pose: PoseId) -> Option<G::Matrix> {
        let Some(block) = *self.blocks.get(pose.index())? else {
            return Some(G::matrix_from_slice(&[]));
        };
        let system = &mut self.workspace.system;
        if !system.factorize() {
            return None;
        }
        let mut entries = Vec::with_capacity(G::DOF * G::DOF);
        let mut unit = Vec::new();
        let first = block as usize * G::DOF;
        for i in first..first + G::DOF {
            unit.clear();
            unit.resize(system.dimension(), 0.0);
            unit[i] = 1.0;
            let solved = system.substitute(&mut unit);
            if !solved || unit[i] * system.diagonal(i) > UNDETERMINED {
                return None;
            }
            entries.extend_from_slice(&unit[first..first + G::DOF]);
        }
        let covariance = G::matrix_from_slice(&entries);
        Some((covariance + G::transpose(&covariance)) * 0.5)
    }
}

/// Variance of an unknown beside what it would be if all others were known: about twice the number of poses of a chain, and beyond
/// this the rounding of an unknown that nothing determines.
const UNDETERMINED: f64 = 1e12;
