//! The density of one reading, given what the map shows along the beam.
//!
//! A reading is either a range `z` below the greatest range `R`, or none. With the surface at `r`,
//!
//! ```text
//!             density of a range z                          probability of no return
//! hit         N(z; r, σ²) / Φ(r/σ)                          Φ((r - R)/σ)
//! short       λ exp(-λ z) / (1 - exp(-λ r))     z <= r      0
//! max         0                                             1
//! rand        1 / R                                         0
//! ```
//!
//! (Thrun, Burgard and Fox, *Probabilistic Robotics*, Eqs. 6.4–6.12). There a hit is cut off at `R` and its rest lost; here
//! what a scanner would measure beyond `R` is what it reports as no return, so that every row sums to one, and a beam into
//! open space that does not come back is what the map lets expect.

use super::BeamModelParams;
use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// What the map shows along a beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Expected {
    /// A surface at this range.
    Surface(f64),
    /// Nothing within reach.
    Nothing,
    /// Unobserved space from this range on, of which nothing is known.
    Unknown(f64),
}

/// The four causes of a reading, in the order hit, short, max, rand.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mixture {
    pub(super) shares: [f64; 4],
    sigma: f64,
    lambda: f64,
    /// R.
    pub(super) range: f64,
    /// 1 / (σ √(2π))
    peak: f64,
}

/// Range, in deviations, beyond which a hit's tail is nothing.
const TAIL: f64 = 5.0;

impl Mixture {
    /// The mixture for a scanner whose greatest range is `range`; the parameters are valid.
    pub(super) fn new(params: &BeamModelParams, range: f64) -> Self {
        let raw = [params.z_hit, params.z_short, params.z_max, params.z_rand];
        let total: f64 = raw.iter().sum();
        Self {
            shares: raw.map(|share| share / total),
            sigma: params.sigma_hit,
            lambda: params.lambda_short,
            range,
            peak: (params.sigma_hit * TAU.sqrt()).recip(),
        }
    }

    /// How far surfaces matter: some beyond the greatest range are measured within it.
    pub(super) fn reach(&self) -> f64 {
        self.range + TAIL * self.sigma
    }

    /// Density of the reading by each cause, or probability if there was no return; not weighted by the shares.
    pub(super) fn terms(&self, reading: Option<f64>, expected: Expected) -> [f64; 4] {
        let Some(z) = reading else { return [self.no_return(expected), 0.0, 1.0, 0.0] };
        let limit = match expected {
            Expected::Surface(range) | Expected::Unknown(range) => range,
            Expected::Nothing => self.range,
        };
        // A surface at the scanner leaves no room before it.
        let short = if z <= limit && limit > 0.0 {
            self.lambda * (-self.lambda * z).exp() / -(-self.lambda * limit).exp_m1()
        } else {
            0.0
        };
        [self.hit(z, expected), short, 0.0, self.range.recip()]
    }

    /// The density or probability of a reading.
    pub(super) fn likelihood(&self, reading: Option<f64>, expected: Expected) -> f64 {
        let terms = self.terms(reading, expected);
        terms.iter().zip(self.shares).map(|(term, share)| term * share).sum()
    }

    fn hit(&self, z: f64, expected: Expected) -> f64 {
        match expected {
            Expected::Surface(r) => {
                let (off, from_scanner) = ((z - r) / self.sigma, r / self.sigma);
                let inside = if from_scanner < TAIL { normal_cdf(from_scanner) } else { 1.0 };
                self.peak * (-0.5 * off * off).exp() / inside
            }
            Expected::Unknown(r) if z >= r => 0.5 / (self.range - r).max(self.sigma),
            Expected::Nothing | Expected::Unknown(_) => 0.0,
        }
    }

    fn no_return(&self, expected: Expected) -> f64 {
        match expected {
            Expected::Surface(r) if r < self.range - TAIL * self.sigma => 0.0,
            Expected::Surface(r) => normal_cdf((r - self.range) / self.sigma),
            Expected::Nothing => 1.0,
            Expected::Unknown(_) => 0.5,
        }
    }
}

/// Φ(x), to 1e-7 (Abramowitz and Stegun, 7.1.26).
fn normal_cdf(x: f64) -> f64 {
    let y = x.abs() * FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * y);
    let poly = 0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429)));
    let upper = 0.5 * t * poly * (-y * y).exp();
    if x < 0.0 { upper } else { 1.0 - upper }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each cause by itself is a distribution: its density over [0, R) and the probability of no return sum to one.
    #[test]
    fn every_cause_sums_to_one() {
        let params = BeamModelParams { sigma_hit: 0.3, lambda_short: 0.4, ..Default::default() };
        let mixture = Mixture::new(&params, 8.0);
        let steps = 80_000;
        for expected in [0.05, 0.4, 3.0, 7.8, 8.5]
            .map(Expected::Surface)
            .into_iter()
            .chain([Expected::Nothing, Expected::Unknown(3.0)])
        {
            let mut sums = mixture.terms(None, expected);
            for k in 0..steps {
                let z = (f64::from(k) + 0.5) * 8.0 / f64::from(steps);
                let terms = mixture.terms(Some(z), expected);
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term * 8.0 / f64::from(steps));
            }
            for (cause, sum) in sums.iter().enumerate() {
                // There is no hit without a surface but the lost one; a surface beyond R cuts the short ones off.
                let cut = cause == 1 && matches!(expected, Expected::Surface(r) if r > 8.0);
                assert!((sum - 1.0).abs() < 2e-3 || cut && *sum < 1.0, "{expected:?}: {sums:?}");
            }
        }
    }

    #[test]
    fn the_normal_distribution_is_accurate() {
        for (x, expected) in
            [(0.0, 0.5), (1.0, 0.841_344_746), (-1.0, 0.158_655_254), (2.5, 0.993_790_335), (-4.0, 3.167e-5)]
        {
            assert!((normal_cdf(x) - expected).abs() < 1e-7, "{x}");
        }
    }
}
