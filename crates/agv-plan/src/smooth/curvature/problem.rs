//! The sum of squares that a smooth path makes least; its terms are those of the parent module's head.
//!
//! Each point has two unknowns, and a term joins three neighbours at most, so that the normal equations have a band of five.
//! Where a term beyond a limit (curvature, clearance) is within it, it is left out.

use super::CurvatureSmootherParams;
use agv_core::{
    grid::ObstacleMap,
    solve::{BandedNormalEquations, FIXED, NormalSystem, StructuredLeastSquares},
};
use nalgebra::{Matrix1x2, Matrix2x6, Vector1, Vector2};

/// Where points of a piece should go.
pub(super) struct Problem<'a> {
    pub(super) params: &'a CurvatureSmootherParams,
    pub(super) anchors: &'a [Vector2<f64>],
    pub(super) obstacles: &'a ObstacleMap,
    /// Distance of the base from obstacles' centres.
    pub(super) wanted: f64,
    pub(super) step: f64,
}

impl Problem<'_> {
    /// By how much the curvature is too great, and its direction.
    fn excess(&self, bend: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let size = bend.norm();
        // A hair below the limit: the solver stops where the last of the excess is worth its weight.
        let excess = size - 0.95 * self.params.max_curvature;
        (excess > 0.0).then(|| (excess, bend / size))
    }

    fn bend(&self, points: &[Vector2<f64>]) -> Vector2<f64> {
        (points[0] - points[1] * 2.0 + points[2]) / (self.step * self.step)
    }

    /// How much nearer than wanted an obstacle is, and how that changes.
    fn shortfall(&self, point: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (distance, gradient) = self.obstacles.distance_at(point)?;
        let shortfall = self.wanted - distance;
        (shortfall > 0.0).then_some((shortfall, -gradient))
    }

    fn is_inner(&self, index: usize) -> bool {
        index > 0 && index + 1 < self.anchors.len()
    }
}

impl StructuredLeastSquares<BandedNormalEquations> for Problem<'_> {
    type State = Vec<Vector2<f64>>;

    fn linearize(&mut self, state: &Vec<Vector2<f64>>, system: &mut BandedNormalEquations) {
        let unknown = |index: usize| if self.is_inner(index) { [2 * index, 2 * index + 1] } else { [FIXED; 2] };
        let inverse = 1.0 / (self.step * self.step);
        let jacobian = Matrix2x6::new(1.0, 0.0, -2.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, -2.0, 0.0, 1.0) * inverse;
        for (index, points) in state.windows(3).enumerate() {
            let bend = self.bend(points);
            let [a, b, c] = [index, index + 1, index + 2].map(unknown);
            let unknowns = [a[0], a[1], b[0], b[1], c[0], c[1]];
            system.add_at(&unknowns, &bend, &jacobian, self.params.smooth_weight);
            if let Some((excess, direction)) = self.excess(&bend) {
                let row = direction.transpose() * jacobian;
                system.add_at(&unknowns, &Vector1::new(excess), &row, self.params.curvature_weight);
            }
        }
        for (index, point) in state.iter().enumerate() {
            let unknowns = unknown(index);
            if let Some((shortfall, gradient)) = self.shortfall(point) {
                let row = Matrix1x2::new(gradient.x, gradient.y);
                system.add_at(&unknowns, &Vector1::new(shortfall), &row, self.params.obstacle_weight);
            }
            let away = point - self.anchors[index];
            system.add_at(&unknowns, &away, &nalgebra::Matrix2::identity(), self.params.path_weight);
        }
        // Held ends have rows of their own, so that the sums can be solved.
        for index in [0, state.len() - 1] {
            let unknowns = [2 * index, 2 * index + 1];
            system.accumulate(&unknowns, &Vector2::zeros(), &nalgebra::Matrix2::identity(), 1.0);
        }
    }

    fn cost(&mut self, state: &Vec<Vector2<f64>>) -> f64 {
        let params = self.params;
        let bends = state.windows(3).map(|points| {
            let bend = self.bend(points);
            let excess = self.excess(&bend).map_or(0.0, |(excess, _)| excess);
            params.smooth_weight * bend.norm_squared() + params.curvature_weight * excess * excess
        });
        let places = state.iter().zip(self.anchors).map(|(point, anchor)| {
            let shortfall = self.shortfall(point).map_or(0.0, |(shortfall, _)| shortfall);
            params.obstacle_weight * shortfall * shortfall + params.path_weight * (point - anchor).norm_squared()
        });
        0.5 * (bends.sum::<f64>() + places.sum::<f64>())
    }

    fn retract_into(&self, state: &Vec<Vector2<f64>>, step: &[f64], trial: &mut Vec<Vector2<f64>>) {
        trial.clone_from(state);
        for (index, (point, step)) in trial.iter_mut().zip(step.chunks_exact(2)).enumerate() {
            if self.is_inner(index) {
                *point += Vector2::new(step[0], step[1]);
            }
        }
    }
}
