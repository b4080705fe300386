//! What a filter asks of every observation, whatever its kind.

use super::{LaserScan, PointCloud, SensorId};
use crate::time::Stamp;

/// An observation as a filter sees it from outside: when it was taken, and by which sensor.
///
/// Two observations of one kind that agree in both are the same one, delivered twice; stamps of one sensor do not
/// decrease, those of two sensors may. Where a sensor sees several things at once (the markers of one image), the
/// observation is the slice of them, which is one as its first entry is. Kinds that know neither time nor sensor are an
/// `impl Observation for Heading {}`.
pub trait Observation {
    /// The time that it refers to; none if it does not know.
    fn stamp(&self) -> Option<Stamp> {
        None
    }

    /// A name for the kind of observation, the same for all of them and unlike those of other kinds. Together with
    /// [`sensor`](Self::sensor) it says which stream an observation belongs to.
    ///
    /// By default the name of the type as the compiler writes it; a kind whose name is to outlive a compiler or a renaming,
    /// in checkpoints, states its own.
    fn kind(&self) -> &'static str {
        std::any::type_name::<Self>()
    }

    /// The sensor whose stream it belongs to; the default one if there is only one of the kind.
    fn sensor(&self) -> SensorId {
        SensorId::default()
    }
}

/// An observation whose content the sensor model knows: that a door opened, that a fence was not crossed.
impl Observation for () {
    fn kind(&self) -> &'static str {
        "nothing"
    }
}

/// What one sensor saw at one time; empty if it saw nothing, which is at no known time.
impl<T: Observation> Observation for [T] {
    fn stamp(&self) -> Option<Stamp> {
        self.first().and_then(T::stamp)
    }

    fn sensor(&self) -> SensorId {
        self.first().map(T::sensor).unwrap_or_default()
    }
}

impl Observation for LaserScan {
    fn kind(&self) -> &'static str {
        "laser scan"
    }

    fn stamp(&self) -> Option<Stamp> {
        Some(self.stamp())
    }

    fn sensor(&self) -> SensorId {
        self.sensor()
    }
}

impl Observation for PointCloud {
    fn kind(&self) -> &'static str {
        "point cloud"
    }

    fn stamp(&self) -> Option<Stamp> {
        Some(self.stamp())
    }

    fn sensor(&self) -> SensorId {
        self.sensor()
    }
}
