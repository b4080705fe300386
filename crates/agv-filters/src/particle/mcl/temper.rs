//! Taking an observation in by degrees where it says much more than the particles foresaw.
//!
//! Where the odometry is wrong by more than its model expects, few particles lie where the scan puts the vehicle: the weights
//! collapse onto those few, and what they leave out is lost. But a likelihood may as well be applied by powers `β` that sum to
//! one, each as large as leaves enough particles alive:
//!
//! ```text
//! w ← w L(x)^β    with    1 / Σ w² = target · n
//! ```
//!
//! after which the set is drawn anew and every particle is moved by a kernel, a shrunken copy of the set's own spread: what
//! survives closes up on the peak before the rest is applied. A belief that is spread over a building has no such peak yet, and
//! few particles near any: of that only one power is applied, and the next observations tell the places apart (tempering: Del Moral, Doucet and Jasra, *Sequential Monte Carlo
//! samplers*, 2006; kernel: Musso, Oudjane and Le Gland, *Improving regularised particle filters*, 2001).

use super::{
    belief::{Belief, LastDrawn},
    filter::{Draw, Mcl},
};
use crate::particle::{Resampler, WeighParticles, WeightSummary, gaussian::PoseGaussian};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainPose},
};

/// When an observation is taken in by degrees, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TemperingParams {
    /// An observation that leaves an effective sample size below this share of the particles is taken in by degrees; zero
    /// never does.
    pub collapse: f64,
    /// Effective sample size that a degree leaves, as a share of the particles.
    pub target: f64,
    /// Most degrees; what the set cannot bear of the last one is left out.
    pub degrees: usize,
    /// Deviation of the expected position, in metres, from which on a belief is too wide for it: of an observation only as much
    /// is taken in as leaves the least effective sample size.
    pub widest: f64,
    /// Largest deviation of the kernel, in metres: hypotheses farther apart are not smeared.
    pub kernel_position: f64,
    /// Largest deviation of the kernel, in radians.
    pub kernel_rotation: f64,
}

impl Default for TemperingParams {
    /// Below 5 %, which odometry as exact as its model says seldom comes to (0.3 % of the updates of the Intel log, while the belief
    /// narrows down) and which 20 of 400 particles can still carry; a kernel of at most 0.1 m and 0.1 rad, two map cells and the width
    /// of a scan's peak. Up to 3 m, which a jump of the odometry by a third of a metre to
    /// the side comes near, a belief has one peak; one over a hall is wider.
    fn default() -> Self {
        Self { collapse: 0.05, target: 0.3, degrees: 5, widest: 3.0, kernel_position: 0.1, kernel_rotation: 0.1 }
    }
}

impl TemperingParams {
    /// Takes every observation in at once, as the plain filter does.
    pub fn never() -> Self {
        Self { collapse: 0.0, ..Self::default() }
    }

    /// Checks all fields.
    ///
    /// # Errors
    /// Shares outside [0, 1], zero or more than a thousand degrees, or a deviation that is negative or not finite.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("collapse", self.collapse, 0.0, 1.0)?;
        check::in_range("target", self.target, 0.0, 1.0)?;
        check::in_range("degrees", self.degrees as f64, 1.0, 1000.0)?;
        check::non_negative("widest", self.widest)?;
        check::non_negative("kernel_position", self.kernel_position)?;
        check::non_negative("kernel_rotation", self.kernel_rotation)?;
        Ok(())
    }

    /// The kernel for `count` particles with these moments: Silverman's bandwidth in three dimensions, cut.
    fn kernel(&self, moments: &UncertainPose<Se2>, count: usize) -> Result<PoseGaussian, Error> {
        let covariance = moments.covariance();
        let bandwidth = (4.0 / (5.0 * count as f64)).powf(1.0 / 7.0);
        let cut = |most: f64, variance: f64| if variance > 0.0 { most / variance.sqrt() } else { f64::INFINITY };
        let position = cut(self.kernel_position, covariance.m11.max(covariance.m22));
        let rotation = cut(self.kernel_rotation, covariance.m33);
        let scale = bandwidth.min(position).min(rotation);
        Ok(PoseGaussian::new(&UncertainPose::new(Se2::identity(), covariance * (scale * scale))?))
    }
}

