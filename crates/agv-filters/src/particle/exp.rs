//! The exponential of many numbers.
//!
//! With `x = n ln 2 + r` and `|r| <= ln 2 / 2`
//!
//! ```text
//! exp x = 2ⁿ Σ rᵏ / k!,   k = 0 … 12
//! ```
//!
//! The rest of the series is below 2e-16 of the sum. Plain arithmetic without branches, so that loops over it vectorise.

#![expect(clippy::inline_always, reason = "compiled with its caller, for the instruction set found at run time")]
#![expect(clippy::excessive_precision, reason = "two parts of one number")]

use std::f64::consts::LOG2_E;

/// Below it the result is zero: 2ⁿ would not be a normal number.
const LEAST: f64 = -708.0;

/// Adding 1.5 2⁵² leaves the nearest whole number in the low bits of the sum.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// ln 2 in two parts, the first of few enough bits that its products with `n` are exact.
const LN_2_HIGH: f64 = 6.931_471_803_691_238_16e-1;
const LN_2_LOW: f64 = 1.908_214_929_270_587_70e-10;

/// Exponential of a number that is not above 700, to 4e-16 of it; zero below -708, and of NaN.
#[inline(always)]
pub(super) fn exp(x: f64) -> f64 {
    let shifted = (if x > LEAST { x } else { LEAST }) * LOG2_E + ROUNDER;
    let n = shifted - ROUNDER;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let (r2, r4) = (r * r, (r * r) * (r * r));
    // Estrin's scheme: a third of the latency of Horner's.
    let low = (1.0 + r) + r2 * (0.5 + r * (1.0 / 6.0));
    let middle = (1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5_040.0));
    let high = (1.0 / 40_320.0 + r * (1.0 / 362_880.0)) + r2 * (1.0 / 3_628_800.0 + r * (1.0 / 39_916_800.0));
    let sum = low + r4 * (middle + r4 * (high + r4 * (1.0 / 479_001_600.0)));
    let power = f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52);
    if x > LEAST { sum * power } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_the_library(x in prop_oneof![-707.9..700.0_f64, -1.0..1.0_f64]) {
            prop_assert!((exp(x) / x.exp() - 1.0).abs() < 5e-16, "{x}");
        }
    }

    #[test]
    fn edges_are_served() {
        assert_eq!([0.0, -0.0, -708.0, -1e9, f64::NEG_INFINITY, f64::NAN].map(exp), [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
