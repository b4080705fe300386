//! What motions and scans make of the particles.

use super::super::{
    beams::{Beams, FAR, FARTHEST},
    insert::{Scratch, insert},
    map::{TileMap, TileRect},
    proposal::{Moment, Motion, Proposed, propose},
};
use super::{PATIENCE, Rbpf, RbpfUpdate};
use crate::particle::{MotionModel, ResampleContext, ResamplePolicy, Systematic, WeightSummary};
use agv_core::{
    Error, check,
    compute::CHUNK,
    geometry::{LieGroup, Se2},
    odometry::OdometryIncrement,
    roles::SkipReason,
    sensors::LaserScan,
    time::Stamp,
};
use nalgebra::Matrix3;

/// Longest run of a single odometry increment, in metres: beyond, the numbers of a map have no meaning.
const LONGEST_RUN: f64 = 1e6;

impl<M: MotionModel<Motion = OdometryIncrement>> Rbpf<M> {
    /// The vehicle has moved.
    ///
    /// # Errors
    /// A motion that is not finite or of more than 1000 km, or a covariance that is none.
    pub fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), Error> {
        let motion = odometry.start_from_end;
        check::all_finite("odometry", &[motion.x(), motion.y(), motion.yaw()])?;
        check::in_range("odometry run", motion.translation().norm(), 0.0, LONGEST_RUN)?;
        check::covariance("odometry covariance", &odometry.covariance)?;
        let belief = &mut self.belief;
        belief.scans_without = 0;
        if belief.steps.is_empty() {
            // Before the first scan there is nothing that the vehicle moves in.
            return Ok(());
        }
        // What the scans have made of the motion so far.
        let walked = (belief.walked != Se2::identity()).then(|| standing(odometry.start, belief.walked));
        belief.pending = Some(belief.pending.or(walked).map_or(*odometry, |earlier| earlier.compose(odometry)));
        Ok(())
    }

    /// A scan has come: particles move to where it fits their maps, are weighed by how well, and drawn anew where the weights have
    /// become uneven; then the scan goes into every map.
    ///
    /// Not taken in, but remembered for the [`trajectory`](Self::trajectory), if the vehicle has moved too little, or if too few
    /// beams say anything. O(particles × beams).
    ///
    /// # Errors
    /// [`Error::TooMany`] or [`Error::OutOfRange`] where a map would become absurdly wide.
    pub fn update(&mut self, scan: &LaserScan) -> Result<RbpfUpdate, Error> {
        self.beams.read(scan, &self.model, self.params.matching.max_beams);
        let (usable, needed) = (self.beams.hits(), self.params.matching.min_beams);
        if usable < needed {
            // Nothing says more than what is expected.
            let moved = self.expected(scan.stamp());
            self.belief.walk(&moved);
            return Ok(self.skipped(scan, SkipReason::TooFewReadings { usable, needed }));
        }
        if self.belief.steps.is_empty() {
            return self.begin(scan);
        }
        let moved = self.motion_before(scan)?;
        if !self.params.update.is_reached(moved.since.translation().norm(), moved.since.yaw().abs()) {
            self.belief.walk(&moved);
            return Ok(self.skipped(scan, SkipReason::LittleMotion));
        }
        self.propose_all(&moved)?;
        Ok(self.take_in(scan, &moved))
    }

    /// How the vehicle should have moved since the last scan that was taken in, before that is matched.
    fn expected(&self, stamp: Stamp) -> Moved {
        let belief = &self.belief;
        if belief.has_odometry() || self.scan_odometry.is_none() {
            let since = belief.since();
            // What comes between two scans without odometry is told by the next one.
            let drift = if belief.scans_without == 0 { belief.walked.between(&since) } else { belief.drift };
            return Moved { since, motion: belief.pending.unwrap_or_else(|| standing(stamp, since)), drift };
        }
        // Without wheels the vehicle is taken to go on as it did, since they were there.
        let steps = if belief.scans_without == PATIENCE { PATIENCE } else { 1 };
        let since = (0..steps).fold(belief.walked, |pose, _| pose * belief.drift);
        Moved { since, motion: standing(stamp, since), drift: belief.drift }
    }

    /// How the vehicle has moved since the last scan that was taken in.
    fn motion_before(&mut self, scan: &LaserScan) -> Result<Moved, Error> {
        let mut moved = self.expected(scan.stamp());
        let belief = &self.belief;
        let Some(matching) = &mut self.scan_odometry else { return Ok(moved) };
        if belief.has_odometry() {
            let is_due = self.params.update.is_reached(moved.since.translation().norm(), moved.since.yaw().abs());
            if is_due && let Some(by_wheels) = Motion::new(moved.since, &self.motion.covariance(&moved.motion)) {
                let found = matching.motion(scan, &moved.since, &by_wheels.information)?;
                moved.motion.start_from_end = found.unwrap_or(moved.since);
            }
        } else {
            let window = self.params.scan_odometry.unwrap_or_default().window;
            let loose = [window.distance, window.distance, window.angle].map(|sigma| sigma.max(1e-3).powi(-2));
            let found = matching.motion(scan, &moved.since, &Matrix3::from_diagonal(&loose.into()))?;
            let since = found.unwrap_or(moved.since);
            moved.drift = match found {
                Some(found) if belief.scans_without != PATIENCE => belief.walked.between(&found),
                Some(_) => moved.drift,
                None => Se2::identity(),
            };
            (moved.since, moved.motion.start_from_end) = (since, since);
        }
        Ok(moved)
    }

    /// Fills `proposed` and `log_weights`, and makes sure that all maps have room for the scan.
    fn propose_all(&mut self, moved: &Moved) -> Result<(), Error> {
        let Self { motion: model, params, seed, par, belief, beams, proposed, log_weights, scratch, .. } = self;
        let covariance = model.covariance(&moved.motion);
        let refused = Error::NotCovariance { name: "covariance of the motion", pivot: covariance.diagonal().min() };
        let motion = Motion::new(moved.motion.start_from_end, &covariance).ok_or(refused)?;
        let sample = model.condition(&moved.motion);
        let (step, beams) = (belief.steps.len() as u64, &*beams);
        let moment = Moment { motion: &motion, beams, params: &params.matching };
        let data = (&mut proposed[..], &mut scratch[..], belief.particles.states(), &belief.maps[..]);
        par.for_each_chunk(data, 1, |index, (proposed, scratch, poses, maps): Seats<'_>| {
            let mut stream = seed.stream(step, index as u64);
            for ((proposed, scratch), (pose, map)) in proposed.iter_mut().zip(scratch).zip(poses.iter().zip(maps)) {
                *proposed = propose(map, pose, &moment, &sample, &mut stream, &mut scratch.view);
            }
        });
        for (proposed, map) in proposed.iter().zip(&belief.maps) {
            check_room(map, beams, &proposed.pose)?;
        }
        log_weights.clear();
        log_weights.extend(proposed.iter().map(|proposed| proposed.log_weight));
        Ok(())
    }

    /// Particles become what was proposed, and get to know the scan.
    fn take_in(&mut self, scan: &LaserScan, moved: &Moved) -> RbpfUpdate {
        let Self { params, seed, par, belief, beams, proposed, log_weights, scratch, spare, .. } = self;
        let Some(weights) = belief.particles.reweigh(log_weights, *par) else {
            belief.walk(moved);
            return self.skipped(scan, SkipReason::Unexplained);
        };
        belief.particles.propose(*par, |chunk, _, states| {
            let from = chunk * CHUNK;
            states.iter_mut().zip(&proposed[from..]).for_each(|(state, proposed)| *state = proposed.pose);
        });
        belief.particles.adopt();
        let poses = belief.particles.states();
        belief.tree.extend(poses);
        belief.scores.iter_mut().zip(&*log_weights).for_each(|(score, log)| *score += log);
        let (count, beams) = (poses.len(), &*beams);
        let data = (&mut belief.maps[..], &mut scratch[..], poses);
        par.for_each_chunk(data, 1, |_, (maps, scratch, poses): (&mut [TileMap], &mut [Scratch], &[Se2])| {
            for ((map, scratch), pose) in maps.iter_mut().zip(scratch).zip(poses) {
                insert(map, pose, beams, scratch);
            }
        });
        let step = belief.steps.len() as u64;
        belief.steps.push(moved.since);
        (belief.pending, belief.walked, belief.drift) = (None, Se2::identity(), moved.drift);
        belief.note(scan.stamp(), Se2::identity());
        belief.since_resampling = belief.since_resampling.saturating_add(1);
        belief.weights = weights;
        let context = ResampleContext::new(weights, count, belief.since_resampling, moved.since);
        let resampled = params.resample.is_due(&context);
        if resampled {
            let mut stream = seed.derive(RESAMPLING).stream(step, 0);
            let ancestors = belief.particles.resample(count, &Systematic, &mut stream, *par);
            let (maps, scores) = spare;
            maps.extend(ancestors.iter().map(|&a| belief.maps[a as usize].clone()));
            scores.extend(ancestors.iter().map(|&a| belief.scores[a as usize]));
            std::mem::swap(maps, &mut belief.maps);
            std::mem::swap(scores, &mut belief.scores);
            // Maps that nobody comes of are gone.
            maps.clear();
            scores.clear();
            belief.tree.resample(ancestors);
            belief.since_resampling = 0;
            belief.weights = WeightSummary::uniform(count);
        }
        let update = RbpfUpdate {
            skipped: None,
            weights,
            resampled,
            matched: proposed.iter().filter(|proposed| proposed.matched).count(),
            explained: proposed.iter().map(|proposed| proposed.explained).sum::<f64>() / count as f64,
        };
        if let Some(matching) = &mut self.scan_odometry {
            matching.take_in(scan, &moved.motion.start_from_end);
        }
        update
    }

    /// The first scan makes the map.
    fn begin(&mut self, scan: &LaserScan) -> Result<RbpfUpdate, Error> {
        let Self { params, belief, beams, scratch, .. } = self;
        let (start, mut map) = (belief.start, TileMap::new(params.resolution));
        check_room(&map, beams, &start)?;
        // There is at least one particle.
        insert(&mut map, &start, beams, &mut scratch[0]);
        belief.maps.fill(map);
        belief.tree.begin(start, params.particles);
        belief.steps.push(Se2::identity());
        belief.note(scan.stamp(), Se2::identity());
        if let Some(matching) = &mut self.scan_odometry {
            matching.take_in(scan, &Se2::identity());
        }
        let weights = WeightSummary::uniform(params.particles);
        Ok(RbpfUpdate { skipped: None, weights, resampled: false, matched: params.particles, explained: 1.0 })
    }

    fn skipped(&mut self, scan: &LaserScan, reason: SkipReason) -> RbpfUpdate {
        let belief = &mut self.belief;
        if !belief.steps.is_empty() {
            belief.note(scan.stamp(), belief.since());
        }
        let weights = belief.weights;
        RbpfUpdate { skipped: Some(reason), weights, resampled: false, matched: 0, explained: 0.0 }
    }
}

