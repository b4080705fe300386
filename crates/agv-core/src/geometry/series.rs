//! The trigonometric ratios of the exponential maps, accurate to the last digits for every angle.
//!
//! Each is an even, entire function with a removable singularity at zero. Below [`SMALL`] the closed forms cancel, so
//! the Taylor series is summed there; with [`TERMS`] terms it is exact to rounding.

/// Angle below which the series are used, in radians. The closed forms lose about `eps / SMALL^k` in their numerators.
const SMALL: f64 = 1.0;

/// Terms of each series: `SMALL^(2 TERMS) / (2 TERMS)!` is below 1e-19.
const TERMS: i32 = 11;

/// Sum of `(-x²)^k / (2k + offset)!` over k: the series that all of these share.
fn alternating(x: f64, offset: i32) -> f64 {
    let square = x * x;
    // Horner from the last term: s = 1 - x² / ((2k + o - 1)(2k + o)) s.
    let mut sum = 1.0;
    for k in (1..TERMS).rev() {
        let n = f64::from(2 * k + offset);
        sum = 1.0 - square / (n * (n - 1.0)) * sum;
    }
    (2..=offset).fold(sum, |sum, n| sum / f64::from(n))
}

/// sin x / x.
pub(super) fn sinc(x: f64) -> f64 {
    if x.abs() < SMALL { alternating(x, 1) } else { x.sin() / x }
}

/// (1 - cos x) / x².
pub(super) fn one_minus_cos(x: f64) -> f64 {
    let half = sinc(0.5 * x);
    0.5 * half * half
}

/// (x - sin x) / x³.
pub(super) fn x_minus_sin(x: f64) -> f64 {
    if x.abs() < SMALL { alternating(x, 3) } else { (x - x.sin()) / (x * x * x) }
}

/// (x²/2 - 1 + cos x) / x⁴.
pub(super) fn cos_remainder(x: f64) -> f64 {
    if x.abs() < SMALL {
        alternating(x, 4)
    } else {
        let square = x * x;
        (0.5 * square - 1.0 + x.cos()) / (square * square)
    }
}

/// (x³/6 - x + sin x) / x⁵.
pub(super) fn sin_remainder(x: f64) -> f64 {
    if x.abs() < SMALL {
        alternating(x, 5)
    } else {
        let square = x * x;
        (x * square / 6.0 - x + x.sin()) / (square * square * x)
    }
}

/// x/2 cot(x/2), singular at multiples of 2π other than zero.
pub(super) fn half_cot(x: f64) -> f64 {
    let half = 0.5 * x;
    half.cos() / sinc(half)
}

/// (1 - x/2 cot(x/2)) / x².
pub(super) fn half_cot_remainder(x: f64) -> f64 {
    // With h = x/2: (sin h - h cos h) / (4 h² sin h), and (sin h - h cos h) / h³ = a - b below without cancellation.
    let half = 0.5 * x;
    (one_minus_cos(half) - x_minus_sin(half)) / (4.0 * sinc(half))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Both branches agree where they meet: at the switch the closed form still has ten digits.
        #[test]
        fn series_and_closed_forms_agree(x in 0.9..0.999_f64) {
            let square = x * x;
            for (series, closed) in [
                (sinc(x), x.sin() / x),
                (one_minus_cos(x), (1.0 - x.cos()) / square),
                (x_minus_sin(x), (x - x.sin()) / (x * square)),
                (cos_remainder(x), (0.5 * square - 1.0 + x.cos()) / (square * square)),
                (sin_remainder(x), (x * square / 6.0 - x + x.sin()) / (x * square * square)),
                (half_cot(x), 0.5 * x / (0.5 * x).tan()),
                (half_cot_remainder(x), (1.0 - 0.5 * x / (0.5 * x).tan()) / square),
            ] {
                prop_assert!((series - closed).abs() <= 1e-12 * closed.abs(), "{} {}", series, closed);
            }
        }
    }

    #[test]
    fn limits_at_zero_are_exact() {
        for x in [0.0, 1e-300, -1e-9] {
            assert!((sinc(x) - 1.0).abs() < 1e-15);
            assert!((one_minus_cos(x) - 0.5).abs() < 1e-15);
            assert!((x_minus_sin(x) - 1.0 / 6.0).abs() < 1e-15);
            assert!((cos_remainder(x) - 1.0 / 24.0).abs() < 1e-15);
            assert!((sin_remainder(x) - 1.0 / 120.0).abs() < 1e-15);
            assert!((half_cot(x) - 1.0).abs() < 1e-15);
            assert!((half_cot_remainder(x) - 1.0 / 12.0).abs() < 1e-15);
        }
    }
}
