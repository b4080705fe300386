//! The normal quantile and Wilson and Hilferty's approximation of the chi-square quantile, as KLD sampling needs them.
//!
//! The normal quantile is Acklam's rational approximation, with a relative error of 1.15e-9. Wilson and Hilferty (1931):
//!
//! ```text
//! χ²_p(n) ≈ n (1 - 2 / (9 n) + z_p sqrt(2 / (9 n)))³
//! ```

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
}
