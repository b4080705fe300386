//! From a pose that is right to a cell to one that is right to the scanner's noise: points onto lines.
//!
//! Each end point is held against the line through the nearest point of the target (Censi 2008), and weighed by how near it is, so
//! that what the target does not show pulls little. With the residual `e = n · (T p - t)` and right increments
//!
//! ```text
//! H = Σ w JᵀJ        J = nᵀ R [ I | (-p_y, p_x)ᵀ ]        w = exp(-e² / 2 σ²)
//! ```
//!
//! A step is damped as if the present pose were known to the standard deviations beyond which a direction counts as not observed:
//! along those the pose stays.

use super::{
    params::CorrelativeParams,
    target::{REACH, Target},
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
    /// Mean over all points of `exp(-e² / 2 σ²)`.
    pub(super) score: f64,
    pub(super) iterations: usize,
    pub(super) termination: Termination,
}

/// Steps below this are the end, in metres and radians.
const AT_REST: f64 = 1e-5;

/// A last step below this share of a cell is no failure: two points that are equally near take turns.
const NEARLY_AT_REST: f64 = 0.02;

/// Sums over the points at a pose.
struct Sums {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    weight: f64,
    squares: f64,
    inliers: usize,
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
    // Where the scan fits worse than the scanner's noise, it is worth less.
    let variance = (sums.squares / sums.weight.max(f64::MIN_POSITIVE)).max(params.range_sigma.powi(2));
    let enough =
        sums.inliers >= params.min_points && sums.inliers as f64 >= params.min_inlier_ratio * points.len() as f64;
    let termination = match (enough, length <= NEARLY_AT_REST * params.resolution) {
        (false, _) => Termination::TooFewPoints,
        (true, true) => Termination::Converged,
        (true, false) => Termination::IterationLimit,
    };
    Refined {
        pose,
        information: sums.hessian / variance,
        inliers: sums.inliers,
        score: sums.weight / points.len().max(1) as f64,
        iterations,
        termination,
    }
}

fn sum_up(target: &Target, points: &[Vector2<f64>], pose: &Se2, params: &CorrelativeParams) -> Sums {
    let (mut hessian, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
    let (mut weight, mut squares, mut inliers) = (0.0, 0.0, 0);
    let (scale, rotation) = (-0.5 / (params.sigma * params.sigma), pose.rotation());
    let back = rotation.inverse();
    for point in points {
        let place = pose.act(point);
        let Some((nearest, normal)) = target.nearest(&place) else { continue };
        let off = place - nearest;
        if off.norm_squared() > (REACH * params.sigma).powi(2) {
            continue;
        }
        let mut add = |normal: Vector2<f64>| {
            let residual = normal.dot(&off);
            let local = back.act(&normal);
            let jacobian = Vector3::new(local.x, local.y, local.y * point.x - local.x * point.y);
            let share = (scale * residual * residual).exp();
            hessian += jacobian * jacobian.transpose() * share;
            gradient += jacobian * (residual * share);
            (weight, squares) = (weight + share, squares + share * residual * residual);
        };
        inliers += 1;
        if normal != Vector2::zeros() {
            add(normal);
        }
    }
    Sums { hessian, gradient, weight, squares, inliers }
}
