//! What an observation does to the belief.

use super::{
    MclDiagnostics,
    belief::{Belief, Known, LastDrawn},
    filter::{Draw, Mcl},
};
use crate::particle::{
    MotionModel, ResampleContext, ResamplePolicy, Resampler, SampleSize, UpdateContext, UpdatePolicy, WeighParticles,
    WeightSummary,
};
use agv_core::{
    Error,
    geometry::LieGroup,
    odometry::OdometryIncrement,
    roles::{SkipReason, UpdateOutcome, UpdateReport},
    sensors::Observation,
};

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N>
where
    M: MotionModel<Motion = OdometryIncrement>,
{
    /// Draws the pending motion, weighs, takes the moments and resamples; but for the status, the belief is as it was if the
    /// observation is skipped.
    pub(super) fn correct<Z: Observation + ?Sized>(
        &mut self,
        observation: &Z,
        known: &Known,
    ) -> Result<UpdateOutcome, Error>
    where
        S: WeighParticles<Z>,
        R: Resampler,
        P: ResamplePolicy,
        U: UpdatePolicy,
        N: SampleSize,
    {
        let motion = self.belief.streams.motion_since(observation, &self.belief.odom_from_base);
        let context = motion.map(|motion| UpdateContext::new(observation.sensor(), motion));
        if context.is_some_and(|context| !self.rules.update.is_due(&context)) {
            return Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion));
        }
        let weighed = self.move_and_weigh(observation);
        let (outcome, pose) = match weighed {
            Err(reason) => (UpdateOutcome::Skipped(reason), known.pose),
            Ok(weights) => {
                let (weights, degrees) = self.temper(observation, weights)?;
                // Before resampling, which adds variance and no knowledge.
                let moments = self.belief.particles.estimate(self.par)?;
                let explained = self.sensor.explained(observation, moments.mean());
                let stamp = known.stamp.or_else(|| observation.stamp());
                self.belief.known = Some(Known { moments, pose: moments, stamp });
                self.belief.streams.applied(observation, &self.belief.odom_from_base);
                self.resample(weights, degrees);
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
    /// weights, if the observation weighs nothing.
    fn move_and_weigh<Z: ?Sized>(&mut self, observation: &Z) -> Result<WeightSummary, SkipReason>
    where
        S: WeighParticles<Z>,
    {
        let seed = self.seed_for(Draw::Motion);
        let Belief { particles, pending, step, .. } = &mut self.belief;
        if let Some(motion) = pending {
            let sample = self.motion.condition(motion);
            particles.propose(self.par, |chunk, poses, moved| {
                let mut stream = seed.stream(*step, chunk as u64);
                for (moved, pose) in moved.iter_mut().zip(poses) {
                    *moved = sample(pose, &mut stream);
                }
            });
        }
        let poses = if pending.is_some() { particles.proposed() } else { particles.states() };
        let log_likelihoods = &mut self.log_likelihoods[..poses.len()];
        self.sensor.weigh(observation, poses, log_likelihoods, self.par)?;
        let weights = particles.reweigh(log_likelihoods, self.par).ok_or(SkipReason::Unexplained)?;
        if pending.take().is_some() {
            particles.adopt();
            *step += 1;
        }
        Ok(weights)
    }

    /// Draws a new set if the policy asks for it.
    fn resample(&mut self, weights: WeightSummary, degrees: usize)
    where
        R: Resampler,
        P: ResamplePolicy,
        N: SampleSize,
    {
        let [size_seed, seed] = [Draw::SampleSize, Draw::Resampling].map(|draw| self.seed_for(draw));
        let Belief { particles, step, drawn, diagnostics, odom_from_base, .. } = &mut self.belief;
        drawn.updates += 1;
        let motion = drawn.odom_from_base.between(odom_from_base);
        let context = ResampleContext::new(weights, particles.len(), drawn.updates, motion);
        let resampled = self.rules.resample.is_due(&context);
        if resampled {
            let count = self.rules.size.sample_size(particles, &mut size_seed.stream(*step, 0));
            particles.resample(count, &self.rules.resampler, &mut seed.stream(*step, 0), self.par);
            *step += 1;
            *drawn = LastDrawn { updates: 0, odom_from_base: *odom_from_base };
        }
        *diagnostics = MclDiagnostics { weights, resampled, degrees, updates: diagnostics.updates + 1 };
    }
}
