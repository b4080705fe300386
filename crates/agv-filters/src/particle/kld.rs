//! How many particles a belief needs: KLD sampling (Fox 2003, *Adapting the sample size in particle filters through
//! KLD-sampling*; paper 001, Eq. 8 in its right form).
//!
//! If `n` samples are drawn from a distribution over `k` bins, their Kullback–Leibler distance from it stays below `ε`
//! with probability `1 - δ` where
//!
//! ```text
//! n = χ²_{1-δ}(k - 1) / (2 ε) ≈ (k - 1) / (2 ε) (1 - 2 / (9 (k - 1)) + z_{1-δ} sqrt(2 / (9 (k - 1))))³
//! ```
//!
//! The number of bins is found as the samples are drawn: particles are drawn from the weighted set one by one, and as long
//! as they hit new bins the number that is needed grows.

use super::{
    ParticleSet, PoseBins, PoseHistogram, SampleSize,
    chi_square::{normal_quantile, wilson_hilferty},
};
use agv_core::{Error, check, compute::Stream, geometry::Se2, metrics::chi_square_quantile};
use rand::RngExt;

/// How the quantile of the bound is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum KldQuantile {
    /// By the approximation of Wilson and Hilferty, within 0.4 % from five bins on for doubts of 1 to 5 %; 3 % too many at a doubt of
    /// 1e-4.
    #[default]
    WilsonHilferty,
    /// To rounding, by Newton's method.
    Exact,
}

/// The bound on the number of particles, and its probabilities.
///
/// ```
/// use agv_filters::particle::{KldBound, KldQuantile};
///
/// let bound = KldBound::default();
/// assert_eq!([10, 100, 500].map(|bins| bound.particles(bins)), [217, 1347, 5755]);
/// let exact = KldBound { quantile: KldQuantile::Exact, ..bound };
/// assert_eq!([10, 100, 500].map(|bins| exact.particles(bins)), [217, 1347, 5755]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct KldBound {
    /// `ε`: Kullback–Leibler distance that is allowed, in nats.
    pub error: f64,
    /// `δ`: probability that it is exceeded.
    pub doubt: f64,
    /// How the quantile is computed.
    pub quantile: KldQuantile,
}

impl Default for KldBound {
    /// 0.05 with 99 %: the values of `nav2_amcl` and of paper 001.
    fn default() -> Self {
        Self { error: 0.05, doubt: 0.01, quantile: KldQuantile::default() }
    }
}

impl KldBound {
    /// Checks both numbers.
    ///
    /// # Errors
    /// An error that is not finite and positive, or a doubt outside (0, 1).
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("kld error", self.error)?;
        check::open_probability("kld doubt", self.doubt)?;
        Ok(())
    }

    /// Particles that a belief over so many bins needs; one for one bin, which nothing can be wrong about.
    pub fn particles(&self, bins: usize) -> usize {
        if bins < 2 {
            return 1;
        }
        let degrees = (bins - 1) as f64;
        let approximate = || wilson_hilferty(degrees, -normal_quantile(self.doubt));
        let quantile = match self.quantile {
            KldQuantile::WilsonHilferty => approximate(),
            // Refused for a doubt that was never validated only.
            KldQuantile::Exact => chi_square_quantile(degrees, 1.0 - self.doubt).unwrap_or_else(|_| approximate()),
        };
        (quantile / (2.0 * self.error)).ceil().max(1.0) as usize
    }
}

/// Parameters of [`KldSampling`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct KldParams {
    /// Fewest particles.
    pub min_particles: usize,
    /// Most particles: the room that a filter has.
    pub max_particles: usize,
    /// The bound.
    pub bound: KldBound,
    /// Bins that are counted.
    pub bins: PoseBins,
}

impl Default for KldParams {
    /// At least 400 particles (500 are `nav2_amcl`'s; a tracker has needed fewer since its estimate is brought to the peak of the
    /// scan); at most 20 000, which a global start in a hall of some hundred square metres
    /// needs, while the bound itself keeps a tracked pose at the lower end.
    fn default() -> Self {
        Self { min_particles: 400, max_particles: 20_000, bound: KldBound::default(), bins: PoseBins::default() }
    }
}

impl KldParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// Zero or more than [`ParticleSet::MAX_PARTICLES`] particles, fewer at most than at least, or a bound or bins out of
    /// range.
    pub fn validate(&self) -> Result<(), Error> {
        ParticleSet::check_count(self.min_particles)?;
        ParticleSet::check_count(self.max_particles)?;
        check::in_range("min_particles", self.min_particles as f64, 1.0, self.max_particles as f64)?;
        self.bound.validate()?;
        self.bins.validate()
    }
}

