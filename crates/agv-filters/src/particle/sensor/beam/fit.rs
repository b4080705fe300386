//! Learning the beam model from readings at known poses.
//!
//! Which of the four causes a reading has is not seen, so that expectation and maximisation alternate (Thrun, Burgard and
//! Fox, *Probabilistic Robotics*, Table 6.2). With `e_ik` the probability that reading `i` has the cause `k`,
//!
//! ```text
//! z_k = Σ_i e_ik / n          σ² = Σ_i e_i,hit (z_i - r_i)² / Σ_i e_i,hit
//! Σ_i e_i,short (1/λ - r_i / (exp(λ r_i) - 1) - z_i) = 0
//! ```
//!
//! The last is the likelihood's slope for exponentials that end at `r_i`; the book's `λ = Σ e / Σ e z` is that of endless
//! ones, and overestimates.

use super::{
    BeamModelParams,
    mixture::{Expected, Mixture},
};
use agv_core::{Error, check};

/// What a beam measured, and what the map shows along it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BeamSample {
    /// Range that was measured, in metres; none if there was no return.
    pub measured: Option<f64>,
    /// Range of the mapped surface, in metres; none if there is none within reach.
    pub expected: Option<f64>,
}

/// The beam model that explains readings best.
///
/// ```
/// use agv_filters::particle::{BeamFit, BeamModelParams, BeamSample};
///
/// // Readings of a wall at 3 m that are off by up to 3 cm, and one in ten by someone who passes.
/// let samples: Vec<BeamSample> = (0..200)
///     .map(|i| if i % 10 == 0 { 0.01 * f64::from(i) } else { 3.0 + 0.01 * f64::from(i % 7 - 3) })
///     .map(|range| BeamSample { measured: Some(range), expected: Some(3.0) })
///     .collect();
/// let fit = BeamFit::new(&BeamModelParams::default(), &samples, 200)?;
/// assert!(fit.converged && (fit.params.sigma_hit - 0.02).abs() < 0.01 && fit.params.z_hit > 0.8);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeamFit {
    /// The parameters that were given, with shares, deviation and rate replaced.
    pub params: BeamModelParams,
    /// Mean logarithm of the likelihood of a reading under them.
    pub log_likelihood: f64,
    /// Rounds that were taken.
    pub iterations: usize,
    /// Whether the last round gained next to nothing.
    pub converged: bool,
}

/// Gain of the mean log-likelihood below which a round has gained nothing.
const LEAST_GAIN: f64 = 1e-9;
/// Least shares of lost and random readings, so that no reading becomes impossible.
const LEAST_SHARE: f64 = 1e-6;
/// Least deviation, in metres, and bounds of the rate, in 1/m.
const LEAST_SIGMA: f64 = 1e-4;
const RATES: (f64, f64) = (1e-3, 1e3);

impl BeamFit {
    /// The best parameters near `initial`, whose `max_range` is the scanner's, after at most `max_iterations` rounds.
    ///
    /// O(rounds x samples); the likelihood rises with every round. Finds the maximum next to the start: readings without any
    /// short one leave the rate as it is.
    ///
    /// # Errors
    /// Parameters that [`validate`](BeamModelParams::validate) refuses, [`Error::Empty`] without samples, a sample that is
    /// negative or not finite.
    pub fn new(initial: &BeamModelParams, samples: &[BeamSample], max_iterations: usize) -> Result<Self, Error> {
        initial.validate()?;
        if samples.is_empty() {
            return Err(Error::Empty { name: "beam samples" });
        }
        for sample in samples {
            sample.measured.map_or(Ok(0.0), |range| check::non_negative("measured range", range))?;
            sample.expected.map_or(Ok(0.0), |range| check::non_negative("expected range", range))?;
        }
        let mut causes = vec![[0.0; 4]; samples.len()];
        let mut fit = Self { params: *initial, log_likelihood: f64::NEG_INFINITY, iterations: 0, converged: false };
        fit.log_likelihood = fit.expect(samples, &mut causes);
        while fit.iterations < max_iterations && !fit.converged {
            let before = fit;
            fit.maximise(samples, &causes);
            fit.log_likelihood = fit.expect(samples, &mut causes);
            fit.iterations += 1;
            fit.converged = fit.log_likelihood - before.log_likelihood < LEAST_GAIN;
            if fit.log_likelihood < before.log_likelihood {
                // Rounding, or a bound that was met: what was is better.
                fit = Self { iterations: fit.iterations, converged: true, ..before };
            }
        }
        Ok(fit)
    }

    /// How probable each cause of each reading is; returns the mean log-likelihood.
    fn expect(&self, samples: &[BeamSample], causes: &mut [[f64; 4]]) -> f64 {
        let mixture = Mixture::new(&self.params, self.params.max_range);
        let mut sum = 0.0;
        for (sample, causes) in samples.iter().zip(causes) {
            let expected = sample.expected.map_or(Expected::Nothing, Expected::Surface);
            let terms = mixture.terms(sample.measured.filter(|&z| z < self.params.max_range), expected);
            *causes = std::array::from_fn(|k| terms[k] * mixture.shares[k]);
            let total: f64 = causes.iter().sum();
            *causes = causes.map(|cause| cause / total);
            sum += total.ln();
        }
        sum / samples.len() as f64
    }

    /// The parameters that are best if each reading has its causes with these probabilities.
    fn maximise(&mut self, samples: &[BeamSample], causes: &[[f64; 4]]) {
        let n = samples.len() as f64;
        let share = |cause: usize| causes.iter().map(|causes| causes[cause]).sum::<f64>() / n;
        let p = &mut self.params;
        (p.z_hit, p.z_short) = (share(0), share(1));
        (p.z_max, p.z_rand) = (share(2).max(LEAST_SHARE), share(3).max(LEAST_SHARE));
        let (mut squares, mut hits) = (0.0, 0.0);
        for (sample, causes) in samples.iter().zip(causes) {
            if let (Some(z), Some(r)) = (sample.measured.filter(|&z| z < p.max_range), sample.expected) {
                squares += causes[0] * (z - r) * (z - r);
                hits += causes[0];
            }
        }
        if hits > 0.0 {
            p.sigma_hit = (squares / hits).sqrt().max(LEAST_SIGMA);
        }
        if let Some(rate) = rate_of_short(samples, causes, p.max_range) {
            p.lambda_short = rate;
        }
    }
}

/// The rate at which the slope of the short readings' likelihood vanishes; none without such readings.
fn rate_of_short(samples: &[BeamSample], causes: &[[f64; 4]], range: f64) -> Option<f64> {
    let short = || samples.iter().zip(causes).filter(|(_, causes)| causes[1] > 1e-9);
    let total: f64 = short().map(|(_, causes)| causes[1]).sum();
    let measured: f64 = short().filter_map(|(sample, causes)| Some(causes[1] * sample.measured?)).sum();
    // Falls with the rate: the mean of an exponential that ends at `limit`.
    let mean = |rate: f64| -> f64 {
        let sum: f64 = short()
            .map(|(sample, causes)| {
                let limit = sample.expected.unwrap_or(range);
                causes[1] * (rate.recip() - limit / (rate * limit).exp_m1())
            })
            .sum();
        sum - measured
    };
    (total > 0.0).then(|| {
        let (mut low, mut high) = (RATES.0.ln(), RATES.1.ln());
        // To a part in ten million.
        for _ in 0..28 {
            let middle = 0.5 * (low + high);
            if mean(middle.exp()) > 0.0 { low = middle } else { high = middle }
        }
        (0.5 * (low + high)).exp()
    })
}
