//! Sine and cosine of the small angles that noise consists of.

/// Greatest angle of the series below, in radians.
pub(super) const SERIES_LIMIT: f64 = 0.5;

/// `(sin, cos)` of an angle in radians, to 1e-15.
///
/// Below half a radian the Taylor series is summed (terms to x¹³ and x¹², the rest is below 1e-16): a third of the
/// time of the library's functions, which are called beyond.
#[inline]
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    // Written so that NaN takes the library's way.
    if angle.abs() <= SERIES_LIMIT { series(angle) } else { angle.sin_cos() }
}

/// The series, for angles up to [`SERIES_LIMIT`].
#[expect(clippy::inline_always, reason = "compiled with its caller, for the instruction set found at run time")]
#[inline(always)]
pub(super) fn series(x: f64) -> (f64, f64) {
    let s = x * x;
    let q = s * s;
    // Estrin's scheme: half the latency of Horner's.
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
        fn agrees_with_the_library(angle in -4.0..4.0_f64) {
            let ((sin, cos), (expected_sin, expected_cos)) = (sin_cos(angle), angle.sin_cos());
            prop_assert!((sin - expected_sin).abs() < 1e-15 && (cos - expected_cos).abs() < 1e-15, "{angle}");
        }
    }

    #[test]
    fn not_a_number_stays_so() {
        assert!(sin_cos(f64::NAN).0.is_nan());
    }
}