/// What proposals are made of, particle by particle.
type Seats<'a> = (&'a mut [Proposed], &'a mut [Scratch], &'a [Se2], &'a [TileMap]);

/// Part of the seed for the draws of new sets.
const RESAMPLING: u64 = 1;

/// A motion that nothing but scans speak of.
fn standing(stamp: Stamp, motion: Se2) -> OdometryIncrement {
    OdometryIncrement { start: stamp, end: stamp, start_from_end: motion, covariance: Matrix3::zeros() }
}

/// A motion since the last scan that was taken in.
pub(super) struct Moved {
    /// As the odometry has it; without one, as the scans have it.
    pub(super) since: Se2,
    /// The same, made better by the scans.
    motion: OdometryIncrement,
    /// The motion since the last scan, as far as that is known.
    pub(super) drift: Se2,
}

/// Whether a map has room for a scan taken at a pose.
fn check_room(map: &TileMap, beams: &Beams, pose: &Se2) -> Result<(), Error> {
    const MARGIN: i32 = 1;
    let reach = beams.reach / map.resolution() + f64::from(MARGIN) + 1.0;
    check::in_range("reach of a scan (cells)", reach, 0.0, FARTHEST)?;
    let value = pose.translation().amax() / map.resolution() + reach;
    let far = Error::OutOfRange { name: "distance of a scan (cells)", value, min: 0.0, max: FAR };
    let (low, high) = beams.cells_from(pose, map.resolution(), MARGIN).ok_or(far)?;
    map.check_room(&TileRect::of_cells(low, high))
}
