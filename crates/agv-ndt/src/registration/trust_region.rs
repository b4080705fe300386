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
            // A step may also be short because no longer one was of use.
            let at_rest = damping <= 1.0 || nearly_at_rest(&hessian, &scale, &gradient, params);
            best.pose = best.pose.plus(&step);
            return Descent {
                termination: if at_rest { Termination::Converged } else { Termination::Stalled },
                ..best
            };
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

/// Whether a step that is hardly damped would be short as well.
fn nearly_at_rest(
    hessian: &Matrix6<f64>,
    scale: &Vector6<f64>,
    gradient: &Vector6<f64>,
    params: &DescentParams,
) -> bool {
    let damped = hessian + Matrix6::from_diagonal(&(scale * params.initial_damping));
    damped.cholesky().is_some_and(|factor| params.nearly_at_rest(&factor.solve(gradient)))
}

#[cfg(test)]
mod tests {
    use super::super::{Freedom, MotionSums, Optimizer, PointDerivatives, Quadratic};
    use super::*;
    use agv_core::geometry::So3;
    use nalgebra::{Matrix3, Vector3};

    /// Points that belong to others, at the same place after `truth`; far ones count less, as a well has it.
    struct Pairs {
        source: Vec<Vector3<f64>>,
        truth: Se3,
        evaluations: usize,
    }

    impl Objective for Pairs {
        fn evaluate(&mut self, pose: &Se3) -> Quadratic {
            self.evaluations += 1;
            let mut sums = MotionSums::default();
            for p in &self.source {
                let d = pose.act(p) - self.truth.act(p);
                let e = (-0.1 * d.norm_squared()).exp();
                let hessian = (Matrix3::identity() - d * d.transpose() * 0.2) * (0.2 * e);
                let point = PointDerivatives { cost: -e, gradient: d * (0.2 * e), hessian, curvature: 1.0 };
                sums.add(&pose.rotation().act(p), &point);
            }
            sums.quadratic(pose)
        }
    }

    fn pairs(truth: Se3) -> Pairs {
        let source = (0..50)
            .map(|i| Vector3::new((f64::from(i) * 0.7).sin(), (f64::from(i) * 1.3).cos(), (f64::from(i) * 2.1).sin()));
        Pairs { source: source.map(|p| p * 3.0).collect(), truth, evaluations: 0 }
    }

    #[test]
    fn both_optimizers_find_the_pose_from_where_the_hessian_is_indefinite() {
        let truth = Se3::from_parts(Vector3::new(1.0, -2.0, 1.5), So3::from_roll_pitch_yaw(0.3, -0.2, 0.5));
        for optimizer in [Optimizer::TrustRegion, Optimizer::LineSearch] {
            let mut problem = pairs(truth);
            let params =
                DescentParams { translation_tolerance: 1e-8, rotation_tolerance: 1e-8, ..DescentParams::default() };
            let found = optimizer.minimize(&mut problem, &params, &Se3::default(), &Matrix6::identity());
            assert_eq!(found.termination, Termination::Converged, "{optimizer:?}");
            assert!(found.pose.minus(&truth).norm() < 1e-7, "{optimizer:?} {:?}", found.pose);
            assert_eq!(found.iterations, problem.evaluations);
            assert!(found.iterations < 25, "{optimizer:?}: {}", found.iterations);
        }
    }

    #[test]
    fn held_directions_stay_and_limits_end_the_search() {
        let truth = Se3::from_parts(Vector3::new(0.5, -0.4, 0.3), So3::from_roll_pitch_yaw(0.02, -0.03, 0.2));
        for optimizer in [Optimizer::TrustRegion, Optimizer::LineSearch] {
            let (params, start) = (DescentParams::default(), Se3::from_parts(Vector3::z() * 0.1, So3::default()));
            let keep = Freedom::Planar.projector(&start);
            let found = optimizer.minimize(&mut pairs(truth), &params, &start, &keep);
            let (roll, pitch, yaw) = found.pose.rotation().roll_pitch_yaw();
            assert_eq!(found.termination, Termination::Converged);
            assert!((found.pose.translation().z - 0.1).abs() < 1e-9 && roll.abs() < 1e-9 && pitch.abs() < 1e-9);
            assert!((yaw - 0.2).abs() < 0.02 && (found.pose.translation().x - 0.5).abs() < 0.05, "{:?}", found.pose);
            let few = DescentParams { max_iterations: 2, ..params };
            let found = optimizer.minimize(&mut pairs(truth), &few, &start, &Matrix6::identity());
            assert_eq!((found.termination, found.iterations), (Termination::IterationLimit, 2));
        }
    }

    #[test]
    fn nothing_matched_is_said_and_bad_parameters_are_named() {
        let mut none = Pairs { source: vec![], truth: Se3::default(), evaluations: 0 };
        for optimizer in [Optimizer::TrustRegion, Optimizer::LineSearch] {
            let found = optimizer.minimize(&mut none, &DescentParams::default(), &Se3::default(), &Matrix6::identity());
            assert_eq!(found.termination, Termination::TooFewPoints);
        }
        let good = DescentParams::default();
        for bad in [
            DescentParams { max_iterations: 0, ..good },
            DescentParams { translation_tolerance: 0.0, ..good },
            DescentParams { rotation_tolerance: f64::NAN, ..good },
            DescentParams { max_translation: -1.0, ..good },
            DescentParams { max_rotation: f64::INFINITY, ..good },
            DescentParams { initial_damping: 0.0, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
