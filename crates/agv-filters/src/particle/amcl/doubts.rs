//! A [`Recovery`] for each sensor: how likely a scan is cannot be compared with how likely a code is.

use crate::particle::{Recovery, RecoveryParams};
use agv_core::{
    Error,
    sensors::{Observation, SensorId},
};
use std::borrow::Cow;

/// Sensors that a table has room for without allocating.
const ROOM: usize = 16;

/// The recoveries of all sensors.
#[derive(Debug, Clone)]
pub(super) struct Doubts {
    /// What a sensor that was not heard of begins with.
    fresh: Recovery,
    entries: Vec<SensorDoubt>,
}

/// One sensor's.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct SensorDoubt {
    kind: Cow<'static, str>,
    sensor: SensorId,
    recovery: Recovery,
}

impl Doubts {
    pub(super) fn new(params: RecoveryParams) -> Result<Self, Error> {
        Ok(Self { fresh: Recovery::new(params)?, entries: Vec::with_capacity(ROOM) })
    }

    /// The parameters of all.
    pub(super) const fn params(&self) -> &RecoveryParams {
        self.fresh.params()
    }

    /// Forgets the past; a belief that says nothing is searched for from the first observation on.
    pub(super) fn begin(&mut self, says_nothing: bool) {
        self.entries.clear();
        self.fresh.clear();
        if says_nothing {
            self.fresh.search();
        }
    }

    /// The recovery of the sensor that an observation is of.
    pub(super) fn of<Z: Observation + ?Sized>(&mut self, observation: &Z) -> &mut Recovery {
        let (kind, sensor) = (observation.kind(), observation.sensor());
        let known = self.entries.iter().position(|entry| entry.sensor == sensor && entry.kind == kind);
        let index = known.unwrap_or(self.entries.len());
        if known.is_none() {
            self.entries.push(SensorDoubt { kind: Cow::Borrowed(kind), sensor, recovery: self.fresh });
        }
        &mut self.entries[index].recovery
    }

    /// The recovery of a sensor, if it was heard of.
    pub(super) fn get(&self, kind: &str, sensor: SensorId) -> Option<&Recovery> {
        self.entries.iter().find(|entry| entry.sensor == sensor && entry.kind == kind).map(|entry| &entry.recovery)
    }

    /// The entries, to store.
    #[cfg(feature = "serde")]
    pub(super) fn entries(&self) -> (Recovery, &[SensorDoubt]) {
        (self.fresh, &self.entries)
    }

    /// Takes stored entries.
    #[cfg(feature = "serde")]
    pub(super) fn restore(&mut self, fresh: Recovery, entries: &[SensorDoubt]) {
        self.fresh = fresh;
        self.entries.clear();
        self.entries.extend_from_slice(entries);
    }
}
