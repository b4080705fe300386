//! The chi-square distribution: bounds of gates, of consistency tests and of histograms.
//!
//! The distribution function is the regularised incomplete gamma function `P(k/2, x/2)`, by its series below the mean and
//! its continued fraction above (Press et al., *Numerical Recipes*, section 6.2; Temme 1994); the quantile is Newton's
//! iteration on it, kept within a bracket.

use crate::{Error, check};

/// Terms of the series and of the fraction: about `√k` are needed, so these do for any `k` a histogram can have.
const MOST_TERMS: usize = 100_000;

/// Probability that a chi-square variable with `degrees` of freedom is at most `value`; accurate to about 1e-12.
///
/// O(√degrees).
///
/// # Errors
/// [`Error::NotPositive`] for the degrees, [`Error::Negative`] for the value.
pub fn chi_square_cdf(degrees: f64, value: f64) -> Result<f64, Error> {
    let (a, x) = (0.5 * check::positive("degrees", degrees)?, 0.5 * check::non_negative("value", value)?);
    Ok(regularised_gamma(a, x))
}

/// The value that a chi-square variable with `degrees` of freedom does not exceed with this probability; the inverse of
/// [`chi_square_cdf`].
///
/// ```
/// use agv_core::metrics::chi_square_quantile;
///
/// assert!((chi_square_quantile(3.0, 0.95)? - 7.814_728).abs() < 1e-6);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::NotPositive`] for the degrees, [`Error::OutOfRange`] for a probability that is not between 0 and 1.
pub fn chi_square_quantile(degrees: f64, probability: f64) -> Result<f64, Error> {
    let a = 0.5 * check::positive("degrees", degrees)?;
    check::open_probability("probability", probability)?;
    let (mut low, mut high) = (0.0, a.max(1.0));
    while regularised_gamma(a, high) < probability && high < f64::MAX / 4.0 {
        (low, high) = (high, 2.0 * high);
    }
    let mut x = 0.5 * (low + high);
    for _ in 0..200 {
        let excess = regularised_gamma(a, x) - probability;
        (low, high) = if excess > 0.0 { (low, x) } else { (x, high) };
        let density = ((a - 1.0) * x.ln() - x - ln_gamma(a)).exp();
        let newton = x - excess / density;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        let done = (next - x).abs() <= 4.0 * f64::EPSILON * x;
        x = next;
        if done || high - low <= f64::EPSILON * high {
            break;
        }
    }
    Ok(2.0 * x)
}

/// `P(a, x)`, the lower incomplete gamma function over the complete one.
fn regularised_gamma(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..MOST_TERMS {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < sum * f64::EPSILON {
                break;
            }
        }
        return (sum * scale).min(1.0);
    }
    // Lentz's method for 1 / (x + 1 - a - 1 (1 - a) / (x + 3 - a - ...)).
    let tiny = f64::MIN_POSITIVE / f64::EPSILON;
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1.0 / tiny, 1.0 / b);
    let mut fraction = d;
    for n in 1..MOST_TERMS {
        let numerator = -(n as f64) * (n as f64 - a);
        b += 2.0;
        d = numerator * d + b;
        d = 1.0 / if d.abs() < tiny { tiny } else { d };
        c = b + numerator / c;
        c = if c.abs() < tiny { tiny } else { c };
        fraction *= d * c;
        if (d * c - 1.0).abs() < f64::EPSILON {
            break;
        }
    }
    (1.0 - scale * fraction).max(0.0)
}

/// Logarithm of the gamma function for a positive argument: Stirling's series above ten, reached by the recurrence.
fn ln_gamma(mut a: f64) -> f64 {
    let mut product = 1.0;
    while a < 10.0 {
        product *= a;
        a += 1.0;
    }
    let r = 1.0 / (a * a);
    let series = (1.0 / 12.0
        - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r * (1.0 / 1680.0 - r * (1.0 / 1188.0 - r * (691.0 / 360_360.0))))))
        / a;
    (a - 0.5) * a.ln() - a + 0.5 * std::f64::consts::TAU.ln() + series - product.ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quantiles_undo_the_distribution(degrees in 0.5..3000.0_f64, probability in 1e-4..0.9999_f64) {
            let value = chi_square_quantile(degrees, probability).unwrap();
            prop_assert!((chi_square_cdf(degrees, value).unwrap() - probability).abs() < 1e-10);
        }

        /// With two degrees of freedom it is the exponential distribution, with four one more term (Poisson's sum).
        #[test]
        fn even_degrees_have_a_closed_form(value in 0.0..80.0_f64) {
            let tail = (-0.5 * value).exp();
            prop_assert!((chi_square_cdf(2.0, value).unwrap() - (1.0 - tail)).abs() < 1e-13);
            prop_assert!((chi_square_cdf(4.0, value).unwrap() - (1.0 - tail * (1.0 + 0.5 * value))).abs() < 1e-13);
        }
    }

    /// Tables of the quantiles (Abramowitz and Stegun, Table 26.8).
    #[test]
    fn quantiles_match_the_tables() {
        for (degrees, probability, value) in [
            (1.0, 0.95, 3.84146),
            (1.0, 0.995, 7.87944),
            (2.0, 0.99, 9.21034),
            (3.0, 0.999, 16.2662),
            (5.0, 0.05, 1.145_476),
            (10.0, 0.975, 20.4831),
            (30.0, 0.005, 13.7867),
            (100.0, 0.99, 135.807),
        ] {
            let found = chi_square_quantile(degrees, probability).unwrap();
            assert!((found / value - 1.0).abs() < 5e-6, "{degrees} {probability}: {found} {value}");
        }
    }

    #[test]
    fn bad_arguments_are_named() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(chi_square_cdf(bad, 1.0), Err(Error::NotPositive { .. })), "{bad}");
            assert!(matches!(chi_square_quantile(bad, 0.5), Err(Error::NotPositive { .. })), "{bad}");
        }
        assert!(chi_square_cdf(1.0, -1.0).is_err() && chi_square_cdf(1.0, f64::NAN).is_err());
        for bad in [0.0, 1.0, f64::NAN] {
            assert!(chi_square_quantile(1.0, bad).is_err());
        }
    }
}
