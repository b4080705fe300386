//! The particles: an array of poses beside arrays of weights.
//!
//! A pose is kept whole (x, y, cosine, sine: half a cache line), because every pass over the set reads one pose at a
//! time; what is vectorised is the work within a particle, over the beams of a scan. Weights live beside the poses, as
//! logarithms and as normalised numbers: products of many small likelihoods would underflow.

use super::Resampler;
use agv_core::{
    Error, check,
    compute::{CHUNK, Par, Stream},
    geometry::{LieGroup, Se2},
};

/// Weighted samples of `map_from_base`.
///
/// The number of particles is fixed; all memory is allocated by [`new`](Self::new).
///
/// ```
/// use agv_core::compute::Par;
/// use agv_core::geometry::Se2;
/// use agv_filters::particle::ParticleSet;
///
/// let mut set = ParticleSet::new(vec![Se2::new(0.0, 0.0, 0.0), Se2::new(1.0, 0.0, 0.0)])?;
/// // The second particle explains the observation three times as well.
/// let summary = set.reweigh(&[0.0, 3_f64.ln()], Par::Seq).expect("likelihoods are finite");
/// assert!((set.weights()[1] - 0.75).abs() < 1e-12);
/// assert!((summary.effective_sample_size - 1.6).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ParticleSet {
    poses: Vec<Se2>,
    /// Normalised: their exponentials sum to one.
    log_weights: Vec<f64>,
    /// Exponentials of `log_weights`.
    weights: Vec<f64>,
    /// Where resampling writes, before the two change places.
    spare: Vec<Se2>,
    ancestors: Vec<u32>,
}

impl PartialEq for ParticleSet {
    /// Poses and weights; scratch memory does not count.
    fn eq(&self, other: &Self) -> bool {
        self.poses == other.poses && self.log_weights == other.log_weights && self.weights == other.weights
    }
}

/// What the weights of a set say of its health.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WeightSummary {
    /// `N_eff = 1 / Σ w²`, between 1 and the number of particles (paper 000, Eq. 7).
    pub effective_sample_size: f64,
    /// Greatest normalised weight.
    pub max_weight: f64,
    /// Logarithm of the mean likelihood of the last observation over the belief; low where nothing explains it.
    pub log_evidence: f64,
}

impl WeightSummary {
    /// The summary of `count` equal weights.
    pub fn uniform(count: usize) -> Self {
        let count = count.max(1) as f64;
        Self { effective_sample_size: count, max_weight: count.recip(), log_evidence: 0.0 }
    }
}

impl ParticleSet {
    /// Most particles that a set may have: an ancestor's index then fits 32 bits with room to spare.
    pub const MAX_PARTICLES: usize = 1 << 24;

    /// A set of equally weighted poses.
    ///
    /// # Errors
    /// No poses, more than [`MAX_PARTICLES`](Self::MAX_PARTICLES), or a pose that is not finite.
    pub fn new(poses: Vec<Se2>) -> Result<Self, Error> {
        let count = Self::check_count(poses.len())?;
        for pose in &poses {
            check::all_finite("particle", &[pose.x(), pose.y(), pose.yaw()])?;
        }
        let mut set = Self {
            spare: vec![Se2::identity(); count],
            log_weights: vec![0.0; count],
            weights: vec![0.0; count],
            ancestors: vec![0; count],
            poses,
        };
        set.equalize();
        Ok(set)
    }

    /// Accepts a number of particles.
    ///
    /// # Errors
    /// Zero, or more than [`MAX_PARTICLES`](Self::MAX_PARTICLES).
    pub fn check_count(count: usize) -> Result<usize, Error> {
        match count {
            0 => Err(Error::Empty { name: "particles" }),
            len if len > Self::MAX_PARTICLES => {
                Err(Error::TooMany { name: "particles", len, max: Self::MAX_PARTICLES })
            }
            len => Ok(len),
        }
    }

    /// Number of particles, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a set has at least one particle")]
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// The poses `map_from_base`.
    pub fn poses(&self) -> &[Se2] {
        &self.poses
    }

    /// Normalised weights.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Logarithms of the normalised weights.
    pub fn log_weights(&self) -> &[f64] {
        &self.log_weights
    }

