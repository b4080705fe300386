//! What a filter asks of every observation, whatever its kind.

use super::{LaserScan, PointCloud};
use crate::time::Stamp;

/// An observation as a filter sees it from outside: when it was taken.
///
/// Kinds that do not know are an `impl Observation for Heading {}`.
pub trait Observation {
    /// The time that it refers to; none if it does not know.
    fn stamp(&self) -> Option<Stamp> {
        None
    }
}

/// An observation whose content the sensor model knows: that a door opened, that a fence was not crossed.
impl Observation for () {}

impl Observation for LaserScan {
    fn stamp(&self) -> Option<Stamp> {
        Some(self.stamp())
    }
}

impl Observation for PointCloud {
    fn stamp(&self) -> Option<Stamp> {
        Some(self.stamp())
    }
}
