//! Sine and cosine at once, in plain arithmetic.
//!
//! Their series, summed by Estrin's scheme, half the latency of Horner's; beyond an eighth of a turn after whole quarters of a turn
//! were taken off. A third to a half of the time of the library's functions, the same bits on every system, and what is without
//! branches vectorises.

use agv_core::geometry::So2;
use nalgebra::UnitComplex;
use std::f64::consts::FRAC_2_PI;

/// Greatest angle of [`series`], in radians.
pub(crate) const SERIES_LIMIT: f64 = 0.5;

/// Beyond this angle, in radians, the library is asked: the first product below would not be exact.
const MOST: f64 = 1e5;

/// A quarter of a turn in two parts, the first of few enough bits that its products with whole numbers below 2²⁰ are exact.
#[expect(clippy::excessive_precision, reason = "two parts of one number")]
const QUARTER: [f64; 2] = [1.570_796_326_734_125_614_17, 6.077_100_506_506_192_249_32e-11];

/// Adding 1.5 2⁵² leaves the nearest whole number in the low bits of the sum.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// `(sin, cos)` of an angle in radians, to 2e-16.
#[inline]
pub(crate) fn sin_cos(angle: f64) -> (f64, f64) {
    // Written so that NaN takes the library's way.
    if angle.abs() <= MOST { reduced(angle) } else { angle.sin_cos() }
}

/// The rotation by an angle in radians.
#[inline]
pub(crate) fn rotation(angle: f64) -> So2 {
    let (sin, cos) = sin_cos(angle);
    UnitComplex::from_cos_sin_unchecked(cos, sin).into()
}

#[inline]
fn reduced(angle: f64) -> (f64, f64) {
    let shifted = angle * FRAC_2_PI + ROUNDER;
    let quarters = shifted - ROUNDER;
    let x = (angle - quarters * QUARTER[0]) - quarters * QUARTER[1];
    let s = x * x;
    let (q, o) = (s * s, (s * s) * (s * s));
    let sin = x + x
        * s
        * (((-1.0 / 6.0 + s * (1.0 / 120.0)) + q * (-1.0 / 5_040.0 + s * (1.0 / 362_880.0)))
            + o * ((-1.0 / 39_916_800.0 + s * (1.0 / 6_227_020_800.0))
                + q * (-1.0 / 1_307_674_368_000.0 + s * (1.0 / 355_687_428_096_000.0))));
    let cos = (1.0 - 0.5 * s)
        + q * (((1.0 / 24.0 - s * (1.0 / 720.0)) + q * (1.0 / 40_320.0 - s * (1.0 / 3_628_800.0)))
            + o * ((1.0 / 479_001_600.0 - s * (1.0 / 87_178_291_200.0)) + q * (1.0 / 20_922_789_888_000.0)));
    // A quarter of a turn makes the sine the cosine, and the cosine the sine with its sign turned.
    let quarter = shifted.to_bits();
    let (sin, cos) = if quarter & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let turned = |value: f64, is_turned: u64| f64::from_bits(value.to_bits() ^ (is_turned << 63));
    (turned(sin, quarter >> 1), turned(cos, (quarter + 1) >> 1))
}

/// `(sin, cos)` of a small angle in radians: the first half of the terms of [`sin_cos`] that are needed up to [`SERIES_LIMIT`], which
/// noise seldom exceeds.
#[expect(clippy::inline_always, reason = "compiled with its caller, for the instruction set found at run time")]
#[inline(always)]
pub(crate) fn series(x: f64) -> (f64, f64) {
    let s = x * x;
    let q = s * s;
    let sin = (1.0 - s * (1.0 / 6.0))
        + q * ((1.0 / 120.0 - s * (1.0 / 5_040.0))
            + q * ((1.0 / 362_880.0 - s * (1.0 / 39_916_800.0)) + q * (1.0 / 6_227_020_800.0)));
    let cos = (1.0 - s * 0.5)
        + q * ((1.0 / 24.0 - s * (1.0 / 720.0))
            + q * ((1.0 / 40_320.0 - s * (1.0 / 3_628_800.0)) + q * (1.0 / 479_001_600.0)));
    (x * sin, cos)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_the_library(angle in prop_oneof![-0.5..0.5_f64, -8.0..8.0_f64, -2e5..2e5_f64], quarters in -60_000..60_000_i32) {
            // Near whole quarters of a turn digits cancel.
            let near = f64::from(quarters) * std::f64::consts::FRAC_PI_2 + angle * 1e-9;
            for angle in [angle, near] {
                let (sin, cos) = sin_cos(angle);
                prop_assert!((sin - angle.sin()).abs() < 3e-16 && (cos - angle.cos()).abs() < 3e-16, "{angle}");
            }
            if angle.abs() <= SERIES_LIMIT {
                let (sin, cos) = series(angle);
                prop_assert!((sin - angle.sin()).abs() < 1e-15 && (cos - angle.cos()).abs() < 1e-15, "{angle}");
            }
        }
    }

    #[test]
    fn not_a_number_stays_so() {
        for angle in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(sin_cos(angle).0.is_nan() && sin_cos(angle).1.is_nan());
        }
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
    }
}
