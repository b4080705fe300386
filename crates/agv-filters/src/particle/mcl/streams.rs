//! What each sensor has seen last: a scan of one laser says nothing of what another sees from the same place.

use agv_core::{
    geometry::{LieGroup, Se2},
    sensors::{Observation, SensorId},
};
use std::borrow::Cow;

/// Sensors that a table has room for without allocating.
const ROOM: usize = 16;

/// Where the vehicle was when the last observation of each sensor was applied.
#[derive(Debug, Clone)]
pub(super) struct Streams {
    last: Vec<LastApplied>,
}

/// One sensor's entry.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct LastApplied {
    kind: Cow<'static, str>,
    sensor: SensorId,
    /// The base then, in the frame that the odometry is summed up in.
    odom_from_base: Se2,
}

impl Streams {
    pub(super) fn new() -> Self {
        Self { last: Vec::with_capacity(ROOM) }
    }

    /// Forgets what was seen: the next observation of every sensor is new.
    pub(super) fn clear(&mut self) {
        self.last.clear();
    }

    /// The motion since the last applied observation of the same sensor; none if there was none.
    pub(super) fn motion_since<Z: Observation + ?Sized>(&self, observation: &Z, odom_from_base: &Se2) -> Option<Se2> {
        let last = self.last.iter().find(|last| last.is_of(observation))?;
        Some(last.odom_from_base.between(odom_from_base))
    }

    /// An observation was applied where the base is now.
    pub(super) fn applied<Z: Observation + ?Sized>(&mut self, observation: &Z, odom_from_base: &Se2) {
        let (kind, sensor, odom_from_base) = (Cow::Borrowed(observation.kind()), observation.sensor(), *odom_from_base);
        match self.last.iter_mut().find(|last| last.is_of(observation)) {
            Some(last) => last.odom_from_base = odom_from_base,
            None => self.last.push(LastApplied { kind, sensor, odom_from_base }),
        }
    }

    /// The entries, to store.
    #[cfg(feature = "serde")]
    pub(super) fn entries(&self) -> &[LastApplied] {
        &self.last
    }

    /// A table with the stored entries.
    #[cfg(feature = "serde")]
    pub(super) fn restored(entries: &[LastApplied]) -> Self {
        let mut streams = Self::new();
        streams.last.extend_from_slice(entries);
        streams
    }
}

impl LastApplied {
    fn is_of<Z: Observation + ?Sized>(&self, observation: &Z) -> bool {
        self.sensor == observation.sensor() && self.kind == observation.kind()
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
        let mut streams = Streams::new();
        let (start, later) = (Se2::identity(), Se2::new(1.0, 0.0, 0.5));
        let all = [Seen("scan", 0), Seen("scan", 1), Seen("code", 0)];
        for (index, seen) in all.iter().enumerate() {
            assert!(all[index..].iter().all(|seen| streams.motion_since(seen, &start).is_none()));
            streams.applied(seen, &start);
        }
        streams.applied(&all[1], &later);
        let motions = all.each_ref().map(|seen| streams.motion_since(seen, &later));
        assert_eq!(motions, [Some(later), Some(start), Some(later)]);
        streams.clear();
        assert_eq!(streams.motion_since(&all[0], &later), None);
    }
}
