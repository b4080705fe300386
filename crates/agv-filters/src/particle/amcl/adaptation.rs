//! What an adaptive filter knows beside its particles.

use super::doubts::Doubts;
use crate::particle::{
    Clusters, Hypothesis, Hysteresis, ParticleSet, PoseBins, PoseProposal, ProposalContext,
    mcl::{Adapt, Seen},
};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, UncertainPose},
    sensors::Observation,
};
use nalgebra::{Matrix3, Rotation2};

/// Hypotheses, doubts of each sensor, and where new particles come from.
#[derive(Debug, Clone)]
pub(super) struct Adaptation<G> {
    pub(super) proposal: G,
    pub(super) doubts: Doubts,
    pub(super) clusters: Clusters,
    pub(super) hysteresis: Hysteresis,
    pub(super) bins: PoseBins,
    /// The hypotheses at the last update, by falling weight.
    pub(super) hypotheses: Vec<Hypothesis>,
    /// Room for proposed poses.
    pub(super) fresh: Vec<Se2>,
}

/// Beside a hypothesis that holds most of the weight, one this much lighter does not count for the covariance: particles that
/// search are always somewhere.
const NEGLIGIBLE: f64 = 0.1;

impl<G> Adaptation<G> {
    /// A belief that was just given is one hypothesis.
    pub(super) fn begin(&mut self, pose: UncertainPose<Se2>, particles: usize, says_nothing: bool) {
        self.hypotheses.clear();
        self.hypotheses.push(Hypothesis { weight: 1.0, pose, particles });
        self.doubts.begin(says_nothing);
    }

    /// A belief no wider than a bin has one hypothesis, which need not be looked for.
    fn is_narrow(&self, moments: &UncertainPose<Se2>) -> bool {
        moments.position_deviation() < 0.5 * self.bins.position && moments.rotation_deviation() < self.bins.heading
    }
}

impl<Z, S: ?Sized, G> Adapt<Z, S> for Adaptation<G>
where
    Z: Observation + ?Sized,
    G: PoseProposal<Z, S>,
{
    fn estimate(
        &mut self,
        particles: &ParticleSet,
        moments: UncertainPose<Se2>,
        expected: &UncertainPose<Se2>,
    ) -> Result<UncertainPose<Se2>, Error> {
        self.hypotheses.clear();
        if self.is_narrow(&moments) {
            self.hypotheses.push(Hypothesis { weight: 1.0, pose: moments, particles: particles.len() });
            return Ok(moments);
        }
        self.hypotheses.extend_from_slice(self.clusters.find(particles)?);
        match self.hysteresis.choose(&self.hypotheses, expected.mean()) {
            Some(best) => among(best, &self.hypotheses),
            None => Ok(moments),
        }
    }

    fn fresh_share(&mut self, observation: &Z, seen: &Seen<'_>) -> f64 {
        let share = self.doubts.of(observation).observed(seen.weights.log_evidence / seen.readings, seen.explained);
        if self.doubts.params().max_share == 0.0 {
            return 0.0;
        }
        self.proposal.share(observation, seen.expected, share).clamp(0.0, 1.0)
    }

    fn propose(&mut self, observation: &Z, sensor: &mut S, context: &ProposalContext<'_>, most: usize) -> &[Se2] {
        self.fresh.clear();
        self.fresh.resize(most, Se2::identity());
        // Narrow soon after a start from anywhere is not found: the first searches look everywhere.
        let is_settled = context.updates >= u64::from(self.doubts.params().persistence);
        let context = context.of_particles(context.particles, context.is_narrow && is_settled);
        let written = self.proposal.propose(observation, sensor, &context, &mut self.fresh);
        self.fresh.truncate(written);
        self.fresh.retain(LieGroup::is_finite);
        &self.fresh
    }
}

/// The pose of a hypothesis, with the covariance of all that count about it: how far off the vehicle is if it is elsewhere.
fn among(best: &Hypothesis, all: &[Hypothesis]) -> Result<UncertainPose<Se2>, Error> {
    let (mut total, mut sum) = (0.0, Matrix3::zeros());
    let least = if best.weight > 0.5 { NEGLIGIBLE * best.weight } else { 0.0 };
    for other in all.iter().filter(|other| other.weight >= least) {
        let offset = other.pose.mean().minus(best.pose.mean());
        let turn = Rotation2::new(best.pose.mean().between(other.pose.mean()).yaw());
        let mut carry = Matrix3::identity();
        carry.fixed_view_mut::<2, 2>(0, 0).copy_from(turn.matrix());
        let spread = carry * other.pose.covariance() * carry.transpose() + offset * offset.transpose();
        total += other.weight;
        sum += spread * other.weight;
    }
    let covariance = sum / total;
    UncertainPose::new(*best.pose.mean(), (covariance + covariance.transpose()) * 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hypothesis(x: f64, yaw: f64, weight: f64) -> Hypothesis {
        let covariance = Matrix3::from_diagonal(&[0.01, 0.04, 0.001].into());
        Hypothesis { weight, pose: UncertainPose::new(Se2::new(x, 0.0, yaw), covariance).unwrap(), particles: 1 }
    }

    #[test]
    fn many_small_hypotheses_outweigh_one_that_is_not_much_larger() {
        let best = hypothesis(0.0, 0.0, 0.05);
        let mut all = vec![best];
        all.extend((0..200).map(|_| hypothesis(10.0, 0.0, 0.0045)));
        let spread = among(&best, &all).unwrap();
        assert!((spread.covariance().m11 - (100.0 * 0.9 / 0.95 + 0.01)).abs() < 1e-9, "{}", spread.covariance());
    }

    #[test]
    fn other_hypotheses_widen_the_estimate_unless_they_are_negligible() {
        let best = hypothesis(0.0, 0.0, 0.6);
        let alone = among(&best, &[best, hypothesis(10.0, 0.0, 0.05)]).unwrap();
        assert!((alone.covariance() - best.pose.covariance()).amax() < 1e-12);
        let pair = among(&best, &[best, hypothesis(10.0, 0.0, 0.2)]).unwrap();
        // A quarter of the weight, ten metres away.
        assert!((pair.covariance().m11 - (25.0 + 0.01)).abs() < 1e-9 && (pair.covariance().m22 - 0.04).abs() < 1e-9);
        assert_eq!(pair.mean(), best.pose.mean());
        // Turned by a quarter, its long axis lies along ours; seen from ours it lies where the exponential leads to it.
        let turned = among(&best, &[best, hypothesis(0.0, std::f64::consts::FRAC_PI_2, 0.6)]).unwrap();
        assert!((turned.covariance().m11 - 0.025).abs() < 1e-9, "{}", turned.covariance());
    }
}
