//! The bias of a gyroscope, from a vehicle that stands still.

use crate::{Error, check};

/// The bias of a gyro, from the samples of a vehicle that stands still.
///
/// ```
/// use agv_core::odometry::GyroBiasEstimator;
///
/// let mut still = GyroBiasEstimator::new(0.05, 100)?;
/// for i in 0..200 {
///     still.push(0.01 + 0.001 * f64::from(i % 2))?;
/// }
/// let (bias, sigma) = still.bias().unwrap();
/// assert!((bias - 0.0105).abs() < 1e-12 && sigma < 1e-4);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawEstimator"))]
pub struct GyroBiasEstimator {
    max_rate: f64,
    min_samples: u64,
    count: u64,
    mean: f64,
    /// Sum of squared deviations from the mean (Welford 1962).
    scatter: f64,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawEstimator {
    max_rate: f64,
    min_samples: u64,
    count: u64,
    mean: f64,
    scatter: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawEstimator> for GyroBiasEstimator {
    type Error = Error;

    fn try_from(raw: RawEstimator) -> Result<Self, Error> {
        let RawEstimator { max_rate, min_samples, count, mean, scatter } = raw;
        let fresh = Self::new(max_rate, min_samples)?;
        check::in_range("mean (magnitude)", mean.abs(), 0.0, max_rate * (1.0 + 1e-9))?; // it may round up
        check::non_negative("scatter", scatter)?;
        Ok(Self { count, mean, scatter, ..fresh })
    }
}

impl GyroBiasEstimator {
    /// An estimator that takes rates above `max_rate` rad/s as motion, and speaks after `min_samples` samples (at least
    /// two) without any.
    ///
    /// # Errors
    /// [`Error::NotPositive`].
    pub fn new(max_rate: f64, min_samples: u64) -> Result<Self, Error> {
        check::positive("max_rate", max_rate)?;
        Ok(Self { max_rate, min_samples: min_samples.max(2), count: 0, mean: 0.0, scatter: 0.0 })
    }

    /// Adds a sample of the standing vehicle, in radians per second; one that is motion starts the estimate afresh and
    /// gives `false`.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; the sample is then left out.
    pub fn push(&mut self, yaw_rate: f64) -> Result<bool, Error> {
        check::finite("yaw_rate", yaw_rate)?;
        if yaw_rate.abs() > self.max_rate {
            self.reset();
            return Ok(false);
        }
        self.count += 1;
        let deviation = yaw_rate - self.mean;
        self.mean += deviation / self.count as f64;
        self.scatter += deviation * (yaw_rate - self.mean);
        Ok(true)
    }

    /// Forgets all samples; call it when the wheels move.
    pub fn reset(&mut self) {
        (self.count, self.mean, self.scatter) = (0, 0.0, 0.0);
    }

    /// Bias and the standard deviation of this estimate, in radians per second; `None` before enough samples.
    pub fn bias(&self) -> Option<(f64, f64)> {
        let n = self.count as f64;
        (self.count >= self.min_samples).then(|| (self.mean, (self.scatter / ((n - 1.0) * n)).sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_restarts_the_bias() {
        let mut still = GyroBiasEstimator::new(0.05, 3).unwrap();
        for rate in [0.01, 0.02, 0.5, 0.01] {
            still.push(rate).unwrap();
        }
        assert_eq!(still.bias(), None);
        assert!(still.push(f64::INFINITY).is_err());
        assert!(GyroBiasEstimator::new(0.0, 3).is_err() && GyroBiasEstimator::new(f64::NAN, 3).is_err());
    }

    #[cfg(feature = "serde")]
    #[test]
    fn stored_estimators_are_checked() {
        let text = serde_json::to_string(&GyroBiasEstimator::new(0.05, 3).unwrap()).unwrap();
        let read = |text: &str| serde_json::from_str::<GyroBiasEstimator>(text);
        assert_eq!(read(&text.replace("\"min_samples\":3", "\"min_samples\":0")).unwrap().min_samples, 2);
        for (good, bad) in [("0.05", "-1.0"), ("\"mean\":0.0", "\"mean\":7.0"), ("\"scatter\":0.0", "\"scatter\":-1.0")]
        {
            assert!(text.contains(good) && read(&text.replace(good, bad)).is_err(), "{bad}");
        }
    }
}
