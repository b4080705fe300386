//! The filter: motions and sightings in, pose and landmarks out.

use super::{
    Association, LandmarkKey, LandmarkReading, LandmarkSighting, LandmarkSlamParams, LandmarkUpdate, MappedLandmark,
    SightingOutcome,
    association::{Associator, Candidate, distance},
    ranging::{KeptRange, Waiting},
    reading::Expected,
    state::{Constraint, CorrectionScratch, Point, PointKind, SlamState},
};
use crate::kalman::Gate;
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose, UncertainVector},
    odometry::OdometryIncrement,
};
use nalgebra::{Matrix2, Matrix3, Vector2};

/// Sightings that are taken in at once; more are taken one group after the other, each at the estimate that the last one left.
const GROUP: usize = 16;

/// Longest motion and farthest sighting, in metres: beyond, the numbers have no meaning.
const LARGEST: f64 = 1e6;

/// SLAM with landmarks by an extended Kalman filter; see the [module](super).
///
/// The map begins where the vehicle starts, for certain. A motion costs O(1), an update of `m` sightings among `n` landmarks O(m n²), and
/// nothing allocates but where the map grows. Deterministic. A state that was stored continues with the same bits (feature `serde`).
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2};
/// use agv_core::nalgebra::{Matrix3, Vector2};
/// use agv_core::{odometry::OdometryIncrement, time::Stamp};
/// use agv_filters::slam::landmark::{LandmarkReading, LandmarkSighting, LandmarkSlam, LandmarkSlamParams};
///
/// // Around a circle among four trees that look alike, by odometry that turns too little.
/// let trees = [Vector2::new(6.0, 0.0), Vector2::new(-1.0, 8.0), Vector2::new(-7.0, 3.0), Vector2::new(2.0, 3.0)];
/// let mut slam = LandmarkSlam::new(LandmarkSlamParams::default())?;
/// let (step, read) = (Se2::new(0.2, 0.0, 0.05), Se2::new(0.2, 0.0, 0.049));
/// let mut truth = Se2::default();
/// for _ in 0..250 {
///     let seen: Vec<_> = trees
///         .iter()
///         .map(|tree| truth.inverse().act(tree))
///         .map(|q| LandmarkReading::range_bearing(q.norm(), q.y.atan2(q.x), [0.05, 0.01]))
///         .map(|reading| Ok(LandmarkSighting::new(None, reading?)))
///         .collect::<Result<_, agv_core::Error>>()?;
///     slam.update(&seen)?;
///     let now = Stamp::default();
///     slam.predict(&OdometryIncrement { start: now, end: now, start_from_end: read, covariance: Matrix3::zeros() })?;
///     truth = truth * step;
/// }
/// assert_eq!(slam.landmarks().count(), 4);
/// assert!(slam.map_from_base().minus(&truth).norm() < 0.05);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::checkpoint::RawLandmarkSlam")
)]
pub struct LandmarkSlam {
    pub(super) params: LandmarkSlamParams,
    pub(super) state: SlamState,
    pub(super) waiting: Vec<Waiting>,
    /// Key of the next point.
    pub(super) next: u32,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(super) derived: Derived,
}

/// What follows from the parameters, and memory.
#[derive(Debug, Clone)]
pub(super) struct Derived {
    known_gate: Gate,
    novelty_gate: Gate,
    associator: Associator,
    scratch: CorrectionScratch,
    outcomes: Vec<SightingOutcome>,
    pairs: Vec<usize>,
    /// Sightings that found a landmark, with its key.
    matched: Vec<(usize, u32)>,
    constraints: Vec<Constraint>,
}

/// Probability with which a sighting passes whose landmark is known.
const KNOWN_PROBABILITY: f64 = 0.9999;

impl LandmarkSlam {
    /// A map without landmarks, with the vehicle at its origin.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: LandmarkSlamParams) -> Result<Self, Error> {
        params.validate()?;
        let derived = Derived {
            known_gate: Gate::at_probability(KNOWN_PROBABILITY)?,
            novelty_gate: Gate::at_probability(params.novelty_probability)?,
            associator: Associator::new(params.gate_probability)?,
            scratch: CorrectionScratch::default(),
            outcomes: Vec::new(),
            pairs: Vec::new(),
            matched: Vec::new(),
            constraints: Vec::new(),
        };
        Ok(Self { params, state: SlamState::new(params.range_scale_sigma), waiting: Vec::new(), next: 0, derived })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &LandmarkSlamParams {
        &self.params
    }

    /// Where the vehicle is.
    pub const fn map_from_base(&self) -> Se2 {
        self.state.map_from_base
    }

    /// Where the vehicle is, with its covariance.
    ///
    /// # Errors
    /// [`Error::NotCovariance`] or [`Error::NotFinite`] if the filter has broken down.
    pub fn estimate(&self) -> Result<UncertainPose<Se2>, Error> {
        UncertainPose::new(self.state.map_from_base, self.state.pose_covariance())
    }

