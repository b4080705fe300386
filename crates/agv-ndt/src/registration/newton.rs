//! Newton's method with a line search (Magnusson 2009, section 6.2).
//!
//! Where the Hessian is not positive definite its eigenvalues are replaced by their magnitudes, so that the direction leads
//! downhill. Along the tangent `δ` the slope at step `α` is the gradient there times `δ`, since `exp(α δ)` commutes with `δ`.

use super::{Descent, DescentParams, LinePoint, LineSearchParams, MoreThuente, Objective};
use agv_core::{
    geometry::{LieGroup, Se3},
    roles::Termination,
};
use nalgebra::{Matrix6, Vector6};

/// Walks from `start` down to a minimum.
pub(super) fn minimize(
    objective: &mut impl Objective,
    params: &DescentParams,
    start: &Se3,
    keep: &Matrix6<f64>,
) -> Descent {
    let quadratic = objective.evaluate(start);
    let mut best = Descent { pose: *start, quadratic, iterations: 1, termination: Termination::IterationLimit };
    loop {
        if best.quadratic.matches == 0 || !best.quadratic.cost.is_finite() {
            return Descent { termination: Termination::TooFewPoints, ..best };
        }
        let gradient = keep * best.quadratic.gradient;
        let Some(step) = direction(&best.quadratic.hessian, &gradient, keep) else {
            return Descent { termination: Termination::Degenerate, ..best };
        };
        if params.at_rest(&step) {
            best.pose = best.pose.plus(&step);
            return Descent { termination: Termination::Converged, ..best };
        }
        if best.iterations >= params.max_iterations {
            return best;
        }
        let step = step * params.limit(&step);
        let mut tried = best;
        let Ok(search) = MoreThuente::new(LineSearchParams {
            max_evaluations: params.max_iterations - best.iterations,
            ..LineSearchParams::default()
        }) else {
            return best;
        };
        let origin = LinePoint { step: 0.0, value: best.quadratic.cost, slope: gradient.dot(&step) };
        let (found, _, evaluations) = search.search(&origin, 1.0, |along| {
            tried.pose = best.pose.plus(&(step * along));
            tried.quadratic = objective.evaluate(&tried.pose);
            LinePoint { step: along, value: tried.quadratic.cost, slope: (keep * tried.quadratic.gradient).dot(&step) }
        });
        best.iterations += evaluations;
        if found.value >= best.quadratic.cost || found.step == 0.0 {
            return Descent { termination: Termination::Stalled, ..best };
        }
        (best.pose, best.quadratic) = (tried.pose, tried.quadratic);
    }
}

/// Newton's direction along the tangents that `keep` leaves, with eigenvalues that are not positive mended; `None` for a Hessian
/// that is not finite.
fn direction(hessian: &Matrix6<f64>, gradient: &Vector6<f64>, keep: &Matrix6<f64>) -> Option<Vector6<f64>> {
    let hessian = keep * hessian * keep + (Matrix6::identity() - keep);
    let step = if let Some(factor) = hessian.cholesky() {
        factor.solve(&-gradient)
    } else {
        // Metres and radians differ in scale: magnitudes are compared after scaling to a unit diagonal.
        let scale = hessian.diagonal().map(|h: f64| 1.0 / h.abs().max(1e-9).sqrt());
        let scaled = Matrix6::from_fn(|i, j| scale[i] * hessian[(i, j)] * scale[j]);
        let (values, vectors) = Se3::symmetric_eigen(&scaled)?;
        let along = vectors.transpose() * -gradient.component_mul(&scale);
        let divided = along.zip_map(&values, |a: f64, value: f64| a / value.abs().max(1e-3));
        (vectors * divided).component_mul(&scale)
    };
    let step = keep * step;
    step.iter().all(|v| v.is_finite()).then_some(step)
}
