//! Plain steps of Gauss and Newton: for costs whose pairs are found anew at each pose, so that two values say little about each
//! other.

use super::{Descent, DescentParams, Objective};
use agv_core::{
    geometry::{LieGroup, Se3},
    roles::Termination,
};
use nalgebra::Matrix6;

/// Walks from `start` until a step is below the tolerances.
pub(super) fn minimize(
    objective: &mut impl Objective,
    params: &DescentParams,
    start: &Se3,
    keep: &Matrix6<f64>,
) -> Descent {
    let (mut pose, mut iterations) = (*start, 0);
    loop {
        iterations += 1;
        let quadratic = objective.evaluate(&pose);
        let end = |pose, termination| Descent { pose, quadratic, iterations, termination };
        if quadratic.matches == 0 || !quadratic.cost.is_finite() {
            return end(pose, Termination::TooFewPoints);
        }
        let hessian = keep * quadratic.hessian * keep + (Matrix6::identity() - keep);
        let damped = hessian + Matrix6::from_diagonal(&(hessian.diagonal().map(f64::abs) * params.initial_damping));
        let step = damped.cholesky().map(|factor| keep * factor.solve(&-(keep * quadratic.gradient)));
        let Some(step) = step.filter(|step| step.iter().all(|v| v.is_finite())) else {
            return end(pose, Termination::Degenerate);
        };
        if params.at_rest(&step) {
            return end(pose.plus(&step), Termination::Converged);
        }
        if iterations >= params.max_iterations {
            return end(pose, Termination::IterationLimit);
        }
        pose = pose.plus(&(step * params.limit(&step)));
    }
}
