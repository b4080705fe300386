//! How the map grows and shrinks: new landmarks, ranges that wait for theirs, and landmarks that are forgotten.

use super::{
    LandmarkKey, LandmarkReading, LandmarkSighting, LandmarkSlam, LandmarkUpdate, SightingOutcome,
    ranging::{KeptRange, Waiting},
    state::{Point, PointKind},
};
use agv_core::geometry::{LieGroup, Se2};
use nalgebra::Vector2;

impl LandmarkSlam {
    /// Adds the landmarks of sightings that are of none, and keeps ranges of those whose place is not known.
    pub(super) fn add_new(&mut self, sightings: &[LandmarkSighting], update: &mut LandmarkUpdate) {
        for (s, sighting) in sightings.iter().enumerate() {
            let is_new = match self.derived.outcomes[s] {
                SightingOutcome::Added(_) => true,
                SightingOutcome::Ambiguous => sighting.id.is_some(),
                _ => false,
            };
            if !is_new {
                continue;
            }
            self.derived.outcomes[s] = if self.state.points.len() >= self.params.most_landmarks {
                SightingOutcome::Ambiguous
            } else if let LandmarkReading::Range(range) = &sighting.reading {
                let (range, variance) = (range.mean().x, range.covariance()[(0, 0)]);
                sighting.id.map_or(SightingOutcome::Ambiguous, |id| {
                    self.wait(id, &sighting.base_from_sensor, range, variance, update)
                })
            } else {
                self.add_seen(sighting).map_or(SightingOutcome::Rejected, |key| {
                    update.added += 1;
                    SightingOutcome::Added(LandmarkKey(key))
                })
            };
        }
    }

    /// A point's key and the point, unless keys have run out.
    fn point(&mut self, place: Vector2<f64>, kind: PointKind) -> Option<Point> {
        let key = self.next;
        self.next = key.checked_add(1)?;
        Some(Point { key, place, kind })
    }

    fn is_mapped(&self, wanted: u32) -> bool {
        self.state.points.iter().any(|point| matches!(point.kind, PointKind::Landmark { id, .. } if id == Some(wanted)))
    }

    fn add_seen(&mut self, sighting: &LandmarkSighting) -> Option<u32> {
        // One that was added by this very update is not added again.
        if sighting.id.is_some_and(|id| self.is_mapped(id)) {
            return None;
        }
        let (seen, noise) = sighting.place(self.state.scale)?;
        let map_from_sensor = self.state.map_from_base.compose(&sighting.base_from_sensor);
        let kind = PointKind::Landmark { id: sighting.id, sightings: 1, misses: 0 };
        let point = self.point(map_from_sensor.act(&seen), kind)?;
        let by_scale = match sighting.reading {
            LandmarkReading::RangeBearing(_) => seen * (-1.0 / (1.0 + self.state.scale)),
            _ => Vector2::zeros(),
        };
        self.state.add_landmark(point, &sighting.base_from_sensor, &noise, &by_scale);
        // It tells more than the ranges that waited for the place.
        if let Some(slot) = self.waiting.iter().position(|waiting| Some(waiting.id) == sighting.id) {
            self.release(slot);
        }
        Some(point.key)
    }

