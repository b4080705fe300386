//! The trigonometric ratios of the exponential maps, accurate to the last digits for every angle.
//!
//! Each is an even, entire function with a removable singularity at zero. Below [`SMALL`] the closed forms cancel, so
//! the Taylor series is summed there; with [`TERMS`] terms it is exact to rounding.

/// Angle below which the series are used, in radians. The closed forms lose about `eps / SMALL^k` in their numerators.
const SMALL: f64 = 1.0;

/// Terms of each series: `SMALL^(2 TERMS) / (2 TERMS + 3)!` is below 1e-22.
const TERMS: usize = 10;

/// `1 / (2k + OFFSET)!` over k, the coefficients that all of these share.
const fn coefficients<const OFFSET: usize>() -> [f64; TERMS] {
    let mut coefficients = [1.0; TERMS];
    let (mut factorial, mut n) = (1.0, 1);
    while n < 2 * TERMS + OFFSET {
        factorial *= n as f64;
        if n >= OFFSET && (n - OFFSET).is_multiple_of(2) && (n - OFFSET) / 2 < TERMS {
            coefficients[(n - OFFSET) / 2] = 1.0 / factorial;
        }
        n += 1;
    }
    coefficients
}

/// Sum of `(-x²)^k / (2k + OFFSET)!` over k, by Horner's rule.
fn alternating<const OFFSET: usize>(x: f64) -> f64 {
    let square = x * x;
    const { coefficients::<OFFSET>() }.iter().rev().fold(0.0, |sum, c| c - square * sum)
}

/// sin x / x. The quotient never cancels: only zero itself, and what would round to it, needs the limit.
pub(super) fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-150 { 1.0 } else { x.sin() / x }
}

/// (1 - cos x) / x².
pub(super) fn one_minus_cos(x: f64) -> f64 {
    let half = sinc(0.5 * x);
    0.5 * half * half
}

/// (x - sin x) / x³.
pub(super) fn x_minus_sin(x: f64) -> f64 {
    if x.abs() < SMALL { alternating::<3>(x) } else { (x - x.sin()) / (x * x * x) }
}

/// (x²/2 - 1 + cos x) / x⁴.
pub(super) fn cos_remainder(x: f64) -> f64 {
    if x.abs() < SMALL {
        alternating::<4>(x)
    } else {
        let square = x * x;
        (0.5 * square - 1.0 + x.cos()) / (square * square)
    }
}

/// (x³/6 - x + sin x) / x⁵.
pub(super) fn sin_remainder(x: f64) -> f64 {
    if x.abs() < SMALL {
        alternating::<5>(x)
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
