//! A value for each sensor: what one laser has seen says nothing of another, nor of a camera with the same number.

use agv_core::sensors::{Observation, SensorId};
use std::borrow::Cow;

/// Sensors that a table has room for without allocating.
const ROOM: usize = 16;

/// Values by kind and number of the sensor.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub(super) struct PerSensor<T> {
    entries: Vec<Entry<T>>,
}

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Entry<T> {
    kind: Cow<'static, str>,
    sensor: SensorId,
    value: T,
}

impl<T> PerSensor<T> {
    pub(super) fn new() -> Self {
        Self { entries: Vec::with_capacity(ROOM) }
    }

    pub(super) fn clear(&mut self) {
        self.entries.clear();
    }

    fn position(&self, kind: &str, sensor: SensorId) -> Option<usize> {
        self.entries.iter().position(|entry| entry.sensor == sensor && entry.kind == kind)
    }

    /// The value of a sensor, if it was heard of.
    pub(super) fn get(&self, kind: &str, sensor: SensorId) -> Option<&T> {
        self.position(kind, sensor).map(|index| &self.entries[index].value)
    }

    /// The value of the sensor that an observation is of, which begins as `fresh`.
    pub(super) fn of<Z: Observation + ?Sized>(&mut self, observation: &Z, fresh: T) -> &mut T {
        let (kind, sensor) = (observation.kind(), observation.sensor());
        let known = self.position(kind, sensor);
        let index = known.unwrap_or(self.entries.len());
        if known.is_none() {
            self.entries.push(Entry { kind: Cow::Borrowed(kind), sensor, value: fresh });
        }
        &mut self.entries[index].value
    }

    /// The values of all sensors.
    pub(super) fn values_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.entries.iter_mut().map(|entry| &mut entry.value)
    }

    /// Takes the values of another table, into its own memory.
    #[cfg(feature = "serde")]
    pub(super) fn assign(&mut self, other: &Self)
    where
        T: Clone,
    {
        self.entries.clone_from(&other.entries);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Seen(&'static str, u16);

    impl Observation for Seen {
        fn kind(&self) -> &'static str {
            self.0
        }

        fn sensor(&self) -> SensorId {
            SensorId(self.1)
        }
    }

    #[test]
    fn sensors_are_told_apart_by_kind_and_number() {
        let mut table = PerSensor::new();
        let all = [Seen("scan", 0), Seen("scan", 1), Seen("code", 0)];
        for (value, seen) in all.iter().enumerate() {
            assert!(all[value..].iter().all(|seen| table.get(seen.kind(), seen.sensor()).is_none()));
            assert_eq!(*table.of(seen, value), value);
        }
        *table.of(&all[1], 9) += 10;
        assert_eq!(
            all.each_ref().map(|seen| table.get(seen.kind(), seen.sensor()).copied()),
            [Some(0), Some(11), Some(2)]
        );
        table.clear();
        assert_eq!(table.get("scan", SensorId(0)), None);
    }
}
