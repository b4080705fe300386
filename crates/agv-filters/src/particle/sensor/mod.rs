//! How likely an observation is, given a pose.
//!
//! Two shapes. A [`SensorModel`] is written pose by pose: conditioned once on the observation, then asked for the
//! log-likelihood of each pose. [`WeighParticles`] is the batch form that a filter calls: object-safe, and open to models
//! that must see all particles at once, as beam skipping does. Every `SensorModel` is a `WeighParticles`.

mod likelihood_field;

use agv_core::{
    compute::{CHUNK, Par},
    geometry::Se2,
    roles::SkipReason,
};

pub use likelihood_field::{LikelihoodFieldModel, LikelihoodFieldModelParams, ScanForm};

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
}

/// Weighs a batch of poses by an observation: what a filter needs of a sensor, held as `Box<dyn WeighParticles<Z>>` where
/// the kind of sensor is chosen at run time.
pub trait WeighParticles<Z: ?Sized> {
    /// Writes the log-likelihood of `observation` at each pose; both slices have the same length.
    ///
    /// # Errors
    /// Why the observation cannot weigh anything; `log_likelihoods` then holds nothing of use.
    fn weigh(
        &mut self,
        observation: &Z,
        poses: &[Se2],
        log_likelihoods: &mut [f64],
        par: Par,
    ) -> Result<(), SkipReason>;
}

impl<Z: ?Sized, S: SensorModel<Z>> WeighParticles<Z> for S {
    fn weigh(
        &mut self,
        observation: &Z,
        poses: &[Se2],
        log_likelihoods: &mut [f64],
        par: Par,
    ) -> Result<(), SkipReason> {
        let likelihood = self.condition(observation)?;
        par.for_each_chunk((poses, log_likelihoods), CHUNK, |_, (poses, out): (&[Se2], &mut [f64])| {
            likelihood.log_likelihoods(poses, out);
        });
        Ok(())
    }
}
