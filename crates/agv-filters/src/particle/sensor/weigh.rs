//! Weighing all particles by an observation.

use super::{PoseLikelihood, SensorModel};
use agv_core::{
    compute::{CHUNK, Par},
    geometry::{Se2, UncertainPose},
    roles::SkipReason,
};

/// Weighs a batch of poses by an observation: what a filter needs of a sensor.
///
/// Object-safe: `Box<dyn WeighParticles<LaserScan> + Send>` is one too, where the model is chosen at run time. A model for
/// several kinds of observations implements it for each:
///
/// ```
/// use agv_core::{compute::Par, geometry::Se2, roles::SkipReason, sensors::LaserScan};
/// use agv_filters::particle::{LikelihoodFieldModel, PerPose, PoseLikelihood, SensorModel, WeighParticles};
///
/// /// A code on the floor, seen straight below.
/// struct Code { map_from_base: Se2 }
/// # impl agv_core::sensors::Observation for Code {}
/// struct CodeModel { sigma: f64 }
/// impl SensorModel<Code> for CodeModel {
///     fn condition<'a>(&'a mut self, code: &'a Code) -> Result<impl PoseLikelihood + 'a, SkipReason> {
///         let weight = -0.5 * self.sigma.powi(-2);
///         Ok(move |pose: &Se2| weight * (pose.translation() - code.map_from_base.translation()).norm_squared())
///     }
/// }
///
/// /// One filter with these takes scans and codes.
/// struct Sensors { laser: LikelihoodFieldModel, codes: PerPose<CodeModel> }
/// impl WeighParticles<LaserScan> for Sensors {
///     fn weigh(&mut self, scan: &LaserScan, poses: &[Se2], out: &mut [f64], par: Par) -> Result<(), SkipReason> {
///         self.laser.weigh(scan, poses, out, par)
///     }
/// }
/// impl WeighParticles<Code> for Sensors {
///     fn weigh(&mut self, code: &Code, poses: &[Se2], out: &mut [f64], par: Par) -> Result<(), SkipReason> {
///         self.codes.weigh(code, poses, out, par)
///     }
/// }
/// ```
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

    /// Hands the observation, ready to judge poses, to `judge`: for filters that weigh poses as they draw them. None, without a call, if
    /// the sensor only weighs all poses together.
    ///
    /// # Errors
    /// As [`weigh`](Self::weigh), in which case `judge` is not called either.
    fn with_likelihood(
        &mut self,
        observation: &Z,
        judge: &mut dyn FnMut(&dyn PoseLikelihood),
    ) -> Option<Result<(), SkipReason>> {
        let _ = (observation, judge);
        None
    }

    /// The pose near `guess` that explains the observation best; none if there is no better one, or the model cannot tell. `guess` has
    /// the mean of the particles after the observation was weighed, and the covariance of what was known before.
    fn refine(&mut self, observation: &Z, guess: &UncertainPose<Se2>) -> Option<Se2> {
        let _ = (observation, guess);
        None
    }

    /// Share of the observation's usable readings that a pose explains, from 0 to 1; none if the model cannot tell.
    ///
    /// Asked once per update, for the estimate.
    fn explained(&mut self, observation: &Z, map_from_base: &Se2) -> Option<f64> {
        let _ = (observation, map_from_base);
        None
    }

    /// As how many independent readings the log-likelihood of an observation counts: what it is divided by where observations
    /// are compared with each other, as recovery does.
    fn independent_readings(&self) -> f64 {
        1.0
    }
}

/// Weighs particles by a model that judges pose by pose.
///
/// ```
/// use agv_core::compute::Par;
/// use agv_core::geometry::Se2;
/// use agv_core::roles::SkipReason;
/// use agv_filters::particle::{PerPose, PoseLikelihood, SensorModel, WeighParticles};
///
/// struct Compass { sigma: f64 }
/// impl SensorModel<f64> for Compass {
///     fn condition<'a>(&'a mut self, heading: &'a f64) -> Result<impl PoseLikelihood + 'a, SkipReason> {
///         let weight = self.sigma.powi(-2);
///         Ok(move |pose: &Se2| weight * ((pose.yaw() - heading).cos() - 1.0))
///     }
/// }
///
/// let mut weigher: Box<dyn WeighParticles<f64>> = Box::new(PerPose(Compass { sigma: 0.1 }));
/// let (poses, mut log_likelihoods) = ([Se2::new(0.0, 0.0, 0.3), Se2::new(0.0, 0.0, 0.5)], [0.0; 2]);
/// weigher.weigh(&0.3, &poses, &mut log_likelihoods, Par::Seq).unwrap();
/// assert!(log_likelihoods[0] > log_likelihoods[1]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PerPose<S>(
    /// The model.
    pub S,
);

impl<Z: ?Sized, S: SensorModel<Z>> WeighParticles<Z> for PerPose<S> {
    fn weigh(
        &mut self,
        observation: &Z,
        poses: &[Se2],
        log_likelihoods: &mut [f64],
        par: Par,
    ) -> Result<(), SkipReason> {
        weigh_each(&mut self.0, observation, poses, log_likelihoods, par)
    }

    fn with_likelihood(
        &mut self,
        observation: &Z,
        judge: &mut dyn FnMut(&dyn PoseLikelihood),
    ) -> Option<Result<(), SkipReason>> {
        Some(self.0.condition(observation).map(|likelihood| judge(&likelihood)))
    }

    fn refine(&mut self, observation: &Z, guess: &UncertainPose<Se2>) -> Option<Se2> {
        self.0.refine(observation, guess)
    }

    fn explained(&mut self, observation: &Z, map_from_base: &Se2) -> Option<f64> {
        self.0.condition(observation).ok()?.explained(map_from_base)
    }

