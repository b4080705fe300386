//! Limits of an actuator.

use crate::Error;
use agv_core::check;

/// What an actuator can do with a command: its change is limited to a rate, and its value to a range.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ActuatorLimits {
    /// Least input of the plant.
    pub min: f64,
    /// Greatest input of the plant.
    pub max: f64,
    /// Greatest change of the input per second.
    pub rate: f64,
}

impl Default for ActuatorLimits {
    /// No limits. That is the greatest number rather than infinity, which texts cannot store.
    fn default() -> Self {
        Self { min: f64::MIN, max: f64::MAX, rate: f64::MAX }
    }
}

impl ActuatorLimits {
    /// Within `± magnitude`, as fast as it likes.
    pub const fn symmetric(magnitude: f64) -> Self {
        Self { min: -magnitude, max: magnitude, rate: f64::MAX }
    }

    /// Checks that the limits can be kept.
    ///
    /// # Errors
    /// The first limit that is not finite, a range without zero, at which an actuator rests, or a rate that is not
    /// positive.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("min", self.min, f64::MIN, 0.0)?;
        check::in_range("max", self.max, 0.0, f64::MAX)?;
        check::positive("rate", self.rate)?;
        Ok(())
    }

    /// The input that `command` gives `dt` seconds after `last`.
    pub fn apply(&self, command: f64, last: f64, dt: f64) -> f64 {
        limit(command, last, self.min, self.max, self.rate * dt)
    }
}

/// Limits the change of `command` from `last` to `step`, then clamps it to the range, which holds even where it was just
/// narrowed; what is not a number stays so. In the form that compiles to one instruction a bound.
#[inline]
pub(crate) fn limit(command: f64, last: f64, min: f64, max: f64, step: f64) -> f64 {
    let slewed = at_most(at_least(command, last - step), last + step);
    at_most(at_least(slewed, min), max)
}

#[inline]
pub(crate) fn at_least(value: f64, min: f64) -> f64 {
    if min > value { min } else { value }
}

#[inline]
pub(crate) fn at_most(value: f64, max: f64) -> f64 {
    if max < value { max } else { value }
}
