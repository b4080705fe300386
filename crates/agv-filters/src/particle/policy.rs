//! When to take in a scan, and when to draw a new set.

use super::WeightSummary;
use agv_core::{Error, check, geometry::Se2};

/// Whether the vehicle has moved enough for the next observation to say anything new.
pub trait UpdatePolicy {
    /// Whether the motion since the last update calls for another.
    fn is_due(&self, start_from_end: &Se2) -> bool;
}

/// Update once the vehicle has moved this far or turned this much.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionThreshold {
    /// Least distance between updates, in metres; zero takes every observation.
    pub distance: f64,
    /// Least turn between updates, in radians; zero takes every observation.
    pub angle: f64,
}

impl Default for MotionThreshold {
    /// 0.2 m or 0.2 rad, near the 0.25 m and 0.2 rad of `nav2_amcl`: scans from the same place are not independent, and weighing
    /// them all makes a filter certain of their common error.
    fn default() -> Self {
        Self { distance: 0.2, angle: 0.2 }
    }
}

impl MotionThreshold {
    /// Checks both thresholds.
    ///
    /// # Errors
    /// A threshold that is negative or not finite.
    pub fn validate(&self) -> Result<(), Error> {
        check::non_negative("update distance", self.distance)?;
        check::non_negative("update angle", self.angle)?;
        Ok(())
    }
}

impl UpdatePolicy for MotionThreshold {
    fn is_due(&self, start_from_end: &Se2) -> bool {
        start_from_end.translation().norm() >= self.distance || start_from_end.yaw().abs() >= self.angle
    }
}

/// Whether a new set is to be drawn after an update.
pub trait ResamplePolicy {
    /// Whether a set of `count` particles whose weights are as summarised is to be resampled.
    fn is_due(&self, summary: &WeightSummary, count: usize) -> bool;
}

/// Resample when the effective sample size falls below a share of the particles (paper 000, Eq. 7): while the weights
/// are even, resampling would only lose diversity.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EffectiveSampleSizeBelow {
    /// Share of the number of particles, in [0, 1]; one resamples after every update, zero never.
    pub ratio: f64,
}

impl Default for EffectiveSampleSizeBelow {
    /// One half, the usual choice (Doucet and Johansen, *A tutorial on particle filtering and smoothing*, 2009).
    fn default() -> Self {
        Self { ratio: 0.5 }
    }
}

impl EffectiveSampleSizeBelow {
    /// Checks the ratio.
    ///
    /// # Errors
    /// A ratio outside [0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("resampling ratio", self.ratio, 0.0, 1.0).map(|_| ())
    }
}

impl ResamplePolicy for EffectiveSampleSizeBelow {
    fn is_due(&self, summary: &WeightSummary, count: usize) -> bool {
        summary.effective_sample_size < self.ratio * count as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_threshold_is_enough() {
        let policy = MotionThreshold::default();
        assert!(!policy.is_due(&Se2::new(0.1, 0.1, 0.1)));
        assert!(policy.is_due(&Se2::new(0.0, -0.21, 0.0)));
        assert!(policy.is_due(&Se2::new(0.0, 0.0, -0.21)));
        assert!(MotionThreshold { distance: 0.0, angle: 0.0 }.is_due(&Se2::default()));
    }

    #[test]
    fn bad_policies_are_named() {
        assert!(MotionThreshold { distance: -1.0, angle: 0.1 }.validate().is_err());
        assert!(MotionThreshold { distance: 0.1, angle: f64::NAN }.validate().is_err());
        assert!(EffectiveSampleSizeBelow { ratio: 1.1 }.validate().is_err());
        assert!(EffectiveSampleSizeBelow { ratio: f64::NAN }.validate().is_err());
    }
}
