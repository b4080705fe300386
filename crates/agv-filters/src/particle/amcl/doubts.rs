//! A [`Recovery`] for each sensor: how likely a scan is cannot be compared with how likely a code is.

use crate::particle::{Recovery, RecoveryParams, per_sensor::PerSensor};
use agv_core::{
    Error,
    sensors::{Observation, SensorId},
};

/// The recoveries of all sensors.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Doubts {
    /// What a sensor that was not heard of begins with.
    fresh: Recovery,
    known: PerSensor<Recovery>,
}

impl Doubts {
    pub(super) fn new(params: RecoveryParams) -> Result<Self, Error> {
        Ok(Self { fresh: Recovery::new(params)?, known: PerSensor::new() })
    }

    /// The parameters of all.
    pub(super) const fn params(&self) -> &RecoveryParams {
        self.fresh.params()
    }

    /// Forgets the past; a belief that says nothing is searched for from the first observation on.
    pub(super) fn begin(&mut self, says_nothing: bool) {
        self.known.clear();
        self.fresh.clear();
        if says_nothing {
            self.fresh.search();
        }
    }

    /// The recovery of the sensor that an observation is of.
    pub(super) fn of<Z: Observation + ?Sized>(&mut self, observation: &Z) -> &mut Recovery {
        self.known.of(observation, self.fresh)
    }

    /// The recovery of a sensor, if it was heard of.
    pub(super) fn get(&self, kind: &str, sensor: SensorId) -> Option<&Recovery> {
        self.known.get(kind, sensor)
    }

    /// Takes what was stored, into its own memory.
    #[cfg(feature = "serde")]
    pub(super) fn assign(&mut self, other: &Self) {
        self.fresh = other.fresh;
        self.known.assign(&other.known);
    }
}
