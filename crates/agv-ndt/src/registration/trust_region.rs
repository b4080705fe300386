//! Damped Newton steps: Levenberg and Marquardt's way between Newton's step and the gradient's, with an early stop.
//!
//! Each step solves `(H + λ D) δ = -g` with the diagonal `D` of the greatest curvatures met so far; the damping follows the
//! gain ratio (Madsen, Nielsen and Tingleff 2004, Algorithm 3.16). A Hessian that is not positive definite, as Newton's is far
//! from the optimum, is damped until it is. One evaluation a step, no line search; a step below the tolerances is taken and not
//! evaluated.

use super::{Objective, Quadratic};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se3},
    roles::Termination,
};
use nalgebra::{Matrix6, Vector6};

/// When to stop, and how far to step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DescentParams {
    /// Most evaluations.
    pub max_iterations: usize,
    /// At rest when a step moves less than this, in metres, ...
    pub translation_tolerance: f64,
    /// ... and turns less than this, in radians.
    pub rotation_tolerance: f64,
    /// Longest translation of a step, in metres.
    pub max_translation: f64,
    /// Longest rotation of a step, in radians.
    pub max_rotation: f64,
    /// First damping, relative to the diagonal.
    pub initial_damping: f64,
}

impl Default for DescentParams {
    /// Tolerances of 0.5 mm and 0.05 mrad, far below a lidar's noise; steps of half a metre and 0.2 rad, about what the
    /// voxels' linear range is.
    fn default() -> Self {
        Self {
            max_iterations: 50,
            translation_tolerance: 5e-4,
            rotation_tolerance: 5e-5,
            max_translation: 0.5,
            max_rotation: 0.2,
            initial_damping: 1e-4,
        }
    }
}

impl DescentParams {
    pub(crate) fn validate(&self) -> Result<(), Error> {
        check::at_least("max_iterations", self.max_iterations, 1)?;
        for (name, value) in [
            ("translation_tolerance", self.translation_tolerance),
            ("rotation_tolerance", self.rotation_tolerance),
            ("max_translation", self.max_translation),
            ("max_rotation", self.max_rotation),
            ("initial_damping", self.initial_damping),
        ] {
            check::positive(name, value)?;
        }
        Ok(())
    }
}

/// Where a descent ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Descent {
    /// The pose of least cost that was met.
    pub pose: Se3,
    /// The cost there, or one step below the tolerances before.
    pub quadratic: Quadratic,
    /// Evaluations.
    pub iterations: usize,
    /// Why it ended.
    pub termination: Termination,
}

/// The optimiser: parameters only.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevenbergMarquardt {
    params: DescentParams,
}

/// Damping beyond which no step improves anything.
const MAX_DAMPING: f64 = 1e8;

impl LevenbergMarquardt {
    /// An optimiser.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::TooFew`] with the name of the parameter.
    pub fn new(params: DescentParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params })
    }

    /// Walks from `start` down to a minimum along the tangents that `keep` leaves: the projector onto the directions that may
    /// change, the unit matrix for all.
    pub fn minimize(&self, objective: &mut impl Objective, start: &Se3, keep: &Matrix6<f64>) -> Descent {
        let params = &self.params;
        let mut best = Descent {
            pose: *start,
            quadratic: objective.evaluate(start),
            iterations: 1,
            termination: Termination::IterationLimit,
        };
        let (mut damping, mut growth, mut scale) = (params.initial_damping, 2.0, Vector6::zeros());
        loop {
            if best.quadratic.matches == 0 || !best.quadratic.cost.is_finite() {
                best.termination = Termination::TooFewPoints;
                return best;
            }
            let gradient = keep * best.quadratic.gradient;
            // Directions that are held have a curvature of their own, so that the matrix can be solved.
            let hessian = keep * best.quadratic.hessian * keep + (Matrix6::identity() - keep);
            scale = scale.zip_map(&hessian.diagonal(), |s: f64, h| s.max(h));
            let step = loop {
                let damped = hessian + Matrix6::from_diagonal(&(scale * damping));
                if let Some(factor) = damped.cholesky() {
                    break factor.solve(&-gradient);
                }
                damping *= 4.0;
                if damping > MAX_DAMPING {
                    best.termination = Termination::Degenerate;
                    return best;
                }
            };
            let (mut step, translation, rotation) = {
                let (translation, rotation) = (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm());
                (step, translation, rotation)
            };
            if !(translation.is_finite() && rotation.is_finite()) {
                best.termination = Termination::Degenerate;
                return best;
            }
            if translation <= params.translation_tolerance && rotation <= params.rotation_tolerance {
                best.pose = best.pose.plus(&step);
                best.termination = Termination::Converged;
                return best;
            }
            if best.iterations >= params.max_iterations {
                return best;
            }
            step *= (params.max_translation / translation).min(params.max_rotation / rotation).min(1.0);
            let trial = best.pose.plus(&step);
            let quadratic = objective.evaluate(&trial);
            best.iterations += 1;
            let promised = -step.dot(&gradient) - 0.5 * step.dot(&(hessian * step));
            let gain = (best.quadratic.cost - quadratic.cost) / promised.max(f64::MIN_POSITIVE);
            if quadratic.cost < best.quadratic.cost {
                (best.pose, best.quadratic) = (trial, quadratic);
                damping = (damping * (1.0 - (2.0 * gain.min(1.0) - 1.0).powi(3)).max(1.0 / 9.0)).max(1e-12);
                growth = 2.0;
            } else {
                damping = damping.max(1e-3) * growth;
                growth *= 2.0;
                if damping > MAX_DAMPING {
                    best.termination = Termination::Stalled;
                    return best;
                }
            }
        }
    }
}