/// What the set holds of an observation.
pub(super) struct Taken {
    pub(super) weights: WeightSummary,
    /// In how many degrees it was taken in.
    pub(super) degrees: usize,
    /// Whether particles and weights are those of the first weighing: all of it was taken in, at once.
    pub(super) is_whole: bool,
}

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N> {
    /// If the weights have collapsed under an observation, takes it back and in again by degrees, or, in a belief as wide as
    /// `expected`, only as much of it as the set can bear.
    ///
    /// `log_likelihoods` are those of the observation that the weights hold.
    pub(super) fn temper<Z: ?Sized>(
        &mut self,
        observation: &Z,
        mut weights: WeightSummary,
        expected: &UncertainPose<Se2>,
    ) -> Result<Taken, Error>
    where
        S: WeighParticles<Z>,
        R: Resampler,
    {
        let TemperingParams { collapse, target, degrees: most, widest, .. } = self.tempering;
        let [draw_seed, kernel_seed] = [Draw::Tempering, Draw::TemperingKernel].map(|draw| self.seed_for(draw));
        let Belief { particles, step, drawn, odom_from_base, .. } = &mut self.belief;
        let count = particles.len();
        let [least, target] = [collapse, target].map(|share| share * count as f64);
        let log_likelihoods = &mut self.log_likelihoods[..count];
        let (mut rest, mut degrees) = (1.0, 1);
        let is_whole = !is_collapsed(&weights, least);
        while is_collapsed(&weights, least) {
            if degrees == most || expected.position_deviation() > widest {
                (weights, _) = particles.temper(log_likelihoods, weights, least, self.par);
                break;
            }
            let (_, power) = particles.temper(log_likelihoods, weights, target, self.par);
            rest *= 1.0 - power;
            let kernel = self.tempering.kernel(&particles.estimate(self.par)?, count)?;
            particles.resample(count, &self.rules.resampler, &mut draw_seed.stream(*step, 0), self.par);
            particles.propose(self.par, |chunk, poses, moved| {
                let mut stream = kernel_seed.stream(*step, chunk as u64);
                for (moved, pose) in moved.iter_mut().zip(poses) {
                    *moved = *pose * kernel.sample(&mut stream);
                }
            });
            particles.adopt();
            *step = step.wrapping_add(1);
            // Equal, should the observation weigh nothing where they are now.
            weights = WeightSummary { log_evidence: weights.log_evidence, ..WeightSummary::uniform(count) };
            *drawn = LastDrawn::now(*odom_from_base);
            if self.sensor.weigh(observation, particles.states(), log_likelihoods, self.par).is_err() {
                break;
            }
            for log_likelihood in log_likelihoods.iter_mut() {
                *log_likelihood *= rest;
            }
            let Some(tempered) = particles.reweigh(log_likelihoods, self.par) else { break };
            // How well the set foresaw the observation, the first weighing has said.
            weights = WeightSummary { log_evidence: weights.log_evidence, ..tempered };
            degrees += 1;
        }
        Ok(Taken { weights, degrees, is_whole })
    }
}

/// Whether an observation has left fewer particles effective than the set can carry.
fn is_collapsed(weights: &WeightSummary, least: f64) -> bool {
    weights.effective_sample_size < least
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn the_kernel_is_a_shrunken_copy_and_is_cut() {
        let params = TemperingParams::default();
        let spread = |position: f64, rotation: f64| {
            let variances = nalgebra::Vector3::new(position, position, rotation).map(|s| s * s);
            let moments = UncertainPose::new(Se2::identity(), Matrix3::from_diagonal(&variances)).unwrap();
            let kernel = params.kernel(&moments, 500).unwrap();
            let mut stream = agv_core::compute::Seed(1).stream(0, 0);
            let draws: Vec<_> = (0..4000).map(|_| kernel.sample(&mut stream)).collect();
            let deviation = |of: fn(&Se2) -> f64| (draws.iter().map(|d| of(d).powi(2)).sum::<f64>() / 4000.0).sqrt();
            (deviation(Se2::x), deviation(Se2::yaw))
        };
        // Bandwidth (4 / 2500)^(1/7) = 0.399.
        let (position, rotation) = spread(0.1, 0.05);
        assert!((position / 0.0399 - 1.0).abs() < 0.06 && (rotation / 0.01995 - 1.0).abs() < 0.06);
        let (position, rotation) = spread(20.0, 1.5);
        assert!((position / 0.1 - 1.0).abs() < 0.06 && rotation < 0.01);
        assert_eq!(spread(0.0, 0.0), (0.0, 0.0));
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = TemperingParams::default();
        for (name, bad) in [
            ("collapse", TemperingParams { collapse: 1.1, ..good }),
            ("target", TemperingParams { target: f64::NAN, ..good }),
            ("degrees", TemperingParams { degrees: 0, ..good }),
            ("widest", TemperingParams { widest: -1.0, ..good }),
            ("kernel_position", TemperingParams { kernel_position: -0.1, ..good }),
            ("kernel_rotation", TemperingParams { kernel_rotation: f64::INFINITY, ..good }),
        ] {
            assert!(bad.validate().unwrap_err().to_string().starts_with(name));
        }
        assert!(TemperingParams::never().validate().is_ok());
    }
}
