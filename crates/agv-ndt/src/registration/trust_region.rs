//! Damped Newton steps: Levenberg and Marquardt's way between Newton's step and the gradient's, with an early stop.
//!
//! Each step solves `(H + λ D) δ = -g` with the diagonal `D` of the greatest curvatures met so far; the damping follows the
//! gain ratio (Madsen, Nielsen and Tingleff 2004, Algorithm 3.16). A Hessian that is not positive definite, as Newton's is far
//! from the optimum, is damped until it is. One evaluation a step, no line search; a step below the tolerances is taken and not
//! evaluated.

use super::{Descent, DescentParams, Objective};
use agv_core::{
    geometry::{LieGroup, Se3},
    roles::Termination,
};
use nalgebra::{Matrix6, Vector6};

/// Damping beyond which no step improves anything.
const MAX_DAMPING: f64 = 1e8;

/// Walks from `start` down to a minimum.
pub(super) fn minimize(
    objective: &mut impl Objective,
    params: &DescentParams,
    start: &Se3,
    keep: &Matrix6<f64>,
) -> Descent {
    let quadratic = objective.evaluate(start);
    let mut best = Descent { pose: *start, quadratic, iterations: 1, termination: Termination::IterationLimit };
    let (mut damping, mut growth, mut scale) = (params.initial_damping, 2.0, Vector6::zeros());
    loop {
        if best.quadratic.matches == 0 || !best.quadratic.cost.is_finite() {
            return Descent { termination: Termination::TooFewPoints, ..best };
        }
        let gradient = keep * best.quadratic.gradient;
        // Directions that are held have a curvature of their own, so that the matrix can be solved.
        let hessian = keep * best.quadratic.hessian * keep + (Matrix6::identity() - keep);
        scale = scale.zip_map(&hessian.diagonal(), |s: f64, h| s.max(h.abs()));
        let step = loop {
            let damped = hessian + Matrix6::from_diagonal(&(scale * damping));
            if let Some(factor) = damped.cholesky() {
                break keep * factor.solve(&-gradient);
            }
            damping *= 4.0;
            if damping > MAX_DAMPING {
                return Descent { termination: Termination::Degenerate, ..best };
            }
        };
        if !step.iter().all(|v| v.is_finite()) {
            return Descent { termination: Termination::Degenerate, ..best };
        }
        if params.at_rest(&step) {
            best.pose = best.pose.plus(&step);
            return Descent { termination: Termination::Converged, ..best };
        }
        if best.iterations >= params.max_iterations {
            return best;
        }
        let step = step * params.limit(&step);
        let trial = best.pose.plus(&step);
        let quadratic = objective.evaluate(&trial);
        best.iterations += 1;
        if quadratic.cost < best.quadratic.cost {
            let promised = -step.dot(&gradient) - 0.5 * step.dot(&(hessian * step));
            let gain = (best.quadratic.cost - quadratic.cost) / promised.max(f64::MIN_POSITIVE);
            (best.pose, best.quadratic) = (trial, quadratic);
            damping = (damping * (1.0 - (2.0 * gain.min(1.0) - 1.0).powi(3)).max(1.0 / 9.0)).max(1e-12);
            growth = 2.0;
        } else {
            damping = damping.max(1e-3) * growth;
            growth *= 2.0;
            if damping > MAX_DAMPING {
                return Descent { termination: Termination::Stalled, ..best };
            }
        }
    }
}
