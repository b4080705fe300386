//! The summary of a list of errors that every metric gives.

use crate::{Error, check};

/// Values, with their usual moments and order statistics.
///
/// ```
/// use agv_core::metrics::Statistics;
///
/// let errors = Statistics::new(vec![0.1, 0.2, 0.3, 0.4])?;
/// assert!((errors.mean() - 0.25).abs() < 1e-15);
/// assert!((errors.median() - 0.25).abs() < 1e-15);
/// assert!((errors.rmse() - 0.075_f64.sqrt()).abs() < 1e-15);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// Ascending, never empty.
    sorted: Vec<f64>,
    mean: f64,
    mean_square: f64,
    variance: f64,
}

impl Statistics {
    /// Summarises the values, in any unit.
    ///
    /// # Errors
    /// [`Error::Empty`] or [`Error::NotFinite`].
    pub fn new(values: Vec<f64>) -> Result<Self, Error> {
        if values.is_empty() {
            return Err(Error::Empty { name: "values" });
        }
        check::all_finite("value", &values)?;
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let mean_square = values.iter().map(|v| v * v).sum::<f64>() / count;
        // The second pass keeps the digits that the difference of both sums would lose.
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / count;
        let mut sorted = values;
        sorted.sort_unstable_by(f64::total_cmp);
        Ok(Self { sorted, mean, mean_square, variance })
    }

    /// Number of values.
    pub fn count(&self) -> usize {
        self.sorted.len()
    }

    /// Arithmetic mean.
    pub const fn mean(&self) -> f64 {
        self.mean
    }

    /// Root of the mean square.
    pub fn rmse(&self) -> f64 {
        self.mean_square.sqrt()
    }

    /// Standard deviation of these values (divided by their number).
    pub fn standard_deviation(&self) -> f64 {
        self.variance.sqrt()
    }

    /// Least value.
    pub fn min(&self) -> f64 {
        self.percentile(0.0)
    }

    /// Middle value, or the mean of the middle two.
    pub fn median(&self) -> f64 {
        self.percentile(50.0)
    }

    /// Greatest value.
    pub fn max(&self) -> f64 {
        self.percentile(100.0)
    }

    /// The value that `percent` of all values do not exceed, linear between neighbours (Hyndman and Fan's type 7).
    /// Percentages beyond 0 and 100 read as those; NaN reads as 0.
    pub fn percentile(&self, percent: f64) -> f64 {
        let last = self.sorted.len() - 1;
        let percent = if percent.is_nan() { 0.0 } else { percent.clamp(0.0, 100.0) };
        let rank = percent / 100.0 * last as f64;
        let (low, part) = (rank.floor(), rank - rank.floor());
        let below = self.sorted[(low as usize).min(last)];
        let above = self.sorted[(low as usize + 1).min(last)];
        below + part * (above - below)
    }

    /// The values in ascending order.
    pub fn sorted(&self) -> &[f64] {
        &self.sorted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_run_from_least_to_greatest() {
        let s = Statistics::new(vec![5.0, -1.0, 3.0]).unwrap();
        let found = [-5.0, 0.0, 25.0, 50.0, 75.0, 100.0, 200.0, f64::NAN].map(|p| s.percentile(p));
        assert_eq!(found, [-1.0, -1.0, 1.0, 3.0, 4.0, 5.0, 5.0, -1.0]);
        assert_eq!((s.min(), s.median(), s.max(), s.count()), (-1.0, 3.0, 5.0, 3));
    }

    #[test]
    fn a_far_mean_does_not_swallow_the_spread() {
        let s = Statistics::new(vec![1e9 - 1.0, 1e9 + 1.0]).unwrap();
        assert_eq!((s.mean(), s.standard_deviation()), (1e9, 1.0));
    }

    #[test]
    fn bad_values_are_named() {
        assert_eq!(Statistics::new(vec![]), Err(Error::Empty { name: "values" }));
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(matches!(Statistics::new(vec![0.0, bad]), Err(Error::NotFinite { .. })), "{bad}");
        }
    }
}
