//! Quantiles of the normal and of the chi-square distribution, as KLD sampling needs them.
//!
//! The normal quantile is Acklam's rational approximation, with a relative error of 1.15e-9. The chi-square quantile is
//! found by Halley's method on the regularised incomplete gamma function, which is summed as a series or as a continued
//! fraction (Press et al., *Numerical Recipes*, section 6.2), from the approximation of Wilson and Hilferty (1931):
//!
//! ```text
//! χ²_p(n) ≈ n (1 - 2 / (9 n) + z_p sqrt(2 / (9 n)))³
//! ```

use std::f64::consts::PI;

/// The value below which a standard normal variable stays with probability `p` in (0, 1), to 1e-9.
pub(super) fn normal_quantile(p: f64) -> f64 {
    /// Below it, and above one less it, the tails' form is used.
    const TAIL: f64 = 0.02425;
    let ratio = |x: f64, numerator: &[f64], denominator: &[f64]| {
        let horner = |coefficients: &[f64]| coefficients.iter().fold(0.0, |sum, c| sum * x + c);
        horner(numerator) / horner(denominator)
    };
    let tail = |p: f64| {
        let q = (-2.0 * p.ln()).sqrt();
        ratio(
            q,
            &[
                -7.784_894_002_430_293e-3,
                -3.223_964_580_411_365e-1,
                -2.400_758_277_161_838,
                -2.549_732_539_343_734,
                4.374_664_141_464_968,
                2.938_163_982_698_783,
            ],
            &[7.784_695_709_041_462e-3, 3.224_671_290_700_398e-1, 2.445_134_137_142_996, 3.754_408_661_907_416, 1.0],
        )
    };
    if p < TAIL {
        tail(p)
    } else if p > 1.0 - TAIL {
        -tail(1.0 - p)
    } else {
        let q = p - 0.5;
        q * ratio(
            q * q,
            &[
                -3.969_683_028_665_376e1,
                2.209_460_984_245_205e2,
                -2.759_285_104_469_687e2,
                1.383_577_518_672_69e2,
                -3.066_479_806_614_716e1,
                2.506_628_277_459_239,
            ],
            &[
                -5.447_609_879_822_406e1,
                1.615_858_368_580_409e2,
                -1.556_989_798_598_866e2,
                6.680_131_188_771_972e1,
                -1.328_068_155_288_572e1,
                1.0,
            ],
        )
    }
}

/// The approximate quantile of chi-square with `degrees` degrees of freedom, given the normal quantile `z` of the same
/// probability.
pub(super) fn wilson_hilferty(degrees: f64, z: f64) -> f64 {
    let ninth = 2.0 / (9.0 * degrees);
    let root = (1.0 - ninth + z * ninth.sqrt()).max(0.0);
    degrees * root * root * root
}

/// The value below which a chi-square variable with `degrees` > 0 degrees of freedom stays with probability `p` in
/// (0, 1), to about 1e-12. O(sqrt(degrees)) terms for each of some steps.
pub(super) fn chi_square_quantile(degrees: f64, p: f64) -> f64 {
    let a = 0.5 * degrees;
    let ln_gamma_a = ln_gamma(a);
    // Half the quantile; positive, so that its logarithm exists.
    let mut x = (0.5 * wilson_hilferty(degrees, normal_quantile(p))).max(1e-12);
    for _ in 0..60 {
        let error = lower_gamma(a, x, ln_gamma_a) - p;
        let ln_density = (a - 1.0) * x.ln() - x - ln_gamma_a;
        // Halley's step: the second derivative of the distribution is its density times `(a - 1) / x - 1`.
        let newton = error / ln_density.exp();
        let step = newton / (1.0 - 0.5 * (newton * ((a - 1.0) / x - 1.0)).min(1.0));
        let next = if step < x { x - step } else { 0.5 * x };
        let is_there = (next - x).abs() <= 1e-13 * next;
        x = next;
        if is_there {
            break;
        }
    }
    2.0 * x
}

/// Logarithm of the gamma function of `x` > 0: Stirling's series, after the argument was raised beyond 10.
fn ln_gamma(x: f64) -> f64 {
    let (mut x, mut shift) = (x, 0.0);
    while x < 10.0 {
        shift += x.ln();
        x += 1.0;
    }
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    let series = inverse
        * (1.0 / 12.0
            - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square * (1.0 / 1680.0 - square * (1.0 / 1188.0)))));
    (x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln() + series - shift
}

/// Regularised lower incomplete gamma function `P(a, x)` for `a`, `x` > 0.
fn lower_gamma(a: f64, x: f64, ln_gamma_a: f64) -> f64 {
    const TERMS: usize = 100_000;
    let scale = (a * x.ln() - x - ln_gamma_a).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..TERMS {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < sum * 1e-16 {
                break;
            }
        }
        scale * sum
    } else {
        // Lentz's method.
        let mut b = x + 1.0 - a;
        let (mut c, mut d) = (1e300, 1.0 / b);
        let mut fraction = d;
        for i in 1..TERMS {
            let i = i as f64;
            let numerator = -i * (i - a);
            b += 2.0;
            d = 1.0 / (numerator * d + b);
            c = b + numerator / c;
            let factor = c * d;
            fraction *= factor;
            if (factor - 1.0).abs() < 1e-16 {
                break;
            }
        }
        1.0 - scale * fraction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_quantiles_are_those_of_the_tables() {
        // To nine digits: Abramowitz and Stegun, Table 26.6, and its tails.
        for (p, z) in [
            (0.5, 0.0),
            (0.95, 1.644_853_627),
            (0.99, 2.326_347_874),
            (0.999, 3.090_232_306),
            (1e-6, -4.753_424_309),
            (0.01, -2.326_347_874),
        ] {
            assert!((normal_quantile(p) - z).abs() < 5e-9, "{p}: {}", normal_quantile(p));
        }
    }

    #[test]
    fn chi_square_quantiles_are_those_of_the_tables() {
        // Abramowitz and Stegun, Table 26.8; two degrees are an exponential, in closed form.
        for (degrees, p, quantile, digits) in [
            (1.0, 0.95, 3.841_459, 1e-6),
            (1.0, 0.99, 6.634_897, 1e-6),
            (2.0, 0.99, -2.0 * 0.01_f64.ln(), 1e-10),
            (2.0, 0.05, -2.0 * 0.95_f64.ln(), 1e-10),
            (9.0, 0.99, 21.665_99, 1e-5),
            (30.0, 0.95, 43.772_97, 1e-5),
            (100.0, 0.99, 135.806_7, 1e-4),
        ] {
            let found = chi_square_quantile(degrees, p);
            assert!((found - quantile).abs() < digits, "{degrees} {p}: {found}");
        }
    }

    /// For whole `n` the distribution with 2 n degrees is a finite sum: `1 - Σ_{k<n} e^{-x/2} (x/2)^k / k!`.
    #[test]
    fn even_degrees_have_a_closed_form() {
        for n in [1_u32, 3, 20, 250] {
            for p in [0.05, 0.5, 0.95, 0.999] {
                let half = 0.5 * chi_square_quantile(f64::from(2 * n), p);
                let mut log_term = -half;
                let mut sum = 0.0;
                for k in 0..n {
                    sum += log_term.exp();
                    log_term += (half / f64::from(k + 1)).ln();
                }
                assert!((1.0 - sum - p).abs() < 1e-10, "{n} {p}: {}", 1.0 - sum);
            }
        }
    }
}
