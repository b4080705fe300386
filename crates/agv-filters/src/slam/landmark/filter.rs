//! The filter: motions and sightings in, pose and landmarks out.

use super::{
    Association, LandmarkKey, LandmarkSighting, LandmarkSlamParams, LandmarkUpdate, MappedLandmark, SightingOutcome,
    association::{Associator, Candidate, distance},
    correction::CorrectionScratch,
    ranging::Waiting,
    reading::{Expected, LARGEST},
    state::{Constraint, Point, PointKind, SlamState},
};
use crate::kalman::Gate;
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose, UncertainVector},
    odometry::OdometryIncrement,
};
use nalgebra::{Matrix2, Matrix3, Vector2};

/// Sightings that are taken in at once; more are taken one group after the other, each at the estimate that the last one left.
const GROUP: usize = 16;

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
    pub(super) known_gate: Gate,
    pub(super) novelty_gate: Gate,
    pub(super) associator: Associator,
    pub(super) scratch: CorrectionScratch,
    pub(super) outcomes: Vec<SightingOutcome>,
    pub(super) pairs: Vec<usize>,
    /// Sightings that found a landmark, with its key.
    pub(super) matched: Vec<(usize, u32)>,
    pub(super) constraints: Vec<Constraint>,
    /// Sightings without a name, each with the key of every landmark that it is not surely not of.
    pub(super) near: Vec<(usize, u32)>,
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
            near: Vec::new(),
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
        let covariance = self.covariance_of(odometry)?;
        self.state.drive(&odometry.start_from_end, &covariance);
        Ok(())
    }

    /// Covariance of a motion, if it can be one.
    pub(super) fn covariance_of(&self, odometry: &OdometryIncrement) -> Result<Matrix3<f64>, Error> {
        let motion = &odometry.start_from_end;
        if !odometry.is_finite() {
            return Err(Error::NotFinite { name: "motion", value: f64::NAN });
        }
        check::in_range("motion", motion.translation().norm(), 0.0, LARGEST)?;
        check::covariance("covariance of the motion", &odometry.covariance)?;
        let stated = odometry.covariance != Matrix3::zeros();
        let covariance = if stated { odometry.covariance } else { self.params.way_noise.covariance(motion) };
        check::in_range("variance of the motion", covariance.trace(), 0.0, LARGEST * LARGEST)?;
        Ok(covariance)
    }

    /// Takes in all that was seen at one time, perhaps nothing. Two sightings without names are of two landmarks: what several sensors saw
    /// of the same ones goes into an update each.
    ///
    /// # Errors
    /// A sighting that cannot be one: a range below zero or absurdly far, a covariance that is not positive definite or absurdly large, a
    /// mount that is not finite. Nothing changes then.
    pub fn update(&mut self, sightings: &[LandmarkSighting]) -> Result<LandmarkUpdate, Error> {
        for sighting in sightings {
            sighting.validate()?;
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
        update.left_out = self.derived.outcomes.iter().filter(|outcome| left_out(**outcome)).count();
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
        self.derived.near.clear();
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
                if square <= self.derived.novelty_gate.limit(constraint.rows) {
                    near = true;
                    self.derived.near.push((s, self.state.points[index].key));
                }
                if square <= self.derived.associator.limit(constraint.rows) {
                    let candidate = Candidate { sighting: s, index, constraint, cost };
                    self.derived.associator.candidates.push(candidate);
                }
            }
            self.derived.associator.candidates[first..]
                .sort_unstable_by(|a, b| a.cost.total_cmp(&b.cost).then(a.index.cmp(&b.index)));
            if !near {
                // Marked for `add_new`.
                self.derived.outcomes[s] = SightingOutcome::Added(LandmarkKey(u32::MAX));
            }
        }
        let Derived { associator, pairs, matched, outcomes, .. } = &mut self.derived;
        match self.params.association {
            Association::Nearest => associator.nearest(pairs),
            Association::Joint => associator.joint(&self.state, self.params.joint_work, self.params.lead, pairs),
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
                for &(s, _) in group {
                    outcomes[s] = SightingOutcome::Rejected;
                }
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
}

const fn left_out(outcome: SightingOutcome) -> bool {
    matches!(outcome, SightingOutcome::Rejected | SightingOutcome::Ambiguous)
}
