//! Several kinds of observations on one filter.

use super::{PoseLikelihood, WeighParticles};
use agv_core::{
    compute::Par,
    geometry::{Se2, UncertainPose},
    roles::SkipReason,
    sensors::{LandmarkObservation, LaserScan, MarkerObservation},
};

/// A model for every kind of observation that a vehicle makes: scans, codes, landmarks. `()` where it makes none, `None` where
/// that turns out as it runs.
///
/// A [`Mcl`](crate::particle::Mcl) with it takes each of them; any number of sensors of a kind, each with its own mount. For
/// other kinds of observations write a struct like it.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::grid::{CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::roles::Correct;
/// use agv_core::sensors::{LaserScan, MarkerObservation};
/// use agv_core::compute::Seed;
/// use agv_filters::particle::*;
///
/// let map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::default())?, CellState::Free);
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let codes = [(23, UncertainPose::exact(Se2::new(1.0, 2.0, 0.0)))];
/// let sensors = Sensors {
///     scans: LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?,
///     markers: MarkerModel::new(codes, MarkerModelParams::default())?,
///     landmarks: (),
/// };
/// let motion = DifferentialOdometryModel::new(OdometryNoise::default())?;
/// let mcl = Mcl::new(motion, sensors, FreeSpace::new(&map, 0.3)?, MclParams::default(), Seed(7))?;
///
/// fn takes_both(_: impl Correct<LaserScan> + Correct<[MarkerObservation<Se2>]>) {}
/// takes_both(mcl);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sensors<S, M = (), L = ()> {
    /// Weighs by laser scans.
    pub scans: S,
    /// Weighs by codes.
    pub markers: M,
    /// Weighs by landmarks.
    pub landmarks: L,
}

macro_rules! weigh_by_field {
    ($($field:ident: $observation:ty),+) => {$(
        impl<S, M, L> WeighParticles<$observation> for Sensors<S, M, L>
        where
            weigh_by_field!(@ $field S M L): WeighParticles<$observation>,
        {
            fn weigh(
                &mut self,
                observation: &$observation,
                poses: &[Se2],
                log_likelihoods: &mut [f64],
                par: Par,
            ) -> Result<(), SkipReason> {
                self.$field.weigh(observation, poses, log_likelihoods, par)
            }

            fn with_likelihood(
                &mut self,
                observation: &$observation,
                judge: &mut dyn FnMut(&dyn PoseLikelihood),
            ) -> Option<Result<(), SkipReason>> {
                self.$field.with_likelihood(observation, judge)
            }

            fn explained(&mut self, observation: &$observation, map_from_base: &Se2) -> Option<f64> {
                self.$field.explained(observation, map_from_base)
            }

            fn independent_readings(&self) -> f64 {
                self.$field.independent_readings()
            }

            fn refine(&mut self, observation: &$observation, guess: &UncertainPose<Se2>) -> Option<Se2> {
                self.$field.refine(observation, guess)
            }
        }
    )+};
    (@ scans $s:ident $m:ident $l:ident) => { $s };
    (@ markers $s:ident $m:ident $l:ident) => { $m };
    (@ landmarks $s:ident $m:ident $l:ident) => { $l };
}
weigh_by_field!(
    scans: LaserScan,
    markers: MarkerObservation<Se2>,
    markers: [MarkerObservation<Se2>],
    landmarks: LandmarkObservation,
    landmarks: [LandmarkObservation]
);

/// No model: whatever is observed is skipped.
impl<Z: ?Sized> WeighParticles<Z> for () {
    fn weigh(&mut self, _: &Z, _: &[Se2], _: &mut [f64], _: Par) -> Result<(), SkipReason> {
        Err(SkipReason::TooFewReadings { usable: 0, needed: 1 })
    }
}

/// A model that is there, or not: whatever is observed is skipped then.
impl<Z: ?Sized, W: WeighParticles<Z>> WeighParticles<Z> for Option<W> {
    fn weigh(
        &mut self,
        observation: &Z,
        poses: &[Se2],
        log_likelihoods: &mut [f64],
        par: Par,
    ) -> Result<(), SkipReason> {
        match self {
            Some(model) => model.weigh(observation, poses, log_likelihoods, par),
            None => WeighParticles::weigh(&mut (), observation, poses, log_likelihoods, par),
        }
    }

    fn explained(&mut self, observation: &Z, map_from_base: &Se2) -> Option<f64> {
        self.as_mut()?.explained(observation, map_from_base)
    }

    fn independent_readings(&self) -> f64 {
        self.as_ref().map_or(1.0, WeighParticles::independent_readings)
    }

    fn refine(&mut self, observation: &Z, guess: &UncertainPose<Se2>) -> Option<Se2> {
        self.as_mut()?.refine(observation, guess)
    }
}
