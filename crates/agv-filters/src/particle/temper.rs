//! Tempering: how much of an observation a set can bear.
//!
//! A set that is spread over a building holds few particles near the right pose, and none of them is exactly there: the full
//! likelihood of a scan leaves the one that happens to fit best in some like place, and forgets the others for good. So the
//! likelihood is taken to a power `τ ≤ 1` at which a given share of the particles stays effective (the step of annealed
//! particle filters: Deutscher and Reid 2005; of tempered sequential samplers: Del Moral, Doucet and Jasra 2006). The next
//! observations tell the places apart.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{
    ParticleSet, WeightSummary,
    set::{WeightSums, chunk_of},
};
use agv_core::compute::{CHUNK, Par};
use pulp::{Arch, Simd, WithSimd};

/// Most steps of the search for the power; five are usual.
const STEPS: usize = 12;

/// A power that leaves at most this many times as many particles effective as asked for is good enough; it is aimed at half of what
/// is above one.
const GOOD: f64 = 1.03;

/// A set of more chunks is looked at by every eighth first.
const LARGE: usize = 64;
const SAMPLED: usize = 8;

impl ParticleSet {
    /// Takes back so much of an observation that was just taken in by [`reweigh`](Self::reweigh) with these log-likelihoods
    /// that `least` particles are effective; the log-likelihoods are overwritten. The logarithm of the evidence stays that of the
    /// whole observation. Returns the power that is left as well.
    ///
    /// Nothing changes if as many are effective already. O(particles) for each of some three steps.
    ///
    /// Where log-likelihoods are spread with the variance `s²`, about `n exp(-τ² s²)` particles are effective: the search is one for
    /// the root of `ln N_eff` as a function of `τ²`, by false position in the Illinois form (Dowell and Jarratt 1971). In a large set it
    /// begins where every eighth chunk has it.
    pub(super) fn temper(
        &mut self,
        log_likelihoods: &mut [f64],
        summary: WeightSummary,
        least: f64,
        par: Par,
    ) -> (WeightSummary, f64) {
        if summary.effective_sample_size >= least {
            return (summary, 1.0);
        }
        let count = self.len() as f64;
        let ends = [count, summary.effective_sample_size].map(|effective| effective / least);
        let is_large = self.len() > LARGE * CHUNK;
        let begin = is_large
            .then(|| search(ends, None, |power| self.effective_at(log_likelihoods, power, SAMPLED, par) / least))
            .filter(|&power| power > 0.0);
        let power = search(ends, begin, |power| self.effective_at(log_likelihoods, power, 1, par) / least);
        for value in log_likelihoods.iter_mut() {
            // What is impossible stays so.
            *value = if value.is_finite() { (power - 1.0) * *value } else { 0.0 };
        }
        let tempered = self.reweigh(log_likelihoods, par);
        let tempered =
            tempered.map_or(summary, |tempered| WeightSummary { log_evidence: summary.log_evidence, ..tempered });
        (tempered, power)
    }

    /// Effective number of particles if the observation, which the weights hold, counted with this power; as the first of each `stride`
    /// chunks have it.
    fn effective_at(&self, log_likelihoods: &[f64], power: f64, stride: usize, par: Par) -> f64 {
        let (log_weights, arch) = (self.log_weights(), Arch::new());
        let chunks = self.len().div_ceil(CHUNK).div_ceil(stride);
        let of_chunk = |index: usize| {
            let [log_weights, log_likelihoods] =
                [log_weights, log_likelihoods].map(|values| chunk_of(values, index * stride));
            let mut terms = [0.0; CHUNK];
            let terms = &mut terms[..log_weights.len()];
            arch.dispatch(Tempered { log_weights, log_likelihoods, power, terms });
            (WeightSums::of(terms, &[0.0; CHUNK][..terms.len()], arch), terms.len())
        };
        let sums = par.map_reduce(chunks, of_chunk, |(a, m), (b, n)| (a.with(b), m + n));
        sums.map_or(0.0, |(sums, seen)| sums.effective_sample_size() * self.len() as f64 / seen as f64)
    }
}

/// The power of an observation that leaves as many effective as are asked for, or a few more, of `ratio(power)` as many. Without it
/// (power zero) and with all of it there are as many times as many as the `ends` say; `begin` is tried first.
fn search(ends: [f64; 2], begin: Option<f64>, ratio: impl Fn(f64) -> f64) -> f64 {
    let above = |ratio: f64| (ratio / (0.5 * (1.0 + GOOD))).max(f64::MIN_POSITIVE).ln();
    // `τ²`, and how far above what is aimed at.
    let (mut low, mut high) = ((0.0, above(ends[0])), (1.0, above(ends[1])));
    let (origin, mut last) = (low.1, (0.0, low.1));
    let mut last_was_low = None;
    for step in 0..STEPS {
        let share = low.1 / (low.1 - high.1);
        let share = if share > 0.01 { share.min(0.99) } else { 0.01 };
        let square = match (step, begin) {
            (0, Some(power)) => power * power,
            // The whole observation lies far beyond, where the curve is flat: the line from the origin is the better one.
            (1, Some(_)) => (last.0 * origin / (origin - last.1)).clamp(low.0, high.0),
            _ => low.0 + share * (high.0 - low.0),
        };
        let ratio = ratio(square.sqrt());
        last = (square, above(ratio));
        let is_low = ratio >= 1.0;
        // An end that stays draws less and less.
        let keeps = last_was_low == Some(is_low);
        if is_low {
            (low, high.1) = (last, if keeps { 0.5 * high.1 } else { high.1 });
            if ratio <= GOOD {
                break;
            }
        } else {
            (high, low.1) = (last, if keeps { 0.5 * low.1 } else { low.1 });
        }
        last_was_low = Some(is_low);
    }
    low.0.sqrt()
}

