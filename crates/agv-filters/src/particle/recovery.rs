//! When a belief is to be doubted, and by how much: the share of new particles that are drawn elsewhere.
//!
//! Two signs. The first is that of Augmented MCL (Gutmann and Fox 2002; Thrun, Burgard and Fox, *Probabilistic Robotics*,
//! Table 8.3): the mean likelihood of the observations has fallen below what it used to be.
//!
//! ```text
//! w_slow += α_slow (w - w_slow)      w_fast += α_fast (w - w_fast)      share = max(0, 1 - ν w_fast / w_slow)
//! ```
//!
//! Here `w` is the mean likelihood *per independent reading*, the root of that of the whole observation: a product over many
//! beams falls by orders of magnitude when one person walks by. What it used to be says nothing in a filter that has never
//! been right. The second sign needs no past: the estimate explains too few of the readings.

use agv_core::{Error, check};

/// Parameters of a [`Recovery`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RecoveryParams {
    /// `α_slow`: weight of the latest observation in the slow mean, in [0, 1].
    pub alpha_slow: f64,
    /// `α_fast`: its weight in the fast mean, in [0, 1]; zero switches the first sign off.
    pub alpha_fast: f64,
    /// `ν`: how many times the slow mean the fast one may fall short of before it counts; at least one, which is the textbook's.
    pub tolerance: f64,
    /// Share of explained readings below which the estimate is doubted, in [0, 1]; zero switches the second sign off.
    pub explained: f64,
    /// Share of explained readings at which nothing more could be worse; at most [`explained`](Self::explained).
    pub unexplained: f64,
    /// Weight of the latest observation in the mean share of explained readings, in (0, 1].
    pub smoothing: f64,
    /// Share of new particles where the estimate explains nothing, in [0, 1].
    pub search_share: f64,
    /// Most new particles, as a share of all, in [0, 1]; zero switches recovery off.
    pub max_share: f64,
}

impl Default for RecoveryParams {
    /// The means of `nav2_amcl`'s guide, 0.001 and 0.1, with a tolerance of 1.25 that keeps a filter that tracks from drawing
    /// elsewhere all the time. An estimate is doubted below 0.6 of its readings, which a right pose explains but for the worst
    /// scans (`StatusParams`), and wholly so at 0.35, which a wrong one explains by chance; a quarter of the particles search then.
    fn default() -> Self {
        Self {
            alpha_slow: 0.001,
            alpha_fast: 0.1,
            tolerance: 1.25,
            explained: 0.6,
            unexplained: 0.35,
            smoothing: 0.4,
            search_share: 0.25,
            max_share: 0.5,
        }
    }
}

impl RecoveryParams {
    /// No recovery: particles stay where their ancestors were.
    pub fn never() -> Self {
        Self { max_share: 0.0, ..Self::default() }
    }

    /// Augmented MCL as in the textbook: the first sign alone, without tolerance or limit.
    pub fn augmented(alpha_slow: f64, alpha_fast: f64) -> Self {
        Self {
            alpha_slow,
            alpha_fast,
            tolerance: 1.0,
            explained: 0.0,
            unexplained: 0.0,
            max_share: 1.0,
            ..Self::default()
        }
    }

    /// Checks all fields.
    ///
    /// # Errors
    /// A share or a weight outside its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("alpha_slow", self.alpha_slow, 0.0, 1.0)?;
        check::in_range("alpha_fast", self.alpha_fast, 0.0, 1.0)?;
        check::in_range("tolerance", self.tolerance, 1.0, f64::MAX)?;
        check::in_range("explained", self.explained, 0.0, 1.0)?;
        check::in_range("unexplained", self.unexplained, 0.0, self.explained)?;
        check::positive("smoothing", self.smoothing)?;
        check::in_range("smoothing", self.smoothing, 0.0, 1.0)?;
        check::in_range("search_share", self.search_share, 0.0, 1.0)?;
        check::in_range("max_share", self.max_share, 0.0, 1.0)?;
        Ok(())
    }
}

/// Keeps the means, and says which share of the particles is to be drawn elsewhere.
///
/// ```
/// use agv_filters::particle::{Recovery, RecoveryParams};
///
/// let mut recovery = Recovery::new(RecoveryParams::default())?;
/// // A filter that tracks: beams at half of their best likelihood, nine in ten explained.
/// for _ in 0..100 {
///     assert_eq!(recovery.observed(0.5_f64.ln(), Some(0.9)), 0.0);
/// }
/// // Carried away: in a few observations a good part of the particles search.
/// let shares: Vec<f64> = (0..6).map(|_| recovery.observed(0.05_f64.ln(), Some(0.3))).collect();
/// assert!(shares[5] > 0.3);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawRecovery"))]
pub struct Recovery {
    params: RecoveryParams,
    /// Observations since the belief was given.
    observations: u64,
    slow: f64,
    fast: f64,
    explained: Option<f64>,
}

/// A [`Recovery`] as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawRecovery {
    params: RecoveryParams,
    observations: u64,
    slow: f64,
    fast: f64,
    explained: Option<f64>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawRecovery> for Recovery {
    type Error = Error;

    fn try_from(raw: RawRecovery) -> Result<Self, Error> {
        let RawRecovery { params, observations, slow, fast, explained } = raw;
        check::non_negative("slow mean", slow)?;
        check::non_negative("fast mean", fast)?;
        check::in_range("explained", explained.unwrap_or_default(), 0.0, 1.0)?;
        Ok(Self { observations, slow, fast, explained, ..Self::new(params)? })
    }
}

