//! The recent past of one moving edge: stamped poses in order of time, bounded by duration and by count.

use crate::{
    geometry::{LieGroup, Se3},
    time::Stamp,
};
use std::collections::VecDeque;

/// What became of a stamped transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Insertion {
    /// Stored, in its place in time.
    Added,
    /// There was a transform with this very stamp; the new one took its place.
    Replaced,
    /// Older than the history reaches; dropped.
    TooOld,
}

#[derive(Debug, Clone)]
pub(super) struct History {
    /// Never empty, stamps strictly increasing.
    samples: VecDeque<(Stamp, Se3)>,
    duration: f64,
    capacity: usize,
}

impl History {
    /// A history of one sample, with room for `capacity` so that it never allocates again.
    pub(super) fn new(stamp: Stamp, pose: Se3, duration: f64, capacity: usize) -> Self {
        let mut samples = VecDeque::with_capacity(capacity + 1);
        samples.push_back((stamp, pose));
        Self { samples, duration, capacity }
    }

    pub(super) fn insert(&mut self, stamp: Stamp, pose: Se3) -> Insertion {
        let place = self.samples.partition_point(|(s, _)| *s < stamp);
        if let Some(known) = self.samples.get_mut(place).filter(|(s, _)| *s == stamp) {
            known.1 = pose;
            return Insertion::Replaced;
        }
        if self.latest() - stamp > self.duration || (place == 0 && self.samples.len() >= self.capacity) {
            return Insertion::TooOld;
        }
        self.samples.insert(place, (stamp, pose));
        let oldest_kept = self.latest();
        while self.samples.len() > self.capacity || oldest_kept - self.earliest() > self.duration {
            self.samples.pop_front();
        }
        Insertion::Added
    }

    pub(super) fn earliest(&self) -> Stamp {
        self.samples.front().map_or(Stamp::default(), |s| s.0)
    }

    pub(super) fn latest(&self) -> Stamp {
        self.samples.back().map_or(Stamp::default(), |s| s.0)
    }

    /// All samples, oldest first.
    #[cfg(feature = "serde")]
    pub(super) fn samples(&self) -> impl Iterator<Item = (Stamp, Se3)> + '_ {
        self.samples.iter().copied()
    }

    /// The pose at `stamp`, along the geodesic between its neighbours; `None` outside of the history.
    pub(super) fn at(&self, stamp: Stamp) -> Option<Se3> {
        let next = self.samples.partition_point(|(s, _)| *s < stamp);
        let &(after, pose) = self.samples.get(next)?;
        if after == stamp {
            return Some(pose);
        }
        let &(before, from) = self.samples.get(next.checked_sub(1)?)?;
        Some(from.interpolate(&pose, (stamp - before) / (after - before)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn pose(x: f64) -> Se3 {
        Se3::from_parts(Vector3::new(x, 0.0, 0.0), crate::geometry::So3::default())
    }

    fn at(ns: i64) -> Stamp {
        Stamp::from_nanoseconds(ns)
    }

    proptest! {
        /// Whatever the order of arrival, what is kept is the newest part, each stamp once with its last value.
        #[test]
        fn order_of_arrival_does_not_matter(stamps in prop::collection::vec(0..60_i64, 1..80)) {
            let mut history = History::new(at(stamps[0]), pose(0.0), 1.0, 1000);
            let mut reference = std::collections::BTreeMap::from([(stamps[0], 0.0)]);
            for (i, ns) in stamps.iter().enumerate().skip(1) {
                let outcome = history.insert(at(*ns), pose(i as f64));
                let known = reference.insert(*ns, i as f64).is_some();
                prop_assert_eq!(outcome, if known { Insertion::Replaced } else { Insertion::Added });
            }
            let kept: Vec<_> = history.samples.iter().map(|(s, p)| (s.nanoseconds(), p.translation().x)).collect();
            prop_assert_eq!(kept, reference.into_iter().collect::<Vec<_>>());
        }

        #[test]
        fn count_and_duration_bound_it(stamps in prop::collection::vec(0..100_i64, 1..200)) {
            let mut history = History::new(at(stamps[0]), pose(0.0), 30e-9, 8);
            let capacity = history.samples.capacity();
            for ns in &stamps {
                history.insert(at(*ns), pose(0.0));
                prop_assert!(history.samples.len() <= 8 && history.latest() - history.earliest() <= 30e-9);
            }
            prop_assert_eq!(history.latest(), at(*stamps.iter().max().unwrap()));
            prop_assert_eq!(history.samples.capacity(), capacity);
        }
    }

    #[test]
    fn old_transforms_are_dropped_and_said_so() {
        let mut history = History::new(at(100), pose(0.0), 50e-9, 2);
        assert_eq!(history.insert(at(49), pose(0.0)), Insertion::TooOld);
        assert_eq!(history.insert(at(60), pose(0.0)), Insertion::Added);
        assert_eq!(history.insert(at(55), pose(0.0)), Insertion::TooOld, "full, and older than all");
        assert_eq!(history.insert(at(80), pose(0.0)), Insertion::Added);
        assert_eq!(history.earliest(), at(80));
    }
}