    /// Writes spare poses with `fill(index of chunk, poses, spare poses)`.
    pub(super) fn fill_spare(&mut self, par: Par, fill: impl Fn(usize, &[Se2], &mut [Se2]) + Sync) {
        let pairs = (self.poses.as_slice(), self.spare.as_mut_slice());
        par.for_each_chunk(pairs, CHUNK, |chunk, (poses, spare): (&[Se2], &mut [Se2])| fill(chunk, poses, spare));
    }

    /// The spare poses, as they were written last.
    pub(super) fn spare(&self) -> &[Se2] {
        &self.spare
    }

    /// Makes the spare poses the set's; weights stay.
    pub(super) fn adopt_spare(&mut self) {
        std::mem::swap(&mut self.poses, &mut self.spare);
    }

    /// Sets the weights as a checkpoint had them, bit for bit.
    #[cfg(feature = "serde")]
    pub(super) fn restore_weights(&mut self, log_weights: &[f64], weights: &[f64]) -> Result<(), Error> {
        check::length("log_weights", log_weights.len(), self.len())?;
        check::length("weights", weights.len(), self.len())?;
        for (&log_weight, &weight) in log_weights.iter().zip(weights) {
            check::in_range("weight", weight, 0.0, 1.0 + 1e-9)?;
            check::in_range("weight less the exponential of its logarithm", weight - log_weight.exp(), -1e-9, 1e-9)?;
        }
        check::in_range("sum of weights", weights.iter().sum(), 1.0 - 1e-6, 1.0 + 1e-6)?;
        self.log_weights.copy_from_slice(log_weights);
        self.weights.copy_from_slice(weights);
        Ok(())
    }

    /// Writes new poses with `fill(index of chunk, chunk)`, and takes them if `accept` does; the set is else as it was.
    ///
    /// Returns whether they were taken; weights are then equal.
    pub(super) fn refill(
        &mut self,
        par: Par,
        fill: impl Fn(usize, &mut [Se2]) + Sync,
        accept: impl Fn(&[Se2]) -> bool,
    ) -> bool {
        par.for_each_chunk(self.spare.as_mut_slice(), CHUNK, |chunk, poses: &mut [Se2]| fill(chunk, poses));
        let accepted = accept(&self.spare);
        if accepted {
            std::mem::swap(&mut self.poses, &mut self.spare);
            self.equalize();
        }
        accepted
    }

    /// Gives every particle the same weight.
    pub fn equalize(&mut self) {
        let weight = (self.len() as f64).recip();
        self.weights.fill(weight);
        self.log_weights.fill(weight.ln());
    }

    /// Multiplies each weight by the exponential of its log-likelihood, and normalises.
    ///
    /// None, with the weights as they were, if the slice has another length than the set, if a log-likelihood is NaN
    /// or +∞, or if every particle is impossible (−∞).
    pub fn reweigh(&mut self, log_likelihoods: &[f64], par: Par) -> Option<WeightSummary> {
        let count = self.len();
        let old = &self.log_weights;
        if log_likelihoods.len() != count {
            return None;
        }
        // NaN must not hide behind the comparison of a maximum: it turns the chunk's peak into +∞, which is refused.
        let peak = par.map_reduce(
            count.div_ceil(CHUNK),
            |chunk| {
                let (old, new) = (chunk_of(old, chunk), chunk_of(log_likelihoods, chunk));
                old.iter().zip(new).fold(f64::NEG_INFINITY, |peak, (&a, &b)| {
                    let sum = a + b;
                    if sum <= peak {
                        peak
                    } else if sum > peak {
                        sum
                    } else {
                        f64::INFINITY
                    }
                })
            },
            f64::max,
        )?;
        if !peak.is_finite() {
            return None;
        }
        let data = (self.log_weights.as_mut_slice(), self.weights.as_mut_slice(), log_likelihoods);
        par.for_each_chunk(
            data,
            CHUNK,
            |_, (log_weights, weights, log_likelihoods): (&mut [f64], &mut [f64], &[f64])| {
                for ((log_weight, weight), &log_likelihood) in log_weights.iter_mut().zip(weights).zip(log_likelihoods)
                {
                    *log_weight = *log_weight + log_likelihood - peak;
                    *weight = log_weight.exp();
                }
            },
        );
        let weights = &self.weights;
        let (sum, squares) = par.map_reduce(
            count.div_ceil(CHUNK),
            |chunk| chunk_of(weights, chunk).iter().fold((0.0, 0.0), |(sum, squares), &w| (sum + w, squares + w * w)),
            |a, b| (a.0 + b.0, a.1 + b.1),
        )?;
        let (scale, shift) = (1.0 / sum, sum.ln());
        self.weights.iter_mut().for_each(|weight| *weight *= scale);
        self.log_weights.iter_mut().for_each(|log_weight| *log_weight -= shift);
        Some(WeightSummary {
            effective_sample_size: sum * sum / squares,
            max_weight: scale,
            log_evidence: peak + shift,
        })
    }