/// As many particles as keep the error of the sample within a bound: few where the pose is known, many where it is not.
///
/// The bins are counted over trial draws from the weighted set, as in Fox's algorithm; how the set itself is then drawn is
/// the resampler's matter. Expected O(particles drawn), with all memory allocated at construction.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_filters::particle::{KldParams, KldSampling, ParticleSet, SampleSize};
///
/// let mut size = KldSampling::new(KldParams { min_particles: 50, ..Default::default() })?;
/// let known = ParticleSet::new(vec![Se2::new(1.1, 2.2, 0.1); 5000])?;
/// assert_eq!(size.sample_size(&known, &mut Seed(1).stream(0, 0)), 50);
/// let vague = ParticleSet::new((0..5000).map(|i| Se2::new(f64::from(i % 100) * 0.1, 0.2, 0.1)).collect())?;
/// assert!((200..1000).contains(&size.sample_size(&vague, &mut Seed(1).stream(0, 0))));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct KldSampling {
    params: KldParams,
    histogram: PoseHistogram,
    /// Running sums of the weights.
    cumulative: Vec<f64>,
    /// First particle whose running sum reaches the i-th of as many equal parts of the whole.
    guide: Vec<u32>,
}

impl KldSampling {
    /// Checks the parameters and allocates.
    ///
    /// # Errors
    /// Parameters that [`validate`](KldParams::validate) refuses.
    pub fn new(params: KldParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            params,
            histogram: PoseHistogram::new(params.bins)?.with_capacity(params.max_particles),
            cumulative: Vec::with_capacity(params.max_particles),
            guide: Vec::with_capacity(params.max_particles),
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &KldParams {
        &self.params
    }

    /// Bins that the last trial draws hit.
    pub const fn bins(&self) -> usize {
        self.histogram.len()
    }

    /// Prepares draws in proportion to the weights by running sums and a table of where to begin in them (Chen and Asau
    /// 1974): expected constant time a draw. Returns the whole weight.
    fn prepare(&mut self, weights: &[f64]) -> f64 {
        self.cumulative.clear();
        let mut total = 0.0;
        self.cumulative.extend(weights.iter().map(|weight| {
            total += weight;
            total
        }));
        self.guide.clear();
        let part = total / weights.len() as f64;
        let mut particle = 0;
        self.guide.extend((0..weights.len()).map(|i| {
            while particle + 1 < weights.len() && self.cumulative[particle] <= i as f64 * part {
                particle += 1;
            }
            particle as u32
        }));
        total
    }

    /// The particle at a share of the whole weight, in [0, 1).
    fn particle_at(&self, share: f64, total: f64) -> usize {
        let count = self.cumulative.len();
        let mut particle = self.guide[((share * count as f64) as usize).min(count - 1)] as usize;
        while particle + 1 < count && self.cumulative[particle] <= share * total {
            particle += 1;
        }
        particle
    }
}

impl SampleSize for KldSampling {
    fn most(&self) -> Option<usize> {
        Some(self.params.max_particles)
    }

    fn sample_size(&mut self, particles: &ParticleSet<Se2>, stream: &mut Stream) -> usize {
        self.sample_size_with(particles, &[], 0.0, stream)
    }

