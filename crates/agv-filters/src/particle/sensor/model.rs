//! Sensor models that judge pose by pose.

use agv_core::{
    compute::CHUNK,
    geometry::{Se2, UncertainPose},
    roles::SkipReason,
};

/// An observation that waits for poses to be judged by it.
///
/// Closures from a pose to a log-likelihood are one; a model with a faster way for many poses overrides the batch.
pub trait PoseLikelihood: Sync {
    /// Logarithm of the observation's likelihood if the vehicle is at `map_from_base`, up to a constant that is the
    /// same for all poses; −∞ if it is impossible, never NaN or +∞ for a finite pose.
    fn log_likelihood(&self, map_from_base: &Se2) -> f64;

    /// Writes the log-likelihood of each pose; both slices have the same length.
    fn log_likelihoods(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        for (log_likelihood, pose) in log_likelihoods.iter_mut().zip(poses) {
            *log_likelihood = self.log_likelihood(pose);
        }
    }

    /// Share of the observation's usable readings that the pose explains, from 0 to 1; none if the model cannot tell.
    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let _ = map_from_base;
        None
    }
}

impl<F: Fn(&Se2) -> f64 + Sync> PoseLikelihood for F {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        self(map_from_base)
    }
}

/// How likely an observation `Z` is from a pose: conditioned once, then called for every particle.
///
/// `&mut self` is for scratch memory (beam end points), so that conditioning allocates nothing once warm.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::roles::SkipReason;
/// use agv_filters::particle::{PoseLikelihood, SensorModel};
///
/// /// A heading from a compass, in radians.
/// struct Heading(f64);
/// struct Compass { sigma: f64 }
///
/// impl SensorModel<Heading> for Compass {
///     fn condition<'a>(&'a mut self, heading: &'a Heading) -> Result<impl PoseLikelihood + 'a, SkipReason> {
///         let weight = self.sigma.powi(-2);
///         Ok(move |pose: &Se2| weight * ((pose.yaw() - heading.0).cos() - 1.0))
///     }
/// }
///
/// let mut compass = Compass { sigma: 0.1 };
/// let heading = Heading(0.3);
/// let likelihood = compass.condition(&heading).unwrap();
/// assert!(likelihood.log_likelihood(&Se2::new(0.0, 0.0, 0.3)) > likelihood.log_likelihood(&Se2::new(0.0, 0.0, 0.5)));
/// ```
pub trait SensorModel<Z: ?Sized> {
    /// Hoists everything that does not depend on the pose.
    ///
    /// # Errors
    /// Why the observation cannot weigh anything: [`SkipReason::TooFewReadings`] for a scan without usable beams.
    fn condition<'a>(&'a mut self, observation: &'a Z) -> Result<impl PoseLikelihood + 'a, SkipReason>;

    /// The pose near `guess` that explains the observation best; none if there is no better one, or the model cannot tell. `guess` has
    /// the mean of the particles after the observation was weighed, and the covariance of what was known before.
    fn refine(&mut self, observation: &Z, guess: &UncertainPose<Se2>) -> Option<Se2> {
        let _ = (observation, guess);
        None
    }

    /// As how many independent readings the log-likelihood of an observation counts: what it is divided by where observations
    /// are compared with each other.
    fn independent_readings(&self) -> f64 {
        1.0
    }
}

/// Two models of one observation whose errors are independent: likelihoods multiply, and what both see counts.
///
/// The estimate is refined by the first of them that can.
impl<Z: ?Sized, A: SensorModel<Z>, B: SensorModel<Z>> SensorModel<Z> for (A, B) {
    fn condition<'a>(&'a mut self, observation: &'a Z) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        Ok(Both(self.0.condition(observation)?, self.1.condition(observation)?))
    }

    fn independent_readings(&self) -> f64 {
        self.0.independent_readings() + self.1.independent_readings()
    }

    fn refine(&mut self, observation: &Z, guess: &UncertainPose<Se2>) -> Option<Se2> {
        self.0.refine(observation, guess).or_else(|| self.1.refine(observation, guess))
    }
}

/// Two likelihoods of one observation.
struct Both<A, B>(A, B);

impl<A: PoseLikelihood, B: PoseLikelihood> PoseLikelihood for Both<A, B> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        self.0.log_likelihood(map_from_base) + self.1.log_likelihood(map_from_base)
    }

    fn log_likelihoods(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        let mut second = [0.0; CHUNK];
        for (poses, sums) in poses.chunks(CHUNK).zip(log_likelihoods.chunks_mut(CHUNK)) {
            let second = &mut second[..poses.len()];
            self.0.log_likelihoods(poses, sums);
            self.1.log_likelihoods(poses, second);
            sums.iter_mut().zip(second).for_each(|(sum, term)| *sum += *term);
        }
    }

    /// The lesser share: one model's word that a reading does not fit is enough.
    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let shares = [self.0.explained(map_from_base), self.1.explained(map_from_base)];
        shares.into_iter().flatten().reduce(f64::min)
    }
}
