//! A feedback loop for one quantity.

use crate::Error;

/// Why a controller refused a call; its state is as it was.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Drives a measurement to a set-point.
///
/// ```
/// use agv_core::check;
/// use agv_core::roles::{ControlError, Controller};
///
/// /// The simplest controller: output in proportion to the error.
/// struct Proportional(f64);
///
/// impl Controller for Proportional {
///     fn update(&mut self, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError> {
///         check::positive("dt", dt)?;
///         Ok(self.0 * (check::finite("set_point", set_point)? - check::finite("measurement", measurement)?))
///     }
///     fn reset(&mut self) {}
/// }
/// assert_eq!(Proportional(2.0).update(1.0, 0.5, 0.01), Ok(1.0));
/// ```
pub trait Controller {
    /// The output for the next `dt` seconds, in the actuator's unit.
    ///
    /// # Errors
    /// A set-point or measurement that is not finite, or a `dt` that is not positive.
    fn update(&mut self, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError>;

    /// Forgets the past: integrals, filters, previous errors.
    fn reset(&mut self);
}