    /// Keeps a range, and adds its landmark if that tells where it is.
    fn wait(
        &mut self,
        id: u32,
        base_from_sensor: &Se2,
        range: f64,
        variance: f64,
        update: &mut LandmarkUpdate,
    ) -> SightingOutcome {
        // Another range of this very update has settled it.
        if self.is_mapped(id) {
            return SightingOutcome::Rejected;
        }
        let place = self.state.map_from_base.compose(base_from_sensor).translation();
        let slot = self.waiting.iter().position(|waiting| waiting.id == id).unwrap_or_else(|| {
            self.waiting.push(Waiting::new(id, self.params.range_start.spacing));
            self.waiting.len() - 1
        });
        let last = self.waiting[slot].ranges.last().and_then(|kept| self.state.index_of(kept.anchor));
        let spacing = self.waiting[slot].spacing;
        if last.is_some_and(|last| (self.state.points[last].place - place).norm() < spacing) {
            return SightingOutcome::Waiting;
        }
        let Some(anchor) = self.point(place, PointKind::Anchor) else { return SightingOutcome::Ambiguous };
        self.state.add_at_base(anchor, &Vector2::zeros());
        self.waiting[slot].ranges.push(KeptRange { anchor: anchor.key, range, variance });
        if self.waiting[slot].ranges.len() >= self.params.range_start.least
            && let Some(key) = self.settle(slot)
        {
            update.added += 1;
            return SightingOutcome::Added(LandmarkKey(key));
        }
        if self.waiting[slot].ranges.len() >= self.params.range_start.most {
            self.thin(slot);
        }
        SightingOutcome::Waiting
    }

    /// Adds the landmark of ranges that wait, if its place is known; its key.
    fn settle(&mut self, slot: usize) -> Option<u32> {
        let place = self.waiting[slot].locate(&self.state, &self.params.range_start)?;
        let count = self.waiting[slot].ranges.len() as u32;
        let kind = PointKind::Landmark { id: Some(self.waiting[slot].id), sightings: count, misses: 0 };
        let point = self.point(place, kind)?;
        let farthest = self.waiting[slot].ranges.iter().map(|kept| kept.range).fold(1.0, f64::max);
        self.state.add_unknown(point, 100.0 * farthest * farthest);
        let constraints = self.waiting[slot].constraints(&self.state, self.state.points.len() - 1);
        let enough = constraints.len() >= 3;
        if !(enough && self.state.correct(&constraints, self.params.errors, &mut self.derived.scratch)) {
            self.state.remove(self.state.points.len() - 1);
            return None;
        }
        self.release(slot);
        Some(point.key)
    }

    /// Lets go of ranges that wait no longer, and of where they were taken.
    fn release(&mut self, slot: usize) {
        for kept in &self.waiting.remove(slot).ranges {
            if let Some(index) = self.state.index_of(kept.anchor) {
                self.state.remove(index);
            }
        }
    }

    /// Lets go of every other range.
    fn thin(&mut self, slot: usize) {
        let waiting = &mut self.waiting[slot];
        waiting.spacing *= 2.0;
        let mut odd = false;
        let state = &mut self.state;
        waiting.ranges.retain(|kept| {
            odd = !odd;
            if !odd && let Some(index) = state.index_of(kept.anchor) {
                state.remove(index);
            }
            odd
        });
    }

    /// Counts landmarks that ought to have been seen, and forgets those that are not believed. One that a doubtful sighting may be of
    /// is not counted.
    pub(super) fn forget_missed(&mut self, update: &mut LandmarkUpdate) {
        let Some(view) = self.params.view else { return };
        let mut index = 0;
        while index < self.state.points.len() {
            let seen = self.state.seen(&Se2::default(), index);
            let in_view = seen.norm() <= view.range && seen.y.atan2(seen.x).abs() <= view.half_angle;
            let key = LandmarkKey(self.state.points[index].key);
            let was_seen =
                self.derived.outcomes.iter().any(
                    |outcome| matches!(outcome, SightingOutcome::Matched(k) | SightingOutcome::Added(k) if *k == key),
                );
            let may_be_seen = self
                .derived
                .near
                .iter()
                .any(|&(s, k)| LandmarkKey(k) == key && self.derived.outcomes[s] == SightingOutcome::Ambiguous);
            if let PointKind::Landmark { sightings, misses, .. } = &mut self.state.points[index].kind
                && in_view
                && !(was_seen || may_be_seen)
            {
                *misses = misses.saturating_add(1);
                if *sightings < self.params.confirmations && *misses > self.params.patience {
                    self.state.remove(index);
                    update.removed += 1;
                    continue;
                }
            }
            index += 1;
        }
    }
}
