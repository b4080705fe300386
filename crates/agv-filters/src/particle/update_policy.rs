//! When to take in an observation.

use agv_core::{Error, check, geometry::Se2, sensors::SensorId};

/// What an [`UpdatePolicy`] decides by.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct UpdateContext {
    /// Whose observation waits.
    pub sensor: SensorId,
    /// How the vehicle has moved since the last observation of that sensor that was applied: the base now, in the base
    /// frame of then.
    pub motion: Se2,
    /// How far from there it has been at most since, in metres: after a lap it may be where it was, and has been far.
    pub distance: f64,
    /// How much it has been turned from then at most, in radians.
    pub angle: f64,
}

impl UpdateContext {
    /// An observation of `sensor` waits, `motion` after the last one, and never farther from there than now.
    pub fn new(sensor: SensorId, motion: Se2) -> Self {
        Self { sensor, motion, distance: motion.translation().norm(), angle: motion.yaw().abs() }
    }

    /// The same of a vehicle that has been that far from there, in metres, and turned that much, in radians; what is less than its
    /// motion is the motion.
    #[must_use]
    pub const fn having_been(self, distance: f64, angle: f64) -> Self {
        Self { distance: distance.max(self.distance), angle: angle.max(self.angle), ..self }
    }
}

/// Whether the vehicle has moved enough for a sensor to say anything new.
///
/// Asked per sensor, since what one has seen from a place says nothing of what another sees from there. The first
/// observation of a sensor is taken in without asking.
pub trait UpdatePolicy {
    /// Whether the observation is to be taken in.
    fn is_due(&self, context: &UpdateContext) -> bool;
}

/// Update once the vehicle has been this far away, or turned this much, from where it was: it may have come back since.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionThreshold {
    /// Least distance to be reached between updates, in metres; zero takes every observation.
    pub distance: f64,
    /// Least turn to be reached between updates, in radians; zero takes every observation.
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

    /// Whether a distance, in metres, or a turn, in radians, reaches its threshold.
    pub fn is_reached(&self, distance: f64, angle: f64) -> bool {
        distance >= self.distance || angle >= self.angle
    }
}

impl UpdatePolicy for MotionThreshold {
    fn is_due(&self, context: &UpdateContext) -> bool {
        self.is_reached(context.distance, context.angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_threshold_is_enough() {
        let is_due = |policy: MotionThreshold, motion| policy.is_due(&UpdateContext::new(SensorId::default(), motion));
        let policy = MotionThreshold::default();
        assert!(!is_due(policy, Se2::new(0.1, 0.1, 0.1)));
        assert!(is_due(policy, Se2::new(0.0, -0.21, 0.0)));
        assert!(is_due(policy, Se2::new(0.0, 0.0, -0.21)));
        assert!(is_due(MotionThreshold { distance: 0.0, angle: 0.0 }, Se2::default()));
    }

    #[test]
    fn who_has_been_away_has_moved() {
        let back = UpdateContext::new(SensorId::default(), Se2::new(0.1, 0.0, 0.0));
        let policy = MotionThreshold::default();
        assert!(!policy.is_due(&back.having_been(0.15, 0.15)));
        assert!(policy.is_due(&back.having_been(0.3, 0.0)) && policy.is_due(&back.having_been(0.0, 0.3)));
        assert_eq!(back.having_been(0.0, 0.0), back, "never nearer than it is");
    }

    #[test]
    fn bad_thresholds_are_named() {
        assert!(MotionThreshold { distance: -1.0, angle: 0.1 }.validate().is_err());
        assert!(MotionThreshold { distance: 0.1, angle: f64::NAN }.validate().is_err());
    }
}