    /// Share by which ranges are too long, as learnt, and its standard deviation.
    pub fn range_scale(&self) -> (f64, f64) {
        let variance = self.state.covariance.get(super::state::SCALE, super::state::SCALE);
        (self.state.scale, variance.sqrt())
    }

    /// The landmarks, in the order in which they were found.
    pub fn landmarks(&self) -> impl Iterator<Item = MappedLandmark> + '_ {
        let mapped = |(index, point): (usize, &Point)| {
            let PointKind::Landmark { id, sightings, .. } = point.kind else { return None };
            let place = UncertainVector::new(point.place, self.state.point_covariance(index)).ok()?;
            let confirmed = sightings >= self.params.confirmations;
            Some(MappedLandmark { key: LandmarkKey(point.key), id, place, sightings, confirmed })
        };
        self.state.points.iter().enumerate().filter_map(mapped)
    }

    /// What became of each sighting of the last update.
    pub fn outcomes(&self) -> &[SightingOutcome] {
        &self.derived.outcomes
    }

    /// Moves the vehicle by what odometry says. Its covariance is that of the increment, or by [`WayNoise`](super::WayNoise) if that is zero.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::OutOfRange`] for a motion, [`Error::NotCovariance`] for its covariance; nothing changes then.
    pub fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), Error> {
        let motion = &odometry.start_from_end;
        if !odometry.is_finite() {
            return Err(Error::NotFinite { name: "motion", value: f64::NAN });
        }
        check::in_range("motion", motion.translation().norm(), 0.0, LARGEST)?;
        check::covariance("covariance of the motion", &odometry.covariance)?;
        let stated = odometry.covariance != Matrix3::zeros();
        let covariance = if stated { odometry.covariance } else { self.params.way_noise.covariance(motion) };
        self.state.drive(motion, &covariance);
        Ok(())
    }

    /// Takes in all that was seen at one time, perhaps nothing.
    ///
    /// # Errors
    /// A sighting that cannot be one: a range below zero or absurdly far, a covariance that is not positive definite, a mount that is not
    /// finite. Nothing changes then.
    pub fn update(&mut self, sightings: &[LandmarkSighting]) -> Result<LandmarkUpdate, Error> {
        for sighting in sightings {
            sighting.validate()?;
            if let Some((place, _)) = sighting.place(0.0) {
                check::in_range("distance of a sighting", place.norm(), 0.0, LARGEST)?;
            }
        }
        self.state.flush(&mut self.derived.scratch);
        self.derived.outcomes.clear();
        self.derived.outcomes.resize(sightings.len(), SightingOutcome::Ambiguous);
        self.derived.matched.clear();
        self.find_known(sightings);
        self.find_unknown(sightings);
        let mut update = LandmarkUpdate::default();
        self.take_in(sightings, &mut update);
        self.add_new(sightings, &mut update);
        self.forget_missed(&mut update);
        update.left_out = self.derived.outcomes.iter().filter(|outcome| left_out(outcome)).count();
        Ok(update)
    }

    /// Expectation of a sighting of the point at an index.
    fn expected(&self, sighting: &LandmarkSighting, index: usize) -> Option<(Expected, Constraint)> {
        let seen = self.state.seen(&sighting.base_from_sensor, index);
        let expected = sighting.expect(&seen, self.state.scale)?;
        let constraint = self.state.constraint(&sighting.base_from_sensor, index, &expected);
        Some((expected, constraint))
    }

    /// Sightings that know their landmark.
    fn find_known(&mut self, sightings: &[LandmarkSighting]) {
        for (s, sighting) in sightings.iter().enumerate() {
            let Some(wanted) = sighting.id else { continue };
            let is_it = |point: &&Point| matches!(point.kind, PointKind::Landmark { id, .. } if id == Some(wanted));
            if let Some(point) = self.state.points.iter().find(is_it) {
                // One that is taken in twice in one update is so once by its own right.
                self.derived.matched.push((s, point.key));
                self.derived.outcomes[s] = SightingOutcome::Matched(LandmarkKey(point.key));
            }
        }
    }

    /// Sightings that do not; those that pass no gate are of new landmarks.
    fn find_unknown(&mut self, sightings: &[LandmarkSighting]) {
        self.derived.associator.candidates.clear();
        for (s, sighting) in sightings.iter().enumerate().filter(|(_, sighting)| sighting.id.is_none()) {
            let first = self.derived.associator.candidates.len();
            let mut near = sighting.place(0.0).is_none();
            let place = sighting.place(self.state.scale);
            for index in 0..self.state.points.len() {
                if !matches!(self.state.points[index].kind, PointKind::Landmark { id: None, .. })
                    || place.is_some_and(|place| self.is_far(sighting, index, &place))
                {
                    continue;
                }
                let Some((_, constraint)) = self.expected(sighting, index) else { continue };
                let covariance = self.state.innovation(&constraint);
                let Some((square, cost)) = distance(&constraint.residual, &covariance, constraint.rows) else {
                    continue;
                };
                near |= square <= self.derived.novelty_gate.limit(constraint.rows);
                if square <= self.derived.associator.limit(constraint.rows) {
                    let candidate = Candidate { sighting: s, index, constraint, cost };
                    self.derived.associator.candidates.push(candidate);
                }
            }
            self.derived.associator.candidates[first..].sort_by(|a, b| a.cost.total_cmp(&b.cost));
            if !near {
                // Marked for `add_new`.
                self.derived.outcomes[s] = SightingOutcome::Added(LandmarkKey(u32::MAX));
            }
        }
        let Derived { associator, pairs, matched, outcomes, .. } = &mut self.derived;
        match self.params.association {
            Association::Nearest => associator.nearest(pairs),
            Association::Joint => {
                associator.joint(&self.state, self.params.joint_work, pairs);
            }
        }
        for &pair in pairs.iter() {
            let candidate = &associator.candidates[pair];
            let key = self.state.points[candidate.index].key;
            matched.push((candidate.sighting, key));
            outcomes[candidate.sighting] = SightingOutcome::Matched(LandmarkKey(key));
        }
        matched.sort_unstable();
    }

    /// Whether a point is beyond every gate of a place that was seen: a bound that costs less than the innovation's covariance.
    fn is_far(&self, sighting: &LandmarkSighting, index: usize, (place, noise): &(Vector2<f64>, Matrix2<f64>)) -> bool {
        let row = super::state::row_of(index);
        let p = &self.state.covariance;
        let relative = |i: usize| p.get(row + i, row + i) - 2.0 * p.get(row + i, i) + p.get(i, i);
        let scale = p.get(super::state::SCALE, super::state::SCALE);
        let off = (self.state.seen(&sighting.base_from_sensor, index) - place).norm_squared();
        // Twice, since directions are not linear.
        let spread = relative(0) + relative(1) + noise.trace() + 4.0 * scale * place.norm_squared();
        off > 2.0 * self.derived.novelty_gate.limit(2) * spread.max(0.0)
    }

    /// Corrects by the sightings that found their landmark.
    fn take_in(&mut self, sightings: &[LandmarkSighting], update: &mut LandmarkUpdate) {
        let matched = std::mem::take(&mut self.derived.matched);
        for group in matched.chunks(GROUP) {
            self.derived.constraints.clear();
            for &(s, key) in group {
                let constraint = self.state.index_of(key).and_then(|index| {
                    let (_, constraint) = self.expected(&sightings[s], index)?;
                    let covariance = self.state.innovation(&constraint);
                    let (square, _) = distance(&constraint.residual, &covariance, constraint.rows)?;
                    let fits = square <= self.derived.known_gate.limit(constraint.rows);
                    (fits || sightings[s].id.is_none()).then_some(constraint)
                });
                match constraint {
                    Some(constraint) => self.derived.constraints.push(constraint),
                    None => self.derived.outcomes[s] = SightingOutcome::Rejected,
                }
            }
            let Derived { constraints, scratch, outcomes, .. } = &mut self.derived;
            if self.state.correct(constraints, self.params.errors, scratch) {
                update.matched += constraints.len();
                update.innovation_degrees += constraints.iter().map(|c| c.rows).sum::<usize>();
                update.innovation_square += scratch.square();
                update.log_likelihood += scratch.log_likelihood();
            } else {
                group.iter().for_each(|&(s, _)| outcomes[s] = SightingOutcome::Rejected);
            }
        }
        for &(s, key) in &matched {
            if let SightingOutcome::Matched(_) = self.derived.outcomes[s]
                && let Some(index) = self.state.index_of(key)
                && let PointKind::Landmark { sightings, misses, .. } = &mut self.state.points[index].kind
            {
                (*sightings, *misses) = (sightings.saturating_add(1), 0);
            }
        }
        self.derived.matched = matched;
    }

    /// Adds the landmarks of sightings that are of none, and keeps ranges of those whose place is not known.
    fn add_new(&mut self, sightings: &[LandmarkSighting], update: &mut LandmarkUpdate) {
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

    fn add_seen(&mut self, sighting: &LandmarkSighting) -> Option<u32> {
        // One that was added by this very update is not added again.
        let twin =
            |point: &&Point| matches!(point.kind, PointKind::Landmark { id: Some(id), .. } if sighting.id == Some(id));
        if self.state.points.iter().any(|point| twin(&point)) {
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
        let waiting = self.waiting.remove(slot);
        for kept in &waiting.ranges {
            if let Some(index) = self.state.index_of(kept.anchor) {
                self.state.remove(index);
            }
        }
        Some(point.key)
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

    /// Counts landmarks that ought to have been seen, and forgets those that are not believed.
    fn forget_missed(&mut self, update: &mut LandmarkUpdate) {
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
            if let PointKind::Landmark { sightings, misses, .. } = &mut self.state.points[index].kind
                && in_view
                && !was_seen
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

const fn left_out(outcome: &SightingOutcome) -> bool {
    matches!(outcome, SightingOutcome::Rejected | SightingOutcome::Ambiguous)
}
