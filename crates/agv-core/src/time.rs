//! Points in time. No clock is ever read: the caller stamps what it measures, in an epoch of its own.

use std::ops::{Add, Sub};

/// A point in time: nanoseconds since the caller's epoch.
///
/// Differences are seconds, as the equations want them:
///
/// ```
/// use agv_core::time::Stamp;
///
/// let start = Stamp::from_seconds(10.0);
/// let end = start + 0.25;
/// assert_eq!(end - start, 0.25);
/// assert_eq!(end.nanoseconds(), 10_250_000_000);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Stamp(i64);

impl Stamp {
    /// A stamp of `nanoseconds` since the epoch.
    pub const fn from_nanoseconds(nanoseconds: i64) -> Self {
        Self(nanoseconds)
    }

    /// The stamp nearest to `seconds` since the epoch. NaN reads as zero, and values beyond ±292 years saturate.
    pub fn from_seconds(seconds: f64) -> Self {
        // Whole and fractional part apart: the product of a Unix time with 1e9 would lose the last 100 ns.
        let whole = seconds.trunc();
        Self((whole as i64).saturating_mul(1_000_000_000).saturating_add(((seconds - whole) * 1e9).round() as i64))
    }

    /// Nanoseconds since the epoch.
    pub const fn nanoseconds(self) -> i64 {
        self.0
    }

    /// Seconds since the epoch; a Unix time keeps about 100 ns.
    pub fn seconds(self) -> f64 {
        self.0 as f64 / 1e9
    }
}

#[expect(clippy::suspicious_arithmetic_impl, reason = "seconds and nanoseconds are converted here")]
impl Sub for Stamp {
    type Output = f64;

    /// Seconds from `earlier` to `self`.
    fn sub(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 / 1e9
    }
}

#[expect(clippy::suspicious_arithmetic_impl, reason = "seconds and nanoseconds are converted here")]
impl Add<f64> for Stamp {
    type Output = Self;

    /// The stamp `dt` seconds later, to the nanosecond. NaN adds nothing, and what leaves ±292 years saturates.
    fn add(self, dt: f64) -> Self {
        Self(self.0.saturating_add((dt * 1e9).round() as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unix_time_keeps_its_microseconds() {
        assert_eq!(Stamp::from_seconds(976_052_857.337_530).nanoseconds() / 1000, 976_052_857_337_530);
    }

    /// Whole nanoseconds become the double that a literal of the same value is: division rounds once.
    #[test]
    fn seconds_are_the_nearest_double() {
        for (nanoseconds, seconds) in
            [(300_000_000, 0.3), (50_000_000, 0.05), (700_000_001, 0.700_000_001), (-1, -1e-9)]
        {
            let stamp = Stamp::from_nanoseconds(nanoseconds);
            assert_eq!((stamp.seconds(), stamp - Stamp::default()), (seconds, seconds));
        }
    }

    #[test]
    fn extremes_saturate_and_never_panic() {
        assert_eq!(Stamp::from_seconds(f64::INFINITY).nanoseconds(), i64::MAX);
        assert_eq!(Stamp::from_seconds(f64::NAN).nanoseconds(), 0);
        assert_eq!((Stamp::from_nanoseconds(7) + f64::NAN).nanoseconds(), 7);
        assert_eq!((Stamp::from_nanoseconds(7) + f64::INFINITY).nanoseconds(), i64::MAX);
        assert!(Stamp::from_nanoseconds(i64::MIN) - Stamp::from_nanoseconds(i64::MAX) < 0.0);
    }
}
