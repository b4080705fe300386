//! The poses that explain a graph best, and how certain they are.

use super::{PoseGraph, PoseId, SparseNormalEquations, problem::GraphProblem};
use agv_core::{
    Error,
    geometry::LieGroup,
    solve::{LeastSquaresReport, LeastSquaresWorkspace, LevenbergMarquardt, LevenbergMarquardtParams},
};

/// Parameters of a [`PoseGraphSolver`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseGraphSolverParams {
    /// When to stop, and how boldly to start.
    pub descent: LevenbergMarquardtParams,
}

impl Default for PoseGraphSolverParams {
    /// Steps of Gauss and Newton while they lower the cost, until a step promises less than a millionth of it.
    fn default() -> Self {
        let descent = LevenbergMarquardtParams {
            initial_damping: 1e-6,
            cost_tolerance: 1e-6,
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
    pub(super) blocks: Vec<Option<u32>>,
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

    /// Moves the poses to a minimum near where they are; [`initialize`](Self::initialize) first where they are no good guess. A step is linear in poses and relations, but for the factor's fill.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for poses so far off that their residuals overflow, [`Error::TooMany`] for a graph that memory has no
    /// room for. The poses are then as they were.
    pub fn optimize(&mut self, graph: &mut PoseGraph<G>) -> Result<LeastSquaresReport, Error> {
        let free = graph.blocks_into(&mut self.blocks);
        let pairs = graph
            .relations()
            .iter()
            .filter_map(|relation| self.blocks[relation.from.index()].zip(self.blocks[relation.to.index()]));
        self.workspace.system.reset(G::DOF, free, pairs)?;
        let mut poses = std::mem::take(graph.poses_mut());
        let start = poses.clone();
        let mut problem = GraphProblem { relations: graph.relations(), priors: graph.priors(), blocks: &self.blocks };
        let report = self.descent.minimize_structured(&mut problem, &mut poses, &mut self.workspace);
        *graph.poses_mut() = if report.is_ok() { poses } else { start };
        report
    }

    /// Covariance of a pose of the graph that was optimised last, in the frame of that pose, given the poses that stay; none if
    /// the relations do not determine it. A solution with the sparse factor per degree of freedom.
    ///
    /// Robust kernels count as they did at the minimum.
    pub fn covariance(&mut self, pose: PoseId) -> Option<G::Matrix> {
        let Some(block) = *self.blocks.get(pose.index())? else {
            return Some(G::matrix_from_slice(&[]));
        };
        if !self.workspace.system.factorize() {
            return None;
        }
        let mut entries = Vec::with_capacity(G::DOF * G::DOF);
        let first = block as usize * G::DOF;
        for i in 0..G::DOF {
            let mut unit = vec![0.0; self.blocks.iter().flatten().count() * G::DOF];
            unit[first + i] = 1.0;
            if !self.workspace.system.substitute(&mut unit) {
                return None;
            }
            entries.extend_from_slice(&unit[first..first + G::DOF]);
        }
        Some(G::matrix_from_slice(&entries))
    }
}
