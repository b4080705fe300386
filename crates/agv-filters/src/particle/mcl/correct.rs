//! What an observation does to the belief.

use super::{
    MclDiagnostics,
    belief::{Belief, Known, LastDrawn},
    filter::{Draw, Mcl},
    temper::Taken,
};
use crate::particle::{
    MotionModel, ParticleSet, ProposalContext, ResampleContext, ResamplePolicy, Resampler, SampleSize, UpdateContext,
    UpdatePolicy, WeighParticles, WeightSummary, excursion::Excursion, set::WeighedSums,
};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, UncertainPose},
    odometry::OdometryIncrement,
    roles::{LocalizationError, SkipReason, StatusParams, UpdateOutcome, UpdateReport},
    sensors::{Observation, SensorId},
};
use nalgebra::Matrix3;
use pulp::Arch;

/// What an adaptive filter does differently.
pub(in crate::particle) trait Adapt<Z: ?Sized, S: ?Sized> {
    /// The estimate that a weighed set stands for, given its moments and where it was expected.
    fn estimate(
        &mut self,
        particles: &ParticleSet,
        moments: UncertainPose<Se2>,
        expected: &UncertainPose<Se2>,
    ) -> Result<UncertainPose<Se2>, Error>;

    /// The share of the next set that is to be drawn elsewhere.
    fn fresh_share(&mut self, observation: &Z, seen: &Seen<'_>) -> f64;

    /// Poses drawn elsewhere, at most so many.
    fn propose(&mut self, observation: &Z, sensor: &mut S, context: &ProposalContext<'_>, most: usize) -> &[Se2];
}

/// What an observation says of the belief.
pub(in crate::particle) struct Seen<'a> {
    pub(in crate::particle) weights: WeightSummary,
    /// As how many independent readings the observation counts.
    pub(in crate::particle) readings: f64,
    pub(in crate::particle) explained: Option<f64>,
    pub(in crate::particle) expected: &'a UncertainPose<Se2>,
}

/// The plain filter: the mean is the estimate, and nothing is drawn elsewhere.
pub(super) struct Plain;

impl<Z: ?Sized, S: ?Sized> Adapt<Z, S> for Plain {
    fn estimate(
        &mut self,
        _: &ParticleSet,
        moments: UncertainPose<Se2>,
        _: &UncertainPose<Se2>,
    ) -> Result<UncertainPose<Se2>, Error> {
        Ok(moments)
    }

    fn fresh_share(&mut self, _: &Z, _: &Seen<'_>) -> f64 {
        0.0
    }

