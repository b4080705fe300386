//! Limits of an actuator.

use crate::Error;
use agv_core::check;

/// What an actuator can do with a command: it is clamped to a range, and its change to a rate.
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

/// Clamps `command` to the range, then its change from `last` to `step`; what is not a number stays so. In the form
/// that compiles to one instruction a bound.
#[inline]
pub(crate) fn limit(command: f64, last: f64, min: f64, max: f64, step: f64) -> f64 {
    let ranged = at_most(at_least(command, min), max);
    at_most(at_least(ranged, last - step), last + step)
}

#[inline]
pub(crate) fn at_least(value: f64, min: f64) -> f64 {
    if min > value { min } else { value }
}

#[inline]
pub(crate) fn at_most(value: f64, max: f64) -> f64 {
    if max < value { max } else { value }
}
