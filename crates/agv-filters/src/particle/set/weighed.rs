//! Moving, weighing and summing up in one pass over the particles.

use super::{ParticleSet, WeightSums};
use crate::particle::moments::MomentSums;
use agv_core::{
    Error,
    compute::{CHUNK, Par},
    geometry::{Se2, UncertainPose},
};
use pulp::Arch;

/// What is known of a set that was moved and weighed, before the weights are normalised.
#[derive(Debug, Clone, Copy)]
pub(in crate::particle) struct WeighedSums {
    pub(in crate::particle) weights: WeightSums,
    /// In the unit of the weights.
    moments: MomentSums,
}

impl WeighedSums {
    fn with(self, other: Self) -> Self {
        let weights = self.weights.with(other.weights);
        let [a, b] = [self, other].map(|part| part.moments.times(part.weights.factor(weights.peak())));
        Self { weights, moments: a.with(&b) }
    }

    /// Mean and covariance of the weighed set.
    ///
    /// # Errors
    /// As [`ParticleSet::estimate`].
    pub(in crate::particle) fn estimate(&self) -> Result<UncertainPose<Se2>, Error> {
        self.moments.moments()
    }
}

impl ParticleSet<Se2> {
    /// Writes a new pose and a log-likelihood for each particle with `write(index of chunk, poses, new poses, log-likelihoods)`, as
    /// [`propose`](Self::propose), and sums up what weights and moments would be with them.
    pub(in crate::particle) fn propose_weighed(
        &mut self,
        log_likelihoods: &mut [f64],
        par: Par,
        arch: Arch,
        write: impl Fn(usize, &[Se2], &mut [Se2], &mut [f64]) + Sync,
    ) -> Option<WeighedSums> {
        let count = self.count;
        let pivot = self.pivot();
        let data = (&self.states[..count], &mut self.spare[..count], log_likelihoods, &self.log_weights[..count]);
        par.map_reduce_chunks(
            data,
            CHUNK,
            |chunk, (poses, moved, new, old): (&[Se2], &mut [Se2], &mut [f64], &[f64])| {
                write(chunk, poses, moved, new);
                let mut in_unit = [0.0; CHUNK];
                let weights = WeightSums::with_weights(old, new, &mut in_unit, arch);
                WeighedSums { weights, moments: MomentSums::of(moved, &in_unit[..moved.len()], pivot, arch) }
            },
            WeighedSums::with,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::LieGroup;

    /// Chunks whose peaks differ by far, one of them impossible: what is summed up on the way is what the weighed set says.
    #[test]
    fn sums_on_the_way_are_those_of_the_weighed_set() {
        let poses = (0..1000).map(|i| Se2::new(0.01 * f64::from(i % 31), 5.0, 0.001 * f64::from(i % 17))).collect();
        let mut set = ParticleSet::new(poses).unwrap();
        let (mut logs, shift) = (vec![0.0; 1000], Se2::new(0.3, -0.1, 0.2));
        let sums = set.propose_weighed(&mut logs, Par::threads(3), Arch::new(), |chunk, poses, moved, logs| {
            for (i, ((moved, pose), log)) in moved.iter_mut().zip(poses).zip(logs).enumerate() {
                *moved = *pose * shift;
                *log = if chunk == 2 { f64::NEG_INFINITY } else { -4.0 * chunk as f64 - (i % 13) as f64 };
            }
        });
        let sums = sums.unwrap();
        set.take_in(&logs, &sums.weights, Par::Seq, Arch::new()).unwrap();
        set.adopt();
        let (on_the_way, after) = (sums.estimate().unwrap(), set.estimate(Par::Seq).unwrap());
        assert!(on_the_way.mean().minus(after.mean()).norm() < 1e-12);
        assert!((on_the_way.covariance() - after.covariance()).amax() < 1e-12);
    }
}