    /// Counts the bins of all that is drawn, as `nav2_amcl` does: particles that search raise the number.
    fn sample_size_with(
        &mut self,
        particles: &ParticleSet<Se2>,
        fresh: &[Se2],
        share: f64,
        stream: &mut Stream,
    ) -> usize {
        let KldParams { min_particles, max_particles, bound, .. } = self.params;
        let total = self.prepare(particles.weights());
        self.histogram.clear();
        let (mut drawn, mut needed, mut counted) = (0, min_particles, 0);
        let mut fresh = fresh.iter();
        while drawn < needed {
            // Elsewhere as often as its share says; from the old set where nothing elsewhere is left.
            let is_fresh = (drawn as f64 * share).floor() < ((drawn + 1) as f64 * share).floor();
            let elsewhere = if is_fresh { fresh.next() } else { None };
            let pose = elsewhere.unwrap_or_else(|| {
                let particle = self.particle_at(stream.random(), total);
                &particles.states()[particle]
            });
            self.histogram.insert(pose, 1.0);
            drawn += 1;
            // The bound grows with the bins, so that it need not be asked before the last answer is reached.
            if drawn == needed && self.histogram.len() > counted {
                counted = self.histogram.len();
                needed = bound.particles(counted).clamp(needed, max_particles);
            }
        }
        drawn
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::{Par, Seed};

    #[test]
    fn the_approximation_keeps_what_it_promises() {
        for (doubt, bound) in [(0.01, 0.003), (0.05, 0.004)] {
            let z = normal_quantile(1.0 - doubt);
            for bins in (5..200).chain([500, 1000, 5000, 50_000]) {
                let degrees = f64::from(bins - 1);
                let exact = chi_square_quantile(degrees, 1.0 - doubt).unwrap();
                let error = (wilson_hilferty(degrees, z) / exact - 1.0).abs();
                assert!(error < bound, "{doubt} {bins}: {error}");
            }
        }
        // As the sheet of paper 001 says: 0.7 % low at two bins.
        let low = wilson_hilferty(1.0, normal_quantile(0.99)) / chi_square_quantile(1.0, 0.99).unwrap();
        assert!((0.99..0.995).contains(&low), "{low}");
    }

    /// The values that the sheet of paper 001 measured, and what its misprints would give.
    #[test]
    fn the_bound_is_the_right_form_of_the_paper() {
        let bound = |bins| KldBound::default().particles(bins);
        for (bins, particles, z_inside_the_root) in [(10, 217, 161), (100, 1347, 1213), (500, 5754, 5480)] {
            assert!(bound(bins).abs_diff(particles) <= 1 && bound(bins) > z_inside_the_root, "{bins}: {}", bound(bins));
        }
    }

    #[test]
    fn one_bin_needs_one_particle_and_more_bins_need_more() {
        for quantile in [KldQuantile::WilsonHilferty, KldQuantile::Exact] {
            let bound = KldBound { quantile, ..Default::default() };
            assert_eq!((bound.particles(0), bound.particles(1)), (1, 1));
            let counts: Vec<usize> = (1..300).map(|bins| bound.particles(bins)).collect();
            assert!(counts.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }

    /// Fox's condition holds at the number that is returned, and does not before.
    #[test]
    fn draws_stop_where_the_bound_is_met() {
        let poses: Vec<Se2> =
            (0..4000).map(|i| Se2::new(f64::from(i % 60) * 0.5, f64::from(i % 7) * 0.5, 0.1)).collect();
        let set = ParticleSet::new(poses).unwrap();
        for seed in 0..20 {
            let params = KldParams { min_particles: 10, max_particles: 100_000, ..Default::default() };
            let mut size = KldSampling::new(params).unwrap();
            let count = size.sample_size(&set, &mut Seed(seed).stream(0, 0));
            assert!(count >= params.bound.particles(size.bins()));
            // One draw less leaves at most one bin less.
            assert!(count - 1 < params.bound.particles(size.bins()), "{count} {}", size.bins());
        }
    }

    #[test]
    fn bins_without_weight_do_not_count() {
        let mut set = ParticleSet::new((0..2000).map(|i| Se2::new(f64::from(i), 0.0, 0.0)).collect()).unwrap();
        let likelihoods: Vec<f64> = (0..2000).map(|i| if i % 100 == 7 { 0.0 } else { f64::NEG_INFINITY }).collect();
        set.reweigh(&likelihoods, Par::Seq).unwrap();
        let mut size = KldSampling::new(KldParams { min_particles: 5, ..Default::default() }).unwrap();
        let count = size.sample_size(&set, &mut Seed(3).stream(0, 0));
        assert!(size.bins() <= 20 && count <= KldBound::default().particles(20), "{count} {}", size.bins());
        assert!(size.bins() >= 18, "of twenty bins with 350 draws none is missed but by a chance of 1e-6");
    }

    /// Trial draws follow the weights: chi-square over many.
    #[test]
    fn trial_draws_are_unbiased() {
        let mut set = ParticleSet::new((0..8).map(|i| Se2::new(f64::from(i), 0.0, 0.0)).collect()).unwrap();
        let shares = [0.0, 0.3, 0.01, 0.2, 0.0, 0.09, 0.4, 0.0_f64];
        set.reweigh(&shares.map(f64::ln), Par::Seq).unwrap();
        let mut size = KldSampling::new(KldParams::default()).unwrap();
        let total = size.prepare(set.weights());
        let (mut counts, mut stream) = ([0.0; 8], Seed(5).stream(0, 0));
        let draws = 100_000.0;
        (0..100_000).for_each(|_| counts[size.particle_at(stream.random(), total)] += 1.0);
        let scores = counts.iter().zip(shares).filter(|(_, share)| *share > 0.0);
        let statistic: f64 = scores.map(|(n, share)| (n - share * draws).powi(2) / (share * draws)).sum();
        assert!(counts[0] + counts[4] + counts[7] == 0.0);
        // 99.9 % quantile of chi-square with four degrees of freedom.
        assert!(statistic < 18.5, "{statistic}");
    }

    #[test]
    fn the_limits_are_kept_and_the_least_number_is_drawn_of_one_particle() {
        let wide = ParticleSet::new((0..3000).map(|i| Se2::new(f64::from(i), 0.0, 0.0)).collect()).unwrap();
        let params = KldParams { min_particles: 20, max_particles: 777, ..Default::default() };
        let mut size = KldSampling::new(params).unwrap();
        assert_eq!(size.sample_size(&wide, &mut Seed(1).stream(0, 0)), 777);
        let single = ParticleSet::new(vec![Se2::new(0.0, 0.0, 0.0)]).unwrap();
        assert_eq!(size.sample_size(&single, &mut Seed(1).stream(0, 0)), 20);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = KldParams::default();
        for bad in [
            KldParams { min_particles: 0, ..good },
            KldParams { max_particles: 0, ..good },
            KldParams { max_particles: usize::MAX, ..good },
            KldParams { min_particles: 30_000, ..good },
            KldParams { bound: KldBound { error: 0.0, ..good.bound }, ..good },
            KldParams { bound: KldBound { error: f64::NAN, ..good.bound }, ..good },
            KldParams { bound: KldBound { doubt: 0.0, ..good.bound }, ..good },
            KldParams { bound: KldBound { doubt: 1.0, ..good.bound }, ..good },
            KldParams { bins: PoseBins { position: -1.0, ..good.bins }, ..good },
        ] {
            assert!(KldSampling::new(bad).is_err(), "{bad:?}");
        }
    }
}
