//! From a pose that is right to a cell to one that is right to the scanner's noise: points onto lines.
//!
//! Each end point is held against the line through the nearest point of the target (Censi 2008), and weighed by how near it is, so
//! that what the target does not show pulls little. With the residual `e = n · (T p - t)` and right increments
//!
//! ```text
//! H = Σ w JᵀJ        J = nᵀ R [ I | (-p_y, p_x)ᵀ ]        w = exp(-e² / 2 σ²)
//! ```
//!
//! Normals are not exact: one that is off by an angle of variance `v` seems to see along the surface, by `v` of what it sees across it.
//! In a corridor, where all normals are nearly alike, that is all there is; so the information leaves out three times as much.
//!
//! A step is damped as if the present pose were known to the standard deviations beyond which a direction counts as not observed:
//! along those the pose stays.

use super::{
    params::CorrelativeParams,
    target::{REACH, Surface, Target},
};
use agv_core::{
    geometry::{LieGroup, Se2},
    roles::Termination,
};
use nalgebra::{Matrix3, Vector2, Vector3};

/// A refined pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Refined {
    pub(super) pose: Se2,
    /// Inverse of the covariance of the right increment.
    pub(super) information: Matrix3<f64>,
    /// Points that met the target.
    pub(super) inliers: usize,
    /// Mean over all points of `exp(-d² / 2 σ²)`, with the distance `d` from the line, or from the point where there is none.
    pub(super) score: f64,
    pub(super) iterations: usize,
    pub(super) termination: Termination,
}

/// Steps below this are the end, in metres and radians.
const AT_REST: f64 = 1e-5;

/// A last step below this share of a cell is no failure: two points that are equally near take turns.
pub(super) const NEARLY_AT_REST: f64 = 0.02;

/// Sums over the points at a pose.
pub(super) struct Sums {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// What the errors of the normals add to the Hessian.
    spurious: Matrix3<f64>,
    weight: f64,
    squares: f64,
    /// Sum of `exp(-d² / 2 σ²)`, of points on no line too.
    pub(super) score: f64,
    pub(super) inliers: usize,
}

/// How much of what wrong normals seem to see is left out: more than chance makes of it.
const CAUTION: f64 = 3.0;

impl Sums {
    /// Inverse of the covariance of the right increment. Where the scan fits worse than the scanner's noise, it is worth less.
    pub(super) fn information(&self, points: &[Vector2<f64>], params: &CorrelativeParams) -> Matrix3<f64> {
        let variance = (self.squares / self.weight.max(f64::MIN_POSITIVE)).max(params.range_sigma.powi(2));
        // In units in which a turn moves the points as far as a step does.
        let spread = points.iter().map(Vector2::norm_squared).sum::<f64>() / points.len().max(1) as f64;
        let lever = spread.sqrt().max(params.sigma);
        let unit = Vector3::new(1.0, 1.0, 1.0 / lever);
        let scale = Matrix3::from_diagonal(&unit);
        let eigen = (scale * (self.hessian - self.spurious * CAUTION) * scale).symmetric_eigen();
        // Rounding must not make it indefinite.
        let least = 1e-9 * eigen.eigenvalues.max().max(0.0);
        let seen = Matrix3::from_diagonal(&eigen.eigenvalues.map(|value| value.max(least)));
        let back = Matrix3::from_diagonal(&unit.map(|v| 1.0 / v));
        let information = back * eigen.eigenvectors * seen * eigen.eigenvectors.transpose() * back;
        (information + information.transpose()) * (0.5 / variance)
    }
}

/// Walks from `start` to where the points lie on the target's lines.
pub(super) fn refine(target: &Target, points: &[Vector2<f64>], start: &Se2, params: &CorrelativeParams) -> Refined {
    let damping = [params.observable.translation, params.observable.translation, params.observable.rotation]
        .map(|sigma| (params.range_sigma / sigma).powi(2));
    let damping = Matrix3::from_diagonal(&Vector3::from(damping));
    let (mut pose, mut iterations, mut length) = (*start, 0, f64::INFINITY);
    while iterations < params.max_iterations && length > AT_REST {
        let sums = sum_up(target, points, &pose, params);
        let Some(factor) = (sums.hessian + damping).cholesky() else { break };
        let step = factor.solve(&-sums.gradient);
        pose = pose.plus(&step);
        length = step.amax();
        iterations += 1;
    }
    let sums = sum_up(target, points, &pose, params);
    let enough =
        sums.inliers >= params.min_points && sums.inliers as f64 >= params.min_inlier_ratio * points.len() as f64;
    let termination = match (enough, length <= NEARLY_AT_REST * params.resolution) {
        (false, _) => Termination::TooFewPoints,
        (true, true) => Termination::Converged,
        (true, false) => Termination::IterationLimit,
    };
    Refined {
        pose,
        information: sums.information(points, params),
        inliers: sums.inliers,
        score: sums.score / points.len().max(1) as f64,
        iterations,
        termination,
    }
}

/// The sums over some points at a pose.
pub(super) fn sum_up(target: &Target, points: &[Vector2<f64>], pose: &Se2, params: &CorrelativeParams) -> Sums {
    let (mut hessian, mut gradient, mut spurious) = (Matrix3::zeros(), Vector3::zeros(), Matrix3::zeros());
    let (mut weight, mut squares, mut score, mut inliers) = (0.0, 0.0, 0.0, 0);
    let scale = -0.5 / (params.sigma * params.sigma);
    let back = pose.rotation().inverse();
    for point in points {
        let place = pose.act(point);
        let Some((Surface { normal, doubt, .. }, off)) = met(target, &place, params) else { continue };
        inliers += 1;
        if normal == Vector2::zeros() {
            score += (scale * off.norm_squared()).exp();
            continue;
        }
        let residual = normal.dot(&off);
        let local = back.act(&normal);
        let jacobian = Vector3::new(local.x, local.y, local.y * point.x - local.x * point.y);
        let along = Vector3::new(-local.y, local.x, local.x * point.x + local.y * point.y);
        let share = (scale * residual * residual).exp();
        hessian += jacobian * jacobian.transpose() * share;
        spurious += along * along.transpose() * (share * doubt);
        gradient += jacobian * (residual * share);
        (weight, squares) = (weight + share, squares + share * residual * residual);
        score += share;
    }
    Sums { hessian, gradient, spurious, weight, squares, score, inliers }
}

/// The surface that an end point meets, and how far off its point lies.
#[inline]
fn met(target: &Target, place: &Vector2<f64>, params: &CorrelativeParams) -> Option<(Surface, Vector2<f64>)> {
    let surface = target.nearest(place)?;
    let off = place - surface.point;
    (off.norm_squared() <= (REACH * params.sigma).powi(2)).then_some((surface, off))
}

/// Sum over some points at a pose of `exp(-d² / 2 σ²)`, as the score of a result has it.
pub(super) fn score_at(target: &Target, points: &[Vector2<f64>], pose: &Se2, params: &CorrelativeParams) -> f64 {
    let scale = -0.5 / (params.sigma * params.sigma);
    let likelihood = |point: &Vector2<f64>| {
        let (Surface { normal, .. }, off) = met(target, &pose.act(point), params)?;
        let squared = if normal == Vector2::zeros() { off.norm_squared() } else { normal.dot(&off).powi(2) };
        Some((scale * squared).exp())
    };
    points.iter().filter_map(likelihood).sum()
}