/// Logarithms of the weights that hold the observation, if it counted with a power.
struct Tempered<'a> {
    log_weights: &'a [f64],
    log_likelihoods: &'a [f64],
    power: f64,
    terms: &'a mut [f64],
}

impl WithSimd for Tempered<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let values = self.log_weights.iter().zip(self.log_likelihoods);
        for (term, (&log_weight, &likelihood)) in self.terms.iter_mut().zip(values) {
            let rest = log_weight + (self.power - 1.0) * likelihood;
            // What is impossible stays so.
            *term = if likelihood > f64::NEG_INFINITY { rest } else { f64::NEG_INFINITY };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::Se2;
    use proptest::prelude::*;

    fn set(count: usize) -> ParticleSet {
        ParticleSet::new((0..count).map(|i| Se2::new(i as f64, 0.0, 0.0)).collect()).unwrap()
    }

    proptest! {
        /// As many are effective as were asked for, the order of the particles is kept, and the weights are the likelihoods' power.
        #[test]
        fn a_power_is_found(logs in prop::collection::vec(-300.0..0.0_f64, 20..400), share in 0.02..0.5_f64) {
            let (mut set, mut values) = (set(logs.len()), logs.clone());
            let summary = set.reweigh(&values, Par::Seq).unwrap();
            let least = share * logs.len() as f64;
            let (tempered, power) = set.temper(&mut values, summary, least, Par::Seq);
            prop_assert_eq!(tempered.log_evidence, summary.log_evidence);
            prop_assert!(tempered.effective_sample_size >= least * 0.999);
            if summary.effective_sample_size < least {
                // Hardly more are, unless one weight decides.
                prop_assert!(tempered.effective_sample_size < 1.35 * least + 1.0, "{} {least}", tempered.effective_sample_size);
                let slope = (set.log_weights()[1] - set.log_weights()[0]) / (logs[1] - logs[0]);
                prop_assert!((0.0..1.0).contains(&slope) && (slope - power).abs() < 1e-6);
                for i in 1..logs.len() {
                    let other = (set.log_weights()[i] - set.log_weights()[0]) - slope * (logs[i] - logs[0]);
                    prop_assert!(other.abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn what_is_impossible_stays_so() {
        let (mut set, mut values) = (set(4), [0.0, -50.0, f64::NEG_INFINITY, -50.0]);
        let summary = set.reweigh(&values, Par::Seq).unwrap();
        let (tempered, _) = set.temper(&mut values, summary, 2.5, Par::Seq);
        assert!(tempered.effective_sample_size >= 2.5 && set.weights()[2] == 0.0, "{:?}", set.weights());
        // More than are possible cannot be had: nothing of the observation is left but that.
        let (mut set, mut values) = (self::set(4), [0.0, -50.0, f64::NEG_INFINITY, -50.0]);
        let summary = set.reweigh(&values, Par::Seq).unwrap();
        let (tempered, _) = set.temper(&mut values, summary, 4.0, Par::Seq);
        assert!((tempered.effective_sample_size - 3.0).abs() < 1e-9 && set.weights()[2] == 0.0);
    }

    /// A large set is sampled first, by chunks; a sample that misleads costs steps and changes nothing else. Threads change no bit.
    #[test]
    fn large_sets_are_sampled_first() {
        let count = 20_000;
        assert!(count > LARGE * CHUNK);
        // Off by so much: as a Gaussian has it.
        let spread = |i: usize| -((i * 7_919 % count) as f64 / count as f64 * 12.0).powi(2);
        let is_sampled = |i: usize| (i / CHUNK).is_multiple_of(SAMPLED);
        let like_all = (0..count).map(spread).collect();
        let chunks_two_to_eight =
            (0..count).map(|i| if (1..8).contains(&(i / CHUNK)) { spread(i) } else { f64::NEG_INFINITY }).collect();
        let none_sampled = (0..count).map(|i| if is_sampled(i) { f64::NEG_INFINITY } else { spread(i) }).collect();
        let sampled_fit = (0..count).map(|i| if is_sampled(i) { 0.1 } else { 1.0 } * spread(i)).collect();
        let sampled_do_not = (0..count).map(|i| if is_sampled(i) { 10.0 } else { 1.0 } * spread(i)).collect();
        let cases: [Vec<f64>; 5] = [like_all, chunks_two_to_eight, none_sampled, sampled_fit, sampled_do_not];
        for (case, logs) in cases.iter().enumerate() {
            let temper = |par: Par| {
                let (mut set, mut values) = (set(count), logs.clone());
                let summary = set.reweigh(&values, par).unwrap();
                // Fewer than fit at all.
                let least = if case == 1 { 1_200.0 } else { 5_000.0 };
                assert!(summary.effective_sample_size < least, "{case}: {summary:?}");
                let (tempered, power) = set.temper(&mut values, summary, least, par);
                let share = tempered.effective_sample_size / least;
                assert!((0.999_999..GOOD + 1e-6).contains(&share) && power > 0.0, "{case}: {share} {power}");
                set.log_weights().iter().map(|weight| weight.to_bits()).collect::<Vec<_>>()
            };
            let one = temper(Par::Seq);
            assert!(one == temper(Par::threads(2)) && one == temper(Par::threads(4)), "{case}");
        }
    }
}
