//! Starting from a swarm that the first scans have weighed.

use super::filter::{Draw, Mcl};
use crate::particle::{ImprovedSwarm, InitialPoses, ParticleSet, Systematic, WeighParticles, draw::draw_chunk};
use agv_core::{
    compute::{CHUNK, Stream},
    geometry::{Se2, UncertainPose},
    roles::{LocalizationError, SkipReason, UpdateOutcome, UpdateReport},
};

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N> {
    /// Draws all particles anew, as many as there is room for, from a swarm that is weighed by `observations`, all of them made
    /// from where the vehicle stands.
    ///
    /// Skipped if not one of them weighs anything, or if no candidate explains them; the particles are then drawn unweighed, as
    /// without observations. Allocates the candidates; O(candidates x beams).
    ///
    /// # Errors
    /// [`LocalizationError::OffMap`] if not one candidate lies in the map; candidates that are too many or not finite. The
    /// filter is as it was then.
    pub fn initialize_swarm<Z: ?Sized, Q: InitialPoses>(
        &mut self,
        swarm: &ImprovedSwarm<Q>,
        observations: &[&Z],
    ) -> Result<UpdateOutcome, LocalizationError>
    where
        S: WeighParticles<Z>,
    {
        let count = self.belief.particles.capacity();
        let (drawn, outcome) = self.swarm(swarm, observations, count)?;
        let moments = drawn.estimate(self.par)?;
        let drawn = drawn.states();
        let accepted = self.belief.particles.refill(
            count,
            self.par,
            |chunk, poses| poses.copy_from_slice(&drawn[chunk * CHUNK..][..poses.len()]),
            |_| true,
        );
        debug_assert!(accepted, "every set is taken");
        self.belief.step = self.belief.step.wrapping_add(1);
        self.belief.begin(moments);
        Ok(outcome)
    }

    /// The estimate's pose, if there is one.
    pub(in crate::particle) fn known_pose(&self) -> Option<UncertainPose<Se2>> {
        self.belief.known.map(|known| known.pose)
    }

    /// `count` poses of a swarm, and what became of the observations.
    fn swarm<Z: ?Sized, Q: InitialPoses>(
        &mut self,
        swarm: &ImprovedSwarm<Q>,
        observations: &[&Z],
        count: usize,
    ) -> Result<(ParticleSet, UpdateOutcome), LocalizationError>
    where
        S: WeighParticles<Z>,
    {
        let total = ParticleSet::check_count(count.saturating_mul(swarm.params.candidates))?;
        let mut set = ParticleSet::new(self.candidates(&swarm.poses, total)?)?;
        match self.weigh_swarm(&mut set, observations, swarm.params.effective * count as f64) {
            Ok(()) => {
                let mut stream = self.seed_for(Draw::Resampling).stream(self.belief.step, 0);
                set.resample(count, &Systematic, &mut stream, self.par);
                Ok((set, UpdateOutcome::Applied(UpdateReport::default())))
            }
            // As the distribution says: each pose of a stratified one has its own place.
            Err(reason) => {
                let set = ParticleSet::new(self.candidates(&swarm.poses, count)?)?;
                Ok((set, UpdateOutcome::Skipped(reason)))
            }
        }
    }

    /// Weighs candidates so far that `least` of them stay effective.
    fn weigh_swarm<Z: ?Sized>(
        &mut self,
        set: &mut ParticleSet,
        observations: &[&Z],
        least: f64,
    ) -> Result<(), SkipReason>
    where
        S: WeighParticles<Z>,
    {
        let (mut sum, mut one) = (vec![0.0; set.len()], vec![0.0; set.len()]);
        let mut weighed = Err(SkipReason::TooFewReadings { usable: 0, needed: 1 });
        for observation in observations {
            match self.sensor.weigh(observation, set.states(), &mut one, self.par) {
                Ok(()) => {
                    sum.iter_mut().zip(&one).for_each(|(sum, one)| *sum += one);
                    weighed = Ok(());
                }
                Err(reason) => weighed = weighed.or(Err(reason)),
            }
        }
        weighed?;
        let summary = set.reweigh(&sum, self.par).ok_or(SkipReason::Unexplained)?;
        set.temper(&mut sum, summary, least, self.par);
        Ok(())
    }

    fn candidates(&self, poses: &impl InitialPoses, count: usize) -> Result<Vec<Se2>, LocalizationError> {
        let (seed, step, space) = (self.seed_for(Draw::Initialization), self.belief.step, &self.free_space);
        let mut drawn = vec![Se2::default(); count];
        self.par.for_each_chunk(drawn.as_mut_slice(), CHUNK, |chunk, drawn: &mut [Se2]| {
            let draw = |index: usize, stream: &mut Stream| poses.draw(space, index, count, stream);
            draw_chunk(chunk, drawn, seed.stream(step, chunk as u64), draw);
        });
        let layout = space.layout();
        if drawn.iter().any(|pose| layout.cell_at(&pose.translation()).is_some()) {
            Ok(drawn)
        } else {
            let first = drawn.first().copied().unwrap_or_default();
            Err(LocalizationError::OffMap { x: first.x(), y: first.y() })
        }
    }
}
