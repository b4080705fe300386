//! Which readings are too far off to be true.
//!
//! The normalised innovation squared `νᵀ S⁻¹ ν` of a consistent filter is chi-square distributed with as many degrees of
//! freedom as the reading has (Bar-Shalom, Li and Kirubarajan 2001, *Estimation with applications to tracking and navigation*,
//! section 5.4): a reading beyond a high quantile is an outlier, or the filter is not consistent.

use agv_core::{Error, check, metrics::chi_square_quantile};

/// Degrees of freedom that a gate tells apart; a reading with more has the limit of this many.
const MOST_DEGREES: usize = 12;

/// Greatest normalised innovation squared of a reading that is believed, for each number of degrees of freedom.
///
/// ```
/// use agv_filters::kalman::Gate;
///
/// let gate = Gate::at_probability(0.99)?;
/// assert!((gate.limit(1) - 6.635).abs() < 1e-3 && (gate.limit(3) - 11.345).abs() < 1e-3);
/// assert_eq!(Gate::at_limit(9.0)?.limit(2), 9.0);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    limits: [f64; MOST_DEGREES],
}

impl Gate {
    /// Every reading is believed.
    pub const OPEN: Self = Self { limits: [f64::INFINITY; MOST_DEGREES] };

    /// A gate that a sound reading of a consistent filter passes with this probability, between 0 and 1; 0.999 is usual.
    ///
    /// # Errors
    /// [`Error::OutOfRange`].
    pub fn at_probability(probability: f64) -> Result<Self, Error> {
        let mut limits = [0.0; MOST_DEGREES];
        for (degrees, limit) in (1..).zip(&mut limits) {
            *limit = chi_square_quantile(f64::from(degrees), probability)?;
        }
        Ok(Self { limits })
    }

    /// The same limit for readings of any number of components.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a limit that is not above zero; infinity is the open gate.
    pub fn at_limit(limit: f64) -> Result<Self, Error> {
        check::in_range("gate", limit, f64::MIN_POSITIVE, f64::INFINITY)?;
        Ok(Self { limits: [limit; MOST_DEGREES] })
    }

    /// Greatest normalised innovation squared of a reading with this many degrees of freedom.
    #[inline]
    pub const fn limit(&self, degrees: usize) -> f64 {
        let index = if degrees < 1 {
            0
        } else if degrees > MOST_DEGREES {
            MOST_DEGREES - 1
        } else {
            degrees - 1
        };
        self.limits[index]
    }
}

impl Default for Gate {
    /// [`OPEN`](Self::OPEN).
    fn default() -> Self {
        Self::OPEN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_gates_are_refused() {
        for bad in [0.0, 1.0, -0.1, f64::NAN, f64::INFINITY] {
            assert!(Gate::at_probability(bad).is_err(), "{bad}");
        }
        for bad in [0.0, -1.0, f64::NAN] {
            assert!(Gate::at_limit(bad).is_err(), "{bad}");
        }
        assert_eq!(Gate::at_limit(f64::INFINITY), Ok(Gate::OPEN));
        assert_eq!(Gate::OPEN.limit(0), f64::INFINITY);
        let gate = Gate::at_probability(0.9).unwrap();
        assert_eq!(gate.limit(99), gate.limit(MOST_DEGREES));
    }
}
