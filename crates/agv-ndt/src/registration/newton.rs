//! Newton's method with a line search (Magnusson 2009, section 6.2).
//!
//! Where the Hessian is not positive definite its eigenvalues are replaced by their magnitudes, so that the direction leads
//! downhill. Along the tangent `δ` the slope at step `α` is the gradient there times `δ`, since `exp(α δ)` commutes with `δ`. A step
//! may be up to four times as long as Newton's, as far as the longest step allows.

use super::{Descent, DescentParams, LinePoint, LineSearchEnd, LineSearchParams, MoreThuente, Objective, Quadratic};
use agv_core::{
    geometry::{LieGroup, Se3},
    roles::Termination,
};
use nalgebra::{Matrix6, Vector6};

/// Longest step, in those of Newton.
const LONGEST: f64 = 4.0;

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
        let nearly_at_rest = params.nearly_at_rest(&step);
        let step = step * params.limit(&step);
        let mut tried = best;
        let Ok(search) = MoreThuente::new(LineSearchParams {
            max_step: params.reach(&step).clamp(1.0, LONGEST),
            max_evaluations: params.max_iterations - best.iterations,
            ..LineSearchParams::default()
        }) else {
            return best;
        };
        let origin = LinePoint { step: 0.0, value: best.quadratic.cost, slope: gradient.dot(&step) };
        let (found, end, evaluations) = search.search(&origin, 1.0, |along| {
            tried.pose = best.pose.plus(&(step * along));
            tried.quadratic = objective.evaluate(&tried.pose);
            LinePoint { step: along, value: tried.quadratic.cost, slope: (keep * tried.quadratic.gradient).dot(&step) }
        });
        best.iterations += evaluations;
        // What was tried last is what was found, unless the cost was no number there.
        if !sound(&tried.quadratic) || found.value >= best.quadratic.cost || found.step == 0.0 {
            let termination = if end == LineSearchEnd::EvaluationLimit {
                Termination::IterationLimit
            } else if nearly_at_rest && sound(&tried.quadratic) {
                Termination::Converged
            } else {
                Termination::Stalled
            };
            return Descent { termination, ..best };
        }
        (best.pose, best.quadratic) = (tried.pose, tried.quadratic);
    }
}

/// Whether a cost and its slope are numbers.
fn sound(quadratic: &Quadratic) -> bool {
    quadratic.cost.is_finite() && quadratic.gradient.iter().all(|v| v.is_finite())
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

#[cfg(test)]
mod tests {
    use super::super::Optimizer;
    use super::*;

    /// A cost of the translation along x alone: value, slope and curvature.
    struct Along<F>(F, Vec<f64>);

    impl<F: Fn(f64) -> (f64, f64, f64)> Objective for Along<F> {
        fn evaluate(&mut self, pose: &Se3) -> Quadratic {
            let x = pose.translation().x;
            self.1.push(x);
            let (cost, slope, bend) = (self.0)(x);
            let mut hessian = Matrix6::identity();
            hessian[(0, 0)] = bend;
            Quadratic { cost, gradient: Vector6::ith(0, slope), hessian, matches: 1 }
        }
    }

    fn walked<F: Fn(f64) -> (f64, f64, f64)>(cost: F, params: &DescentParams) -> (Descent, Vec<f64>) {
        let mut objective = Along(cost, Vec::new());
        let found = Optimizer::LineSearch.minimize(&mut objective, params, &Se3::identity(), &Matrix6::identity());
        (found, objective.1)
    }

    /// Better, then no number: the pose stays where the cost is known.
    #[test]
    fn a_cost_that_is_no_number_is_not_taken() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let edge = |x: f64| if x > 0.2 { (bad, -1.0, 2.0) } else { (-x, -1.0, 2.0) };
            let (found, _) = walked(edge, &DescentParams::default());
            assert_eq!(found.termination, Termination::Stalled);
            assert!(sound(&found.quadratic) && found.pose.translation().x <= 0.2, "{found:?}");
            let slope = |x: f64| (-x, if x > 0.2 { bad } else { -1.0 }, 2.0);
            let (found, _) = walked(slope, &DescentParams::default());
            assert_eq!(found.termination, Termination::Stalled);
            assert!(sound(&found.quadratic) && found.pose.translation().x <= 0.2, "{found:?}");
        }
    }

    #[test]
    fn no_step_is_longer_than_allowed() {
        let params = DescentParams { max_translation: 0.3, max_iterations: 20, ..DescentParams::default() };
        for bend in [0.5, 20.0] {
            let (found, visited) = walked(|x| (-x, -1.0, bend), &params);
            assert_eq!(found.termination, Termination::IterationLimit);
            let mut from = 0.0;
            for x in visited {
                assert!(x - from <= 0.3 + 1e-9, "{from} to {x}");
                from = f64::max(from, x);
            }
        }
    }

    /// Two millimetres before its least the cost jumps: there is no better rest. Where it is no number nothing is known.
    #[test]
    fn a_jump_close_to_the_least_is_rest() {
        for (jump, termination) in [(1e-5, Termination::Converged), (f64::NAN, Termination::Stalled)] {
            let cost = |x: f64| ((x - 0.002).powi(2) + if x > 0.0 { jump } else { 0.0 }, 2.0 * (x - 0.002), 2.0);
            let (found, _) = walked(cost, &DescentParams::default());
            assert_eq!(found.termination, termination);
            assert_eq!(found.pose, Se3::identity());
        }
        // ... nor where there was no more time to look.
        let few = DescentParams { max_iterations: 2, ..DescentParams::default() };
        let cost = |x: f64| ((x - 0.002).powi(2) + if x > 0.0 { 1e-5 } else { 0.0 }, 2.0 * (x - 0.002), 2.0);
        assert_eq!(walked(cost, &few).0.termination, Termination::IterationLimit);
    }

    #[test]
    fn an_exhausted_search_says_so() {
        // The slope lies: the cost rises wherever one looks.
        let few = DescentParams { max_iterations: 3, ..DescentParams::default() };
        assert_eq!(walked(|x| (x, -1.0, 2.0), &few).0.termination, Termination::IterationLimit);
        let many = DescentParams { max_iterations: 50, ..few };
        assert_eq!(walked(|x| (x, -1.0, 2.0), &many).0.termination, Termination::Stalled);
    }
}
