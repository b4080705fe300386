//! The roles that the filter plays.

use super::{
    correct::Plain,
    filter::{Draw, Mcl},
};
use crate::particle::{
    MotionModel, ResamplePolicy, Resampler, SampleSize, UpdatePolicy, WeighParticles, draw::draw_chunk,
    gaussian::PoseGaussian,
};
use agv_core::{
    Error, check,
    compute::Stream,
    geometry::{Se2, UncertainPose},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, UpdateOutcome},
    sensors::Observation,
};

/// Longest run of a single odometry increment, in metres: beyond, the numbers of a map have no meaning.
const LONGEST_RUN: f64 = 1e6;

impl<M, S, R, P, U, N> Localizer for Mcl<M, S, R, P, U, N>
where
    M: MotionModel<Motion = OdometryIncrement>,
{
    type Pose = Se2;

    /// Draws all particles anew, as many as there is room for: around a pose, or evenly over free space and heading
    /// ([`FreeSpace::sample_stratum`](crate::particle::FreeSpace::sample_stratum)).
    ///
    /// # Errors
    /// [`LocalizationError::OffMap`] if not one particle lies in the map; a variance above (1000 km)².
    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        let room = self.belief.particles.capacity();
        self.initialize_with(belief, room)
    }

    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        let belief = &mut self.belief;
        let known = belief.known.as_mut().ok_or(LocalizationError::NotInitialized)?;
        let motion = odometry.start_from_end;
        check::all_finite("odometry", &[motion.x(), motion.y(), motion.yaw()])?;
        check::in_range("odometry run", motion.translation().norm(), 0.0, LONGEST_RUN)?;
        check::all_finite("odometry covariance", odometry.covariance.iter())?;
        let pending = belief.pending.map_or(*odometry, |earlier| earlier.compose(odometry));
        let moved = UncertainPose::new(pending.start_from_end, self.motion.covariance(&pending))?;
        known.pose = known.moments.compose(&moved);
        known.stamp = Some(odometry.end);
        belief.monitor.moved(&known.pose);
        belief.pending = Some(pending);
        belief.moved(&motion);
        Ok(())
    }

    fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        self.belief.known.map(|known| PoseEstimate { pose: known.pose, stamp: known.stamp })
    }

    fn status(&self) -> LocalizationStatus {
        self.belief.monitor.status()
    }
}

impl<Z, M, S, R, P, U, N> Correct<Z> for Mcl<M, S, R, P, U, N>
where
    Z: Observation + ?Sized,
    M: MotionModel<Motion = OdometryIncrement>,
    S: WeighParticles<Z>,
    R: Resampler,
    P: ResamplePolicy,
    U: UpdatePolicy,
    N: SampleSize,
{
    /// Moves and weighs the particles, and resamples them where the policy asks for it.
    ///
    /// Skipped if the vehicle has moved too little since the last observation of the same
    /// sensor, if the sensor finds too few readings, or if no particle explains the observation; the next observation is
    /// then taken in. The particles keep their weights, and move by the pending odometry once that reaches the threshold of
    /// updates. The report says which share of the beams the mean explains, if the sensor's model can tell.
    fn update(&mut self, observation: &Z) -> Result<UpdateOutcome, LocalizationError> {
        self.correct(observation, &mut Plain)
    }
}

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N> {
    /// Draws `around` particles of a belief around a pose, or as many as there is room for of one over all free space.
    pub(in crate::particle) fn initialize_with(
        &mut self,
        belief: &PoseBelief<Se2>,
        around: usize,
    ) -> Result<(), LocalizationError> {
        match belief {
            PoseBelief::Around(pose) => {
                check::in_range("covariance", pose.covariance().amax(), 0.0, LONGEST_RUN * LONGEST_RUN)?;
                let (gaussian, layout) = (PoseGaussian::new(pose), *self.free_space.layout());
                let is_on_map = |pose: &Se2| layout.cell_at(&pose.translation()).is_some();
                if !self.draw_all(around, |_, stream| gaussian.sample(stream), |poses| poses.iter().any(is_on_map)) {
                    return Err(LocalizationError::OffMap { x: pose.mean().x(), y: pose.mean().y() });
                }
            }
            PoseBelief::Anywhere => {
                let free_space = self.free_space.clone();
                let count = self.belief.particles.capacity();
                self.draw_all(count, |index, stream| free_space.sample_stratum(index, count, stream), |_| true);
            }
            _ => return Err(Error::Empty { name: "belief" }.into()),
        }
        let moments = self.belief.particles.estimate(self.par)?;
        self.belief.begin(moments);
        Ok(())
    }

    /// Replaces the particles by draws, unless they are not accepted.
    fn draw_all(
        &mut self,
        count: usize,
        sample: impl Fn(usize, &mut Stream) -> Se2 + Sync,
        accept: impl Fn(&[Se2]) -> bool,
    ) -> bool {
        let (seed, step) = (self.seed_for(Draw::Initialization), self.belief.step);
        let fill = |chunk: usize, poses: &mut [Se2]| {
            draw_chunk(chunk, poses, seed.stream(step, chunk as u64), &sample);
        };
        let accepted = self.belief.particles.refill(count, self.par, fill, accept);
        if accepted {
            self.belief.step = self.belief.step.wrapping_add(1);
        }
        accepted
    }
}
