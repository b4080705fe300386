//! When a descent stops, and what it comes to.

use super::Quadratic;
use agv_core::{Error, check, geometry::Se3, roles::Termination};
use nalgebra::Vector6;

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
    /// First damping of a trust region, relative to the diagonal.
    pub initial_damping: f64,
}

impl Default for DescentParams {
    /// Tolerances of 0.5 mm and 0.1 mrad, below a lidar's noise; steps of half a metre and 0.2 rad, about as far as a voxel of
    /// 1 m pulls straight.
    fn default() -> Self {
        Self {
            max_iterations: 50,
            translation_tolerance: 5e-4,
            rotation_tolerance: 1e-4,
            max_translation: 0.5,
            max_rotation: 0.2,
            initial_damping: 1e-4,
        }
    }
}

impl DescentParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::TooFew`] with the name of the field.
    pub fn validate(&self) -> Result<(), Error> {
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

    /// The same on a coarse level, of voxels of `edge` metres: it may stop earlier, and step farther, for the next one walks on.
    #[must_use]
    pub(crate) const fn coarse(self, edge: f64) -> Self {
        Self {
            translation_tolerance: self.translation_tolerance.max(0.005 * edge),
            rotation_tolerance: self.rotation_tolerance.max(0.001 * edge),
            max_translation: self.max_translation.max(0.25 * edge),
            ..self
        }
    }

    /// Whether a step is below the tolerances.
    pub(super) fn at_rest(&self, step: &Vector6<f64>) -> bool {
        let (translation, rotation) = lengths(step);
        translation <= self.translation_tolerance && rotation <= self.rotation_tolerance
    }

    /// Whether a step of which nothing came is no sign of trouble: ten times the tolerances, since a cost that jumps where points change
    /// their voxel or partner has no better rest.
    pub(super) fn nearly_at_rest(&self, step: &Vector6<f64>) -> bool {
        self.at_rest(&(step * 0.1))
    }

    /// The factor, at most 1, that keeps a step within its bounds.
    pub(super) fn limit(&self, step: &Vector6<f64>) -> f64 {
        self.reach(step).min(1.0)
    }

    /// How many times the step fits within its bounds.
    pub(super) fn reach(&self, step: &Vector6<f64>) -> f64 {
        let (translation, rotation) = lengths(step);
        (self.max_translation / translation).min(self.max_rotation / rotation)
    }
}

/// Translation in metres and rotation in radians.
fn lengths(step: &Vector6<f64>) -> (f64, f64) {
    (step.fixed_rows::<3>(0).norm(), step.fixed_rows::<3>(3).norm())
}

/// Where a descent ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Descent {
    /// The last pose; with damped steps and with a line search the one of least cost that was met. A last step below the tolerances
    /// is in it.
    pub pose: Se3,
    /// The cost there, or, if a last step was below the tolerances, before it: such a step is taken and not evaluated.
    pub quadratic: Quadratic,
    /// Evaluations.
    pub iterations: usize,
    /// Why it ended.
    pub termination: Termination,
}

/// What a descent came to, given whether the fit explains enough of the source and how many directions it leaves free.
///
/// What explains too little says nothing of directions either; and one whose step could not be solved, though no direction is free, has
/// not come to rest.
pub(crate) fn verdict(ended: Termination, is_good: bool, free_directions: f64) -> Termination {
    match ended {
        Termination::Converged | Termination::Degenerate if !is_good => Termination::PoorFit,
        Termination::Converged | Termination::Degenerate if free_directions > 0.5 => Termination::Degenerate,
        Termination::Degenerate => Termination::Stalled,
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_good_fit_tells_directions() {
        use Termination::{Converged, Degenerate, IterationLimit, PoorFit, Stalled};
        for (ended, is_good, free, expected) in [
            (Converged, true, 0.0, Converged),
            (Converged, true, 1.0, Degenerate),
            (Converged, false, 1.0, PoorFit),
            (Degenerate, false, 0.0, PoorFit),
            (Degenerate, true, 1.0, Degenerate),
            (Degenerate, true, 0.0, Stalled),
            (IterationLimit, false, 1.0, IterationLimit),
        ] {
            assert_eq!(verdict(ended, is_good, free), expected, "{ended:?} {is_good} {free}");
        }
    }
}
