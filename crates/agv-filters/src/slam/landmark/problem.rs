//! Poses and landmarks as one least-squares problem: the blocks of a pose graph, with those of points behind.

use super::{Tie, graph::LandmarkGraph};
use crate::graph::{GraphProblem, SparseNormalEquations};
use agv_core::{
    geometry::{LieGroup, Se2},
    solve::{NormalSystem, StructuredLeastSquares},
};
use nalgebra::{Matrix2, Matrix2x3, Vector2};

/// What is sought.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct LandmarkState {
    pub(super) poses: Vec<Se2>,
    pub(super) landmarks: Vec<Vector2<f64>>,
}

/// The measurements, and which unknowns a landmark has.
pub(super) struct LandmarkProblem<'a> {
    pub(super) poses: GraphProblem<'a, Se2>,
    pub(super) ties: &'a [Tie],
    pub(super) range_scale: f64,
    /// Block of unknowns of each landmark; none for one that is not seen.
    pub(super) landmark_blocks: &'a [Option<u32>],
    pub(super) free_poses: usize,
}

/// A sighting beside where pose and landmark are: expected less measured, with its slopes.
pub(super) struct Sees {
    error: Vector2<f64>,
    information: Matrix2<f64>,
    by_pose: Matrix2x3<f64>,
    by_landmark: Matrix2<f64>,
}

impl Sees {
    pub(super) fn square(&self) -> f64 {
        self.error.dot(&(self.information * self.error))
    }
}

/// None where the landmark is on top of the sensor.
pub(super) fn sees(tie: &Tie, pose: &Se2, place: &Vector2<f64>, range_scale: f64) -> Option<Sees> {
    let view = crate::landmark::View::of(pose, &tie.sighting.base_from_sensor, place);
    let expected = tie.sighting.expect(&view.seen, range_scale)?;
    let turn = pose.rotation().compose(&tie.sighting.base_from_sensor.rotation());
    let sensor_from_map = Matrix2::new(turn.cos(), turn.sin(), -turn.sin(), turn.cos());
    let information = if expected.rows == 1 {
        Matrix2::new(1.0 / expected.noise[(0, 0)], 0.0, 0.0, 0.0)
    } else {
        expected.noise.try_inverse()?
    };
    Some(Sees {
        error: -expected.residual,
        information,
        by_pose: expected.by_seen * view.by_pose,
        by_landmark: expected.by_seen * sensor_from_map,
    })
}

impl LandmarkProblem<'_> {
    fn each<'s>(&'s self, state: &'s LandmarkState) -> impl Iterator<Item = (&'s Tie, Sees)> {
        self.ties.iter().filter_map(|tie| {
            let (pose, place) = (&state.poses[tie.pose.index()], &state.landmarks[tie.landmark.index()]);
            sees(tie, pose, place, self.range_scale).map(|seen| (tie, seen))
        })
    }
}

impl StructuredLeastSquares<SparseNormalEquations> for LandmarkProblem<'_> {
    type State = LandmarkState;

    fn linearize(&mut self, state: &LandmarkState, system: &mut SparseNormalEquations) {
        self.poses.linearize(&state.poses, system);
        for (tie, seen) in self.each(state) {
            let square = seen.square();
            let information = seen.information * tie.kernel.weight(square);
            let (pose, landmark) = (self.poses.blocks[tie.pose.index()], self.landmark_blocks[tie.landmark.index()]);
            system.add_cost(0.5 * tie.kernel.loss(square));
            let by_landmark = seen.by_landmark.transpose() * information;
            if let Some(landmark) = landmark {
                system.add_gradient(landmark, (by_landmark * seen.error).as_slice());
                system.add_block(landmark, landmark, (by_landmark * seen.by_landmark).as_slice());
            }
            if let Some(pose) = pose {
                let by_pose = seen.by_pose.transpose() * information;
                system.add_gradient(pose, (by_pose * seen.error).as_slice());
                system.add_block(pose, pose, (by_pose * seen.by_pose).as_slice());
                if let Some(landmark) = landmark {
                    system.add_block(landmark, pose, (by_landmark * seen.by_pose).as_slice());
                }
            }
        }
    }

    fn cost(&mut self, state: &LandmarkState) -> f64 {
        let ties: f64 = self.each(state).map(|(tie, seen)| 0.5 * tie.kernel.loss(seen.square())).sum();
        self.poses.cost(&state.poses) + ties
    }

    fn retract_into(&self, state: &LandmarkState, step: &[f64], trial: &mut LandmarkState) {
        self.poses.retract_into(&state.poses, step, &mut trial.poses);
        let first = Se2::DOF * self.free_poses;
        for ((place, moved), block) in state.landmarks.iter().zip(&mut trial.landmarks).zip(self.landmark_blocks) {
            *moved = *place;
            if let Some(block) = block {
                let at = first + 2 * (*block as usize - self.free_poses);
                *moved += Vector2::new(step[at], step[at + 1]);
            }
        }
    }
}

impl LandmarkState {
    pub(super) fn of(graph: &LandmarkGraph) -> Self {
        Self { poses: graph.poses.poses().to_vec(), landmarks: graph.landmarks.clone() }
    }
}
