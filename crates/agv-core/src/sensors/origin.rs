//! What every observation says of where it comes from: when, by which sensor, and where that sensor sits.

use super::SensorId;
use crate::{Error, geometry::LieGroup, time::Stamp};

/// Stamp, sensor and mount of an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "RawOrigin<G>",
        bound(serialize = "G: serde::Serialize", deserialize = "G: serde::Deserialize<'de>")
    )
)]
pub(super) struct Origin<G: LieGroup> {
    pub(super) stamp: Stamp,
    pub(super) sensor: SensorId,
    pub(super) base_from_sensor: G,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(deserialize = "G: serde::Deserialize<'de>"))]
struct RawOrigin<G> {
    stamp: Stamp,
    sensor: SensorId,
    base_from_sensor: G,
}

#[cfg(feature = "serde")]
impl<G: LieGroup> TryFrom<RawOrigin<G>> for Origin<G> {
    type Error = Error;

    fn try_from(raw: RawOrigin<G>) -> Result<Self, Error> {
        let origin = Self { sensor: raw.sensor, ..Self::new(raw.stamp) };
        origin.mounted(raw.base_from_sensor)
    }
}

impl<G: LieGroup> Origin<G> {
    /// The only sensor of its kind, at the vehicle's origin.
    pub(super) fn new(stamp: Stamp) -> Self {
        Self { stamp, sensor: SensorId::default(), base_from_sensor: G::identity() }
    }

    pub(super) fn mounted(self, base_from_sensor: G) -> Result<Self, Error> {
        if !base_from_sensor.is_finite() {
            return Err(Error::NotFinite { name: "base_from_sensor", value: f64::NAN });
        }
        Ok(Self { base_from_sensor, ..self })
    }
}

/// Builders and accessors of an observation whose field `origin` is an [`Origin`], and its
/// [`Observation`](super::Observation).
macro_rules! has_origin {
    ($name:ident $(<$group:ident>)?, $mount:ty) => {
        impl $(<$group: $crate::geometry::LieGroup>)? $name $(<$group>)? {
            /// The same observation, by this sensor of the vehicle.
            #[must_use]
            pub const fn with_sensor(mut self, sensor: $crate::sensors::SensorId) -> Self {
                self.origin.sensor = sensor;
                self
            }

            /// The same observation, by a sensor mounted at `base_from_sensor`.
            ///
            /// # Errors
            /// [`Error::NotFinite`](crate::Error::NotFinite).
            pub fn with_mount(self, base_from_sensor: $mount) -> Result<Self, $crate::Error> {
                Ok(Self { origin: self.origin.mounted(base_from_sensor)?, ..self })
            }

            /// When it was taken.
            pub const fn stamp(&self) -> $crate::time::Stamp {
                self.origin.stamp
            }

            /// Which sensor of the vehicle took it.
            pub const fn sensor(&self) -> $crate::sensors::SensorId {
                self.origin.sensor
            }

            /// Pose of the sensor on the vehicle.
            pub const fn base_from_sensor(&self) -> $mount {
                self.origin.base_from_sensor
            }
        }

        impl $(<$group: $crate::geometry::LieGroup>)? $crate::sensors::Observation for $name $(<$group>)? {
            fn stamp(&self) -> Option<$crate::time::Stamp> {
                Some(self.stamp())
            }

            fn sensor(&self) -> $crate::sensors::SensorId {
                self.sensor()
            }
        }
    };
}
pub(super) use has_origin;
