//! Wall-clock times of the steps of an example. (The crates read no clock; the examples do, to report.)

use agv_core::metrics::Statistics;
use std::time::Instant;

/// Times of repeated calls.
///
/// ```
/// use agv_support::timing::Timings;
///
/// let mut timings = Timings::default();
/// let sum: u64 = timings.time(|| (0..1000).sum());
/// assert_eq!(sum, 499_500);
/// assert!(timings.milliseconds(50.0) >= 0.0);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Timings(Vec<f64>);

impl Timings {
    /// Runs `work` and notes how long it took.
    pub fn time<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.0.push(start.elapsed().as_secs_f64() * 1e3);
        result
    }

    /// Adds the calls of another.
    pub fn append(&mut self, other: Self) {
        self.0.extend(other.0);
    }

    /// Percentile of the calls, in milliseconds; NaN if there was none.
    pub fn milliseconds(&self, percent: f64) -> f64 {
        Statistics::new(self.0.clone()).map_or(f64::NAN, |s| s.percentile(percent))
    }

    /// Sum over all calls, in milliseconds.
    pub fn total_milliseconds(&self) -> f64 {
        self.0.iter().sum()
    }

    /// Number of calls.
    pub fn count(&self) -> usize {
        self.0.len()
    }
}
