//! The roles that the filter plays.

use super::{
    MclDiagnostics,
    filter::{Draw, Mcl},
    gaussian::PoseGaussian,
};
use crate::particle::{MotionModel, ResamplePolicy, Resampler, UpdatePolicy, WeighParticles, WeightSummary};
use agv_core::{
    Error, check,
    compute::Stream,
    geometry::{LieGroup, Se2},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, Localizer, PoseBelief, PoseEstimate, UpdateOutcome},
    sensors::Observation,
};
use nalgebra::Matrix3;

/// Longest run of a single odometry increment, in metres: beyond, the numbers of a map have no meaning.
const LONGEST_RUN: f64 = 1e6;

impl<M, S, R, P, U> Localizer for Mcl<M, S, R, P, U>
where
    M: MotionModel<Motion = OdometryIncrement>,
    U: UpdatePolicy,
{
    type Pose = Se2;

    /// Draws all particles anew: around a pose, or uniformly over free space and heading.
    ///
    /// # Errors
    /// [`LocalizationError::OffMap`] if not one particle lies in the map; a mean or covariance that is not finite, a
    /// variance above (1000 km)², or a covariance that is not symmetric and positive semi-definite.
    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        match *belief {
            PoseBelief::Around { map_from_base, covariance } => {
                check::all_finite("covariance", covariance.iter())?;
                check::in_range("covariance", covariance.amax(), 0.0, LONGEST_RUN * LONGEST_RUN)?;
                let gaussian = PoseGaussian::new(map_from_base, &covariance)?;
                let layout = *self.free_space.layout();
                let is_on_map = |pose: &Se2| layout.cell_at(&pose.translation()).is_some();
                let drawn = self.draw_all(|stream| gaussian.sample(stream), |poses| poses.iter().any(is_on_map));
                if !drawn {
                    return Err(LocalizationError::OffMap { x: map_from_base.x(), y: map_from_base.y() });
                }
            }
            PoseBelief::Anywhere => {
                let free_space = self.free_space.clone();
                self.draw_all(|stream| free_space.sample(stream), |_| true);
            }
            _ => return Err(Error::Empty { name: "belief" }.into()),
        }
        let weights = WeightSummary::uniform(self.belief.particles.len());
        self.belief.diagnostics = MclDiagnostics { weights, resampled: false, updates: 0 };
        self.belief.initialized = true;
        self.belief.due = true;
        self.belief.pending = None;
        self.belief.stamp = None;
        self.belief.moments = None;
        Ok(())
    }

    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        if !self.belief.initialized {
            return Err(LocalizationError::NotInitialized);
        }
        let motion = odometry.start_from_end;
        check::all_finite("odometry", &[motion.x(), motion.y(), motion.yaw()])?;
        check::in_range("odometry run", motion.translation().norm(), 0.0, LONGEST_RUN)?;
        check::all_finite("odometry covariance", odometry.covariance.iter())?;
        let pending = match &self.belief.pending {
            Some(earlier) => chain(earlier, odometry),
            None => *odometry,
        };
        let is_due = self.update_policy.is_due(&pending.start_from_end);
        self.belief.pending = Some(pending);
        self.belief.stamp = Some(odometry.end);
        if is_due {
            self.belief.due = true;
            self.propagate();
        }
        Ok(())
    }

    fn estimate(&self) -> PoseEstimate<Se2> {
        if !self.belief.initialized {
            let covariance = Matrix3::from_diagonal_element(f64::INFINITY);
            return PoseEstimate::new(Se2::identity(), covariance);
        }
        let moments = self.belief.moments.unwrap_or_else(|| self.belief.particles.estimate(self.par));
        let stamp = self.belief.stamp;
        match &self.belief.pending {
            None => PoseEstimate { stamp, ..moments },
            Some(motion) => PoseEstimate {
                map_from_base: moments.map_from_base * motion.start_from_end,
                covariance: carry(&moments.covariance, &motion.start_from_end) + self.motion.covariance(motion),
                stamp,
            },
        }
    }
}

impl<Z, M, S, R, P, U> Correct<Z> for Mcl<M, S, R, P, U>
where
    Z: Observation + ?Sized,
    M: MotionModel<Motion = OdometryIncrement>,
    S: WeighParticles<Z>,
    R: Resampler,
    P: ResamplePolicy,
    U: UpdatePolicy,
{
    /// Weighs the particles, and resamples them where the policy asks for it.
    ///
    /// Skipped, with the weights as they were, if the vehicle has moved too little, if the sensor finds too few
    /// readings, or if no particle explains the observation; the next observation is then taken in.
    fn update(&mut self, observation: &Z) -> Result<UpdateOutcome, LocalizationError> {
        if self.belief.initialized { Ok(self.correct(observation)) } else { Err(LocalizationError::NotInitialized) }
    }
}

impl<M, S, R, P, U> Mcl<M, S, R, P, U> {
    /// Replaces the particles by draws, unless they are not accepted.
    fn draw_all(&mut self, sample: impl Fn(&mut Stream) -> Se2 + Sync, accept: impl Fn(&[Se2]) -> bool) -> bool {
        let (seed, step) = (self.seed_for(Draw::Initialization), self.belief.step);
        let fill = |chunk: usize, poses: &mut [Se2]| {
            let mut stream = seed.stream(step, chunk as u64);
            for pose in poses {
                *pose = sample(&mut stream);
            }
        };
        let accepted = self.belief.particles.refill(self.par, fill, accept);
        if accepted {
            self.belief.step += 1;
        }
        accepted
    }
}

/// Two motions, one after the other.
fn chain(first: &OdometryIncrement, second: &OdometryIncrement) -> OdometryIncrement {
    OdometryIncrement {
        start: first.start,
        end: second.end,
        start_from_end: first.start_from_end * second.start_from_end,
        covariance: carry(&first.covariance, &second.start_from_end) + second.covariance,
    }
}

/// The covariance of a pose in the frame that a motion leads to.
fn carry(covariance: &Matrix3<f64>, start_from_end: &Se2) -> Matrix3<f64> {
    let back = start_from_end.inverse().adjoint();
    back * covariance * back.transpose()
}
