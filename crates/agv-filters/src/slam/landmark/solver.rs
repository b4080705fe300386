//! The poses and landmarks that explain a graph best.

use super::{
    GraphLandmark, LandmarkGraph,
    problem::{LandmarkProblem, LandmarkState},
};
use crate::graph::{GraphProblem, Layout, PoseGraphSolverParams, SparseNormalEquations, free_steps};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
    solve::{LeastSquaresReport, LeastSquaresWorkspace, LevenbergMarquardt, NormalSystem},
};
use nalgebra::Matrix2;

/// Variance beside what it would be if all else was known, beyond which an unknown is not determined.
const UNDETERMINED: f64 = 1e12;

/// Moves poses and landmarks of graphs to where they fit best, as [`PoseGraphSolver`](crate::graph::PoseGraphSolver) does poses: the same
/// descent on the same sparse factor, which keeps its order of elimination while the graph's pattern stays.
///
/// See [`LandmarkGraph`] for an example.
#[derive(Debug)]
pub struct LandmarkGraphSolver {
    params: PoseGraphSolverParams,
    workspace: LeastSquaresWorkspace<SparseNormalEquations, LandmarkState>,
    pose_blocks: Vec<Option<u32>>,
    landmark_blocks: Vec<Option<u32>>,
    layout: Layout,
}

impl LandmarkGraphSolver {
    /// A solver.
    ///
    /// # Errors
    /// Tolerances that cannot be some.
    pub fn new(params: PoseGraphSolverParams) -> Result<Self, Error> {
        LevenbergMarquardt::new(params.descent)?;
        let workspace = LeastSquaresWorkspace::new(SparseNormalEquations::default(), LandmarkState::default());
        let layout = Layout::uniform(1, 0);
        Ok(Self { params, workspace, pose_blocks: Vec::new(), landmark_blocks: Vec::new(), layout })
    }

    /// Moves poses and landmarks to a minimum near where they are. A step is linear in relations and sightings, but for the factor's fill.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a graph so far off that residuals overflow, [`Error::TooMany`] for one that memory has no room for. The
    /// graph is then as it was.
    pub fn optimize(&mut self, graph: &mut LandmarkGraph) -> Result<LeastSquaresReport, Error> {
        // Poses that see one landmark belong together as those do that a relation ties.
        let mut first_pose = vec![None; graph.landmarks.len()];
        let links = graph.ties.iter().map(|tie| (*first_pose[tie.landmark.index()].get_or_insert(tie.pose), tie.pose));
        let free_poses = graph.poses.linked_blocks_into(links, &mut self.pose_blocks);
        let small = graph.landmark_blocks_into(free_poses, &mut self.landmark_blocks);
        self.layout = Layout { size: Se2::DOF, large: free_poses, small_size: 2, small };
        let (poses, landmarks) = (&self.pose_blocks, &self.landmark_blocks);
        let relations = graph.poses.relations().iter();
        let relations = relations.filter_map(|r| poses[r.from.index()].zip(poses[r.to.index()]));
        let ties = graph.ties.iter();
        let ties = ties.filter_map(|tie| poses[tie.pose.index()].zip(landmarks[tie.landmark.index()]));
        self.workspace.system.reset(self.layout, relations.chain(ties))?;
        let mut state = LandmarkState::of(graph);
        let mut problem = LandmarkProblem {
            poses: GraphProblem {
                relations: graph.poses.relations(),
                priors: graph.poses.priors(),
                blocks: &self.pose_blocks,
                widening: 1.0,
            },
            ties: &graph.ties,
            range_scale: graph.range_scale,
            landmark_blocks: &self.landmark_blocks,
            free_poses,
        };
        let steps = free_steps(&mut problem, &mut state, &mut self.workspace.system, &self.params.descent);
        let descent = LevenbergMarquardt::new(self.params.descent)?;
        let mut report = descent.minimize_structured(&mut problem, &mut state, &mut self.workspace)?;
        report.iterations += steps;
        *graph.poses.poses_mut() = state.poses;
        graph.landmarks = state.landmarks;
        Ok(report)
    }

    /// Covariance of a landmark of the graph that was optimised last, in the axes of the map; none if the graph leaves it undetermined.
    pub fn landmark_covariance(&mut self, landmark: GraphLandmark) -> Option<Matrix2<f64>> {
        self.relative_covariance(landmark, landmark)
    }

    /// Covariance of the way from one landmark to another, in the axes of the map; that of the place if they are the same. None if the graph leaves
    /// them undetermined.
    pub fn relative_covariance(&mut self, one: GraphLandmark, other: GraphLandmark) -> Option<Matrix2<f64>> {
        let first = self.first_unknown(one)?;
        let second = self.first_unknown(other)?;
        let system = &mut self.workspace.system;
        if !system.factorize() {
            return None;
        }
        let mut covariance = Matrix2::zeros();
        for column in 0..2 {
            let mut unit = vec![0.0; system.dimension()];
            unit[first + column] = 1.0;
            if first != second {
                unit[second + column] = -1.0;
            }
            if !system.substitute(&mut unit) || unit[first + column] * system.diagonal(first + column) > UNDETERMINED {
                return None;
            }
            for row in 0..2 {
                let less = if first == second { 0.0 } else { unit[second + row] };
                covariance[(row, column)] = unit[first + row] - less;
            }
        }
        Some((covariance + covariance.transpose()) * 0.5)
    }

    fn first_unknown(&self, landmark: GraphLandmark) -> Option<usize> {
        let block = (*self.landmark_blocks.get(landmark.index())?)?;
        Some(self.layout.first_of(block as usize))
    }
}