    fn propose(&mut self, _: &Z, _: &mut S, _: &ProposalContext<'_>, _: usize) -> &[Se2] {
        &[]
    }
}

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N>
where
    M: MotionModel<Motion = OdometryIncrement>,
{
    /// Draws the pending motion, weighs, takes the moments and resamples; the weights are as they were if the observation is
    /// skipped.
    pub(in crate::particle) fn correct<Z: Observation + ?Sized>(
        &mut self,
        observation: &Z,
        adapt: &mut impl Adapt<Z, S>,
    ) -> Result<UpdateOutcome, LocalizationError>
    where
        S: WeighParticles<Z>,
        R: Resampler,
        P: ResamplePolicy,
        U: UpdatePolicy,
        N: SampleSize,
    {
        let known = self.belief.known.ok_or(LocalizationError::NotInitialized)?;
        let here = self.belief.odom_from_base;
        let last = self.belief.applied.get(observation.kind(), observation.sensor());
        let context = last.map(|last| {
            let (distance, angle) = last.farthest();
            UpdateContext::new(observation.sensor(), last.motion_to(&here)).having_been(distance, angle)
        });
        if context.is_some_and(|context| !self.rules.update.is_due(&context)) {
            return Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion));
        }
        let weighed = self.move_and_weigh(observation);
        let (outcome, pose) = match weighed {
            Err(reason) => {
                self.move_unseeing(observation.sensor());
                (UpdateOutcome::Skipped(reason), known.pose)
            }
            Ok((whole, sums)) => {
                let Taken { weights, degrees, is_whole } = self.temper(observation, whole, &known.pose)?;
                // Of what was weighed: what follows may look at other readings.
                let readings = self.sensor.independent_readings();
                // Before resampling, which adds variance and no knowledge.
                let moments = match sums.filter(|_| is_whole) {
                    Some(sums) => sums.estimate()?,
                    None => self.belief.particles.estimate(self.par)?,
                };
                let moments = adapt.estimate(&self.belief.particles, moments, &known.pose)?;
                let moments = self.refined(observation, moments, known.pose.covariance())?;
                let explained = self.sensor.explained(observation, moments.mean());
                let stamp = known.stamp.or_else(|| observation.stamp());
                self.belief.known = Some(Known { moments, pose: moments, stamp });
                let begun = Excursion::from(here);
                *self.belief.applied.of(observation, begun) = begun;
                let seen = Seen { weights, readings, explained, expected: &known.pose };
                let share = adapt.fresh_share(observation, &seen);
                let moments = if self.resample(observation, (weights, degrees), share, adapt) {
                    // What was drawn elsewhere outweighs what was weighed: it is the belief.
                    let fresh = self.belief.particles.estimate(self.par)?;
                    let fresh = adapt.estimate(&self.belief.particles, fresh, &fresh)?;
                    self.belief.known = Some(Known { moments: fresh, pose: fresh, stamp });
                    fresh
                } else {
                    moments
                };
                (
                    UpdateOutcome::Applied(explained.map_or_else(UpdateReport::default, UpdateReport::explaining)),
                    moments,
                )
            }
        };
        self.belief.monitor.updated(&pose, &outcome);
        Ok(outcome)
    }

    /// Moves the particles by a draw of the pending motion and weighs them there; they stay where they were, with their
    /// weights, if the observation weighs nothing. The sums are those over the weighed set, where they were taken on the way.
    fn move_and_weigh<Z: ?Sized>(&mut self, observation: &Z) -> Result<(WeightSummary, Option<WeighedSums>), SkipReason>
    where
        S: WeighParticles<Z>,
    {
        let seed = self.seed_for(Draw::Motion);
        let Belief { particles, pending, step, .. } = &mut self.belief;
        let (model, motion, par) = (&self.motion, &*pending, self.par);
        let log_likelihoods = &mut self.log_likelihoods[..particles.len()];
        let moves = |chunk: usize, poses: &[Se2], moved: &mut [Se2]| match motion {
            Some(motion) => model.propagate(motion, poses, moved, &mut seed.stream(*step, chunk as u64)),
            None => moved.copy_from_slice(poses),
        };
        // Where the sensor judges pose by pose, a chunk is moved, weighed and summed up in one go: threads meet once.
        let arch = Arch::new();
        let mut sums = None;
        let judged = self.sensor.with_likelihood(observation, &mut |likelihood| {
            sums = particles.propose_weighed(log_likelihoods, par, arch, |chunk, poses, moved, logs| {
                moves(chunk, poses, moved);
                likelihood.log_likelihoods(moved, logs);
            });
        });
        let weights = if let Some(judged) = judged {
            judged?;
            sums.as_ref().and_then(|sums| particles.take_in(log_likelihoods, &sums.weights, par, arch))
        } else {
            particles.propose(par, moves);
            self.sensor.weigh(observation, particles.proposed(), log_likelihoods, par)?;
            particles.reweigh(log_likelihoods, par)
        };
        let weights = weights.ok_or(SkipReason::Unexplained)?;
        if pending.take().is_some() {
            particles.adopt();
            *step = step.wrapping_add(1);
        }
        Ok((weights, sums))
    }

    /// Moves the particles by a draw of the pending motion where it is as long as one between updates, though nothing was seen: the
    /// noise of a motion grows with its square, and one draw for all of a blind way would spread them much too far.
    fn move_unseeing(&mut self, sensor: SensorId)
    where
        U: UpdatePolicy,
    {
        let seed = self.seed_for(Draw::Motion);
        let Belief { particles, pending, step, known, .. } = &mut self.belief;
        let is_long = |motion: &mut OdometryIncrement| {
            self.rules.update.is_due(&UpdateContext::new(sensor, motion.start_from_end))
        };
        let Some(motion) = pending.take_if(is_long) else { return };
        let model = &self.motion;
        particles.propose(self.par, |chunk: usize, poses: &[Se2], moved: &mut [Se2]| {
            model.propagate(&motion, poses, moved, &mut seed.stream(*step, chunk as u64));
        });
        particles.adopt();
        *step = step.wrapping_add(1);
        if let Some(known) = known {
            known.moments = known.pose;
        }
    }

    /// The estimate at the peak of the observation's likelihood; what was `known` before keeps it there where the observation says
    /// nothing. The covariance stays that of the particles.
    fn refined<Z: ?Sized>(
        &mut self,
        observation: &Z,
        moments: UncertainPose<Se2>,
        known: &Matrix3<f64>,
    ) -> Result<UncertainPose<Se2>, Error>
    where
        S: WeighParticles<Z>,
    {
        if !(self.refine && is_narrow(&moments, self.belief.monitor.params())) {
            return Ok(moments);
        }
        let guess = UncertainPose::new(*moments.mean(), *known)?;
        match self.sensor.refine(observation, &guess) {
            Some(mean) => UncertainPose::new(mean, *moments.covariance()),
            None => Ok(moments),
        }
    }

    /// Draws a new set if the policy asks for it, or if a share of it is to be drawn elsewhere; returns whether that was most
    /// of it.
    fn resample<Z: ?Sized>(
        &mut self,
        observation: &Z,
        (weights, degrees): (WeightSummary, usize),
        share: f64,
        adapt: &mut impl Adapt<Z, S>,
    ) -> bool
    where
        R: Resampler,
        P: ResamplePolicy,
        N: SampleSize,
    {
        let seeds = [Draw::SampleSize, Draw::Resampling, Draw::Proposal].map(|draw| self.seed_for(draw));
        let [size_seed, seed, proposal_seed] = seeds;
        let Belief { particles, step, begun, drawn, diagnostics, odom_from_base, known, monitor, .. } =
            &mut self.belief;
        let estimate = known.map_or_else(Se2::identity, |known| *known.pose.mean());
        let is_narrow = known.is_some_and(|known| is_narrow(&known.pose, monitor.params()));
        drawn.updates = drawn.updates.saturating_add(1);
        let (distance, angle) = drawn.way.farthest();
        let motion = drawn.way.motion_to(odom_from_base);
        let context =
            ResampleContext::new(weights, particles.len(), drawn.updates, motion).having_been(distance, angle);
        let is_due = self.rules.resample.is_due(&context);
        // No more than a set of twice the size holds: what is not looked at need not be drawn.
        let room = particles.capacity().min(2 * particles.len());
        let most = (share * room as f64).round() as usize;
        let context = ProposalContext::new(&self.free_space, estimate, self.par, proposal_seed, *step)
            .in_belief(*begun)
            .after(diagnostics.updates, *odom_from_base)
            .of_particles(particles.len(), is_narrow);
        let proposed = if most > 0 { adapt.propose(observation, &mut self.sensor, &context, most) } else { &[] };
        // A search that finds nothing disturbs nothing.
        let resampled = is_due || !proposed.is_empty();
        let mut fresh = 0;
        if resampled {
            let stream = &mut size_seed.stream(*step, 0);
            let count = self.rules.size.sample_size_with(particles, proposed, share, stream);
            let count = count.clamp(1, particles.capacity());
            let wanted = (share * count as f64).round() as usize;
            // One at least is kept, so that there is a set to add to.
            fresh = proposed.len().min(wanted).min(count - 1);
            particles.resample(count - fresh, &self.rules.resampler, &mut seed.stream(*step, 0), self.par);
            if fresh > 0 {
                particles.extend(&proposed[..fresh]);
            }
            *drawn = LastDrawn::now(*odom_from_base);
        }
        if resampled || most > 0 {
            *step = step.wrapping_add(1);
        }
        *diagnostics =
            MclDiagnostics { weights, resampled, degrees, updates: diagnostics.updates.saturating_add(1), fresh };
        2 * fresh > particles.len()
    }
}

/// Whether a belief is as narrow as that of a vehicle that is tracked.
fn is_narrow(pose: &UncertainPose<Se2>, params: &StatusParams) -> bool {
    pose.position_deviation() < params.narrow_position && pose.rotation_deviation() < params.narrow_rotation
}