impl Recovery {
    /// Without a past.
    ///
    /// # Errors
    /// Parameters that [`validate`](RecoveryParams::validate) refuses.
    pub fn new(params: RecoveryParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, observations: 0, slow: 0.0, fast: 0.0, explained: None })
    }

    /// The parameters.
    pub const fn params(&self) -> &RecoveryParams {
        &self.params
    }

    /// Mean likelihood per independent reading, over many observations and over the last ones.
    pub const fn means(&self) -> (f64, f64) {
        (self.slow, self.fast)
    }

    /// Forgets the past: a new belief was given.
    pub fn clear(&mut self) {
        *self = Self { params: self.params, observations: 0, slow: 0.0, fast: 0.0, explained: None };
    }

    /// An observation was applied, with this logarithm of the mean likelihood over the belief, per independent reading, and
    /// this share of readings that the estimate explains. Returns the share of the next set that is to be drawn elsewhere.
    ///
    /// Until a mean has seen as many observations as it averages over, it is the plain mean of those it has seen. A
    /// likelihood that is not a number says nothing.
    pub fn observed(&mut self, log_likelihood: f64, explained: Option<f64>) -> f64 {
        let RecoveryParams { alpha_slow, alpha_fast, tolerance, smoothing, search_share, max_share, .. } = self.params;
        let likelihood = log_likelihood.exp();
        if likelihood.is_finite() {
            self.observations = self.observations.saturating_add(1);
            let least = (self.observations as f64).recip();
            self.slow += alpha_slow.max(least) * (likelihood - self.slow);
            self.fast += alpha_fast.max(least) * (likelihood - self.fast);
        }
        if let Some(share) = explained.filter(|share| share.is_finite()) {
            let share = share.clamp(0.0, 1.0);
            let mean = self.explained.unwrap_or(share);
            self.explained = Some(mean + smoothing * (share - mean));
        }
        let fallen = if alpha_fast > 0.0 && self.slow > 0.0 { 1.0 - tolerance * self.fast / self.slow } else { 0.0 };
        let share = fallen.max(search_share * self.doubt());
        // Of less than a hundredth nothing is found.
        if share < 0.01 { 0.0 } else { share.min(max_share) }
    }

    /// How far the estimate is to be doubted for what it does not explain, from 0 to 1.
    fn doubt(&self) -> f64 {
        let RecoveryParams { explained, unexplained, .. } = self.params;
        let missing = explained - self.explained.unwrap_or(1.0);
        if missing <= 0.0 { 0.0 } else { (missing / (explained - unexplained)).min(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recovery(params: RecoveryParams) -> Recovery {
        Recovery::new(params).unwrap()
    }

    /// The recursion of the textbook, once both means have settled.
    #[test]
    fn the_first_sign_is_that_of_augmented_mcl() {
        let mut recovery = recovery(RecoveryParams::augmented(0.01, 0.1));
        (0..5000).for_each(|_| _ = recovery.observed(0.4_f64.ln(), None));
        for n in 1..30 {
            let share = recovery.observed(0.1_f64.ln(), None);
            let mean = |alpha: f64| 0.1 + 0.3 * (1.0 - alpha).powi(n);
            let expected = 1.0 - mean(0.1) / mean(0.01);
            assert!((share - expected).abs() < 1e-3, "{n}: {share} {expected}");
        }
    }

    #[test]
    fn a_filter_that_was_never_right_is_doubted_by_the_second_sign_alone() {
        let run = |params| {
            let mut recovery = recovery(params);
            (0..50).map(|_| recovery.observed(0.05_f64.ln(), Some(0.2))).last().unwrap()
        };
        assert_eq!(run(RecoveryParams::augmented(0.001, 0.1)), 0.0);
        assert_eq!(run(RecoveryParams::default()), 0.25);
        assert_eq!(run(RecoveryParams::never()), 0.0);
    }

    #[test]
    fn shares_stay_in_range_whatever_comes() {
        let mut recovery = recovery(RecoveryParams::default());
        let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e300, 0.0, 700.0];
        for (index, log_likelihood) in odd.into_iter().cycle().take(60).enumerate() {
            let explained = [None, Some(f64::NAN), Some(-3.0), Some(7.0), Some(0.2)][index % 5];
            let share = recovery.observed(log_likelihood, explained);
            assert!((0.0..=0.5).contains(&share), "{share}");
            assert!(recovery.means().0.is_finite() && recovery.means().1.is_finite());
        }
        recovery.clear();
        assert_eq!(recovery, self::recovery(RecoveryParams::default()));
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = RecoveryParams::default();
        for (name, bad) in [
            ("alpha_slow", RecoveryParams { alpha_slow: 1.1, ..good }),
            ("alpha_fast", RecoveryParams { alpha_fast: f64::NAN, ..good }),
            ("tolerance", RecoveryParams { tolerance: 0.9, ..good }),
            ("explained", RecoveryParams { explained: 2.0, ..good }),
            ("unexplained", RecoveryParams { unexplained: 0.7, ..good }),
            ("smoothing", RecoveryParams { smoothing: 0.0, ..good }),
            ("search_share", RecoveryParams { search_share: -0.1, ..good }),
            ("max_share", RecoveryParams { max_share: 1.5, ..good }),
        ] {
            assert!(Recovery::new(bad).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