    /// Draws a new set in proportion to the weights; the weights are equal afterwards.
    pub fn resample(&mut self, resampler: &impl Resampler, stream: &mut Stream, par: Par) {
        resampler.resample(&self.weights, stream, &mut self.ancestors);
        let poses = &self.poses;
        let data = (self.spare.as_mut_slice(), self.ancestors.as_slice());
        par.for_each_chunk(data, CHUNK, |_, (spare, ancestors): (&mut [Se2], &[u32])| {
            for (pose, &ancestor) in spare.iter_mut().zip(ancestors) {
                *pose = poses[ancestor as usize];
            }
        });
        std::mem::swap(&mut self.poses, &mut self.spare);
        self.equalize();
    }
}

/// The entries of chunk `index`.
pub(super) fn chunk_of<T>(values: &[T], index: usize) -> &[T] {
    let start = (index * CHUNK).min(values.len());
    &values[start..(start + CHUNK).min(values.len())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::Systematic;
    use agv_core::compute::Seed;

    fn line(count: usize) -> ParticleSet {
        ParticleSet::new((0..count).map(|i| Se2::new(i as f64, 0.0, 0.0)).collect()).unwrap()
    }

    #[test]
    fn bad_sets_are_named() {
        assert_eq!(ParticleSet::new(vec![]), Err(Error::Empty { name: "particles" }));
        assert!(ParticleSet::new(vec![Se2::new(f64::NAN, 0.0, 0.0)]).is_err());
        assert!(ParticleSet::check_count(ParticleSet::MAX_PARTICLES + 1).is_err());
    }

    #[test]
    fn likelihoods_far_below_the_smallest_number_still_order_the_particles() {
        let mut set = line(3);
        let summary = set.reweigh(&[-9000.0, -9000.0 + 2_f64.ln(), -9000.0], Par::Seq).unwrap();
        assert!((set.weights()[1] - 0.5).abs() < 1e-12);
        assert!((summary.max_weight - 0.5).abs() < 1e-12);
        assert!((summary.log_evidence - (-9000.0 + (4.0_f64 / 3.0).ln())).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_a_likelihood_changes_nothing() {
        let mut set = line(600);
        set.reweigh(&(0..600).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>(), Par::Seq).unwrap();
        let before = set.clone();
        let mut with = |index: usize, value: f64| {
            let mut values = vec![0.0; 600];
            values[index] = value;
            set.reweigh(&values, Par::Seq)
        };
        assert_eq!(with(3, f64::NAN), None);
        assert_eq!(with(599, f64::NAN), None);
        assert_eq!(with(300, f64::INFINITY), None);
        assert_eq!(set.reweigh(&vec![f64::NEG_INFINITY; 600], Par::Seq), None);
        assert_eq!(set.reweigh(&[0.0], Par::Seq), None);
        assert_eq!(set, before);
    }

    #[test]
    fn impossible_particles_do_not_survive_resampling() {
        let mut set = line(1000);
        let log_likelihoods: Vec<f64> = (0..1000).map(|i| if i % 3 == 0 { 0.0 } else { f64::NEG_INFINITY }).collect();
        set.reweigh(&log_likelihoods, Par::Seq).unwrap();
        set.resample(&Systematic, &mut Seed(1).stream(0, 0), Par::Seq);
        assert!(set.poses().iter().all(|pose| pose.x() % 3.0 == 0.0));
        assert_eq!(set.weights()[0], 0.001);
    }
}