    fn independent_readings(&self) -> f64 {
        self.0.independent_readings()
    }
}

/// Conditions a model and asks it for each pose, in chunks.
pub(super) fn weigh_each<Z: ?Sized>(
    model: &mut impl SensorModel<Z>,
    observation: &Z,
    poses: &[Se2],
    log_likelihoods: &mut [f64],
    par: Par,
) -> Result<(), SkipReason> {
    let likelihood = model.condition(observation)?;
    par.for_each_chunk((poses, log_likelihoods), CHUNK, |_, (poses, out): (&[Se2], &mut [f64])| {
        likelihood.log_likelihoods(poses, out);
    });
    Ok(())
}

/// Lets a model of this crate that judges pose by pose weigh particles without a [`PerPose`] around it.
macro_rules! weigh_per_pose {
    ($model:ty: $observation:ty) => {
        impl $crate::particle::WeighParticles<$observation> for $model {
            fn weigh(
                &mut self,
                observation: &$observation,
                poses: &[agv_core::geometry::Se2],
                log_likelihoods: &mut [f64],
                par: agv_core::compute::Par,
            ) -> Result<(), agv_core::roles::SkipReason> {
                $crate::particle::sensor::weigh::weigh_each(self, observation, poses, log_likelihoods, par)
            }

            fn with_likelihood(
                &mut self,
                observation: &$observation,
                judge: &mut dyn FnMut(&dyn $crate::particle::PoseLikelihood),
            ) -> Option<Result<(), agv_core::roles::SkipReason>> {
                Some(self.condition(observation).map(|likelihood| judge(&likelihood)))
            }

            fn refine(
                &mut self,
                observation: &$observation,
                guess: &agv_core::geometry::UncertainPose<agv_core::geometry::Se2>,
            ) -> Option<agv_core::geometry::Se2> {
                $crate::particle::SensorModel::refine(self, observation, guess)
            }

            fn explained(
                &mut self,
                observation: &$observation,
                map_from_base: &agv_core::geometry::Se2,
            ) -> Option<f64> {
                self.condition(observation).ok()?.explained(map_from_base)
            }

            fn independent_readings(&self) -> f64 {
                $crate::particle::SensorModel::<$observation>::independent_readings(self)
            }
        }
    };
}
pub(super) use weigh_per_pose;

macro_rules! weigh_through {
    ($($pointer:ty),+) => {$(
        impl<Z: ?Sized, W: WeighParticles<Z> + ?Sized> WeighParticles<Z> for $pointer {
            fn weigh(
                &mut self,
                observation: &Z,
                poses: &[Se2],
                log_likelihoods: &mut [f64],
                par: Par,
            ) -> Result<(), SkipReason> {
                (**self).weigh(observation, poses, log_likelihoods, par)
            }

            fn with_likelihood(
                &mut self,
                observation: &Z,
                judge: &mut dyn FnMut(&dyn PoseLikelihood),
            ) -> Option<Result<(), SkipReason>> {
                (**self).with_likelihood(observation, judge)
            }

            fn refine(&mut self, observation: &Z, guess: &UncertainPose<Se2>) -> Option<Se2> {
                (**self).refine(observation, guess)
            }

            fn explained(&mut self, observation: &Z, map_from_base: &Se2) -> Option<f64> {
                (**self).explained(observation, map_from_base)
            }

            fn independent_readings(&self) -> f64 {
                (**self).independent_readings()
            }
        }
    )+};
}
weigh_through!(Box<W>, &mut W);

#[cfg(test)]
mod tests {
    use super::*;

    /// Likes poses to the right, and explains those beyond one.
    #[derive(Clone, Copy)]
    struct Slope(f64);

    struct OnSlope(f64);

    impl SensorModel<()> for Slope {
        fn condition<'a>(&'a mut self, (): &'a ()) -> Result<impl PoseLikelihood + 'a, SkipReason> {
            if self.0 == 0.0 { Err(SkipReason::Unexplained) } else { Ok(OnSlope(self.0)) }
        }
    }

    impl PoseLikelihood for OnSlope {
        fn log_likelihood(&self, pose: &Se2) -> f64 {
            self.0 * pose.x()
        }

        fn explained(&self, pose: &Se2) -> Option<f64> {
            Some((pose.x() / self.0).clamp(0.0, 1.0))
        }
    }

    fn weigh(mut weigher: impl WeighParticles<()>) -> Result<Vec<f64>, SkipReason> {
        let poses: Vec<Se2> = (0..600).map(|i| Se2::new(f64::from(i), 0.0, 0.0)).collect();
        let mut out = vec![0.0; poses.len()];
        weigher.weigh(&(), &poses, &mut out, Par::Seq).map(|()| out)
    }

    #[test]
    fn pointers_weigh_as_what_they_point_to() {
        let plain = weigh(PerPose(Slope(2.0)));
        assert_eq!(weigh(&mut PerPose(Slope(2.0))), plain);
        assert_eq!(weigh(Box::new(PerPose(Slope(2.0))) as Box<dyn WeighParticles<()> + Send>), plain);
        assert_eq!(plain.unwrap()[300], 600.0);
    }

    #[test]
    fn pairs_multiply_and_both_must_explain() {
        let mut pair = PerPose((Slope(2.0), Slope(0.5)));
        assert_eq!(weigh(pair), weigh(PerPose(Slope(2.5))));
        assert_eq!(pair.explained(&(), &Se2::new(0.4, 0.0, 0.0)), Some(0.2));
        assert_eq!(weigh(PerPose((Slope(2.0), Slope(0.0)))), Err(SkipReason::Unexplained));
    }
}
