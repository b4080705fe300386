//! When a belief is to be doubted, and by how much: the share of new particles that are drawn elsewhere.
//!
//! Three signs. The first is that of Augmented MCL (Gutmann and Fox 2002; Thrun, Burgard and Fox, *Probabilistic Robotics*,
//! Table 8.3): the mean likelihood of the observations has fallen below what it used to be.
//!
//! ```text
//! w_slow += α_slow (w - w_slow)      w_fast += α_fast (w - w_fast)      share = max(0, 1 - ν w_fast / w_slow)
//! ```
//!
//! Here `w` is the mean likelihood *per independent reading*, the root of that of the whole observation: a product over many
//! beams falls by orders of magnitude when one person walks by. The second sign
//! is that it has fallen by more than it scatters, in standard deviations of the fast mean: in a place that looks like the right one
//! it falls by little, yet for good. What it used to be says nothing in a filter that has never been right. The third sign needs no
//! past: the estimate explains too few of the readings.

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
    /// By how many of its standard deviations the fast mean may fall below the slow one before it counts; zero switches the
    /// second sign off.
    pub deviations: f64,
    /// Share of explained readings below which the estimate is doubted, in [0, 1]; zero switches the third sign off.
    pub explained: f64,
    /// Weight of the latest observation in the mean share of explained readings, in (0, 1].
    pub smoothing: f64,
    /// Least share of new particles while there is doubt, in [0, 1].
    pub search_share: f64,
    /// Observations over which the search goes on after the last sign of doubt, or after a belief that says nothing: the first
    /// place that fits need not be the right one.
    pub persistence: u32,
    /// Most new particles that doubt brings, as a share of all, in [0, 1]; what observes poses brings its own share
    /// ([`ObservedPose`](super::ObservedPose)). Zero switches both off.
    pub max_share: f64,
}

impl Default for RecoveryParams {
    /// The means of `nav2_amcl`'s guide, 0.001 and 0.1, with a tolerance of 1.2 that keeps a filter that tracks from drawing
    /// elsewhere all the time. An estimate is doubted below 0.6 of its readings, which a right pose explains but for the worst
    /// scans (`StatusParams`). A quarter of the particles search then, for 15 observations: three metres, in which most places
    /// that look alike begin to differ.
    fn default() -> Self {
        Self {
            alpha_slow: 0.001,
            alpha_fast: 0.1,
            tolerance: 1.2,
            deviations: 5.0,
            explained: 0.6,
            smoothing: 0.7,
            search_share: 0.25,
            persistence: 15,
            max_share: 0.5,
        }
    }
}

impl RecoveryParams {
    /// No recovery: particles stay where their ancestors were, whatever is observed.
    pub fn never() -> Self {
        Self { max_share: 0.0, ..Self::default() }
    }

    /// Augmented MCL as in the textbook: the first sign alone, without tolerance or limit.
    pub fn augmented(alpha_slow: f64, alpha_fast: f64) -> Self {
        Self {
            alpha_slow,
            alpha_fast,
            tolerance: 1.0,
            deviations: 0.0,
            explained: 0.0,
            search_share: 0.0,
            persistence: 0,
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
        check::non_negative("deviations", self.deviations)?;
        check::in_range("explained", self.explained, 0.0, 1.0)?;
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
/// assert!(shares.iter().all(|&share| share >= 0.25));
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
    /// Variance of one value about the slow mean, and of the fast mean about it.
    variance: f64,
    wandering: f64,
    explained: Option<f64>,
    /// Observations for which the search goes on.
    searching: u32,
}

/// A [`Recovery`] as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawRecovery {
    params: RecoveryParams,
    observations: u64,
    slow: f64,
    fast: f64,
    variance: f64,
    wandering: f64,
    explained: Option<f64>,
    searching: u32,
}

#[cfg(feature = "serde")]
impl TryFrom<RawRecovery> for Recovery {
    type Error = Error;

    fn try_from(raw: RawRecovery) -> Result<Self, Error> {
        let RawRecovery { params, observations, slow, fast, variance, wandering, explained, searching } = raw;
        check::non_negative("slow mean", slow)?;
        check::non_negative("fast mean", fast)?;
        check::non_negative("variance", variance)?;
        check::non_negative("wandering", wandering)?;
        check::in_range("explained", explained.unwrap_or_default(), 0.0, 1.0)?;
        Ok(Self { observations, slow, fast, variance, wandering, explained, searching, ..Self::new(params)? })
    }
}

impl Recovery {
    /// Without a past.
    ///
    /// # Errors
    /// Parameters that [`validate`](RecoveryParams::validate) refuses.
    pub fn new(params: RecoveryParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self::fresh(params))
    }

    const fn fresh(params: RecoveryParams) -> Self {
        Self {
            params,
            observations: 0,
            slow: 0.0,
            fast: 0.0,
            variance: 0.0,
            wandering: 0.0,
            explained: None,
            searching: 0,
        }
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
        *self = Self::fresh(self.params);
    }

    /// Searches with the next observations whatever they say: the belief says nothing.
    pub fn search(&mut self) {
        self.searching = self.params.persistence;
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
            let difference = likelihood - self.slow;
            self.slow += alpha_slow.max(least) * difference;
            // Of the first value there is no scatter.
            let spread = if self.observations > 1 { difference * (likelihood - self.slow) } else { 0.0 };
            self.variance += alpha_slow.max(least) * (spread - self.variance);
            self.fast += alpha_fast.max(least) * (likelihood - self.fast);
            let off = self.fast - self.slow;
            self.wandering += alpha_slow.max(least) * (off * off - self.wandering);
        }
        if let Some(share) = explained.filter(|share| share.is_finite()) {
            let share = share.clamp(0.0, 1.0);
            let mean = self.explained.unwrap_or(share);
            self.explained = Some(mean + smoothing * (share - mean));
        }
        let fallen = if alpha_fast > 0.0 && self.slow > 0.0 { 1.0 - tolerance * self.fast / self.slow } else { 0.0 };
        let is_unexplained = self.explained.is_some_and(|share| share < self.params.explained);
        // Of less than a hundredth nothing is found.
        let is_in_doubt = is_unexplained || fallen >= 0.01 || self.has_fallen_for_good();
        let is_searching = is_in_doubt || self.searching > 0;
        self.searching = if is_in_doubt { self.params.persistence } else { self.searching.saturating_sub(1) };
        if is_searching { fallen.max(search_share).min(max_share) } else { 0.0 }
    }

    /// Whether the fast mean lies farther below the slow one than it scatters: as it has done so far, and no less than that of white
    /// noise, which with weights that decay by `1 - α` has the variance `α / (2 - α)` of one value's. Real places differ from each
    /// other for as long as the vehicle is in them, so the scatter is mostly the former.
    fn has_fallen_for_good(&self) -> bool {
        /// Observations that a scatter is known from.
        const KNOWN: u64 = 10;
        /// Least scatter of one value that is believed in, relative to the slow mean.
        const LEAST: f64 = 0.02;
        let RecoveryParams { alpha_fast, deviations, .. } = self.params;
        let one = self.variance.sqrt().max(LEAST * self.slow);
        let sigma = (one * (alpha_fast / (2.0 - alpha_fast)).sqrt()).max(self.wandering.sqrt());
        alpha_fast > 0.0 && deviations > 0.0 && self.observations >= KNOWN && self.slow - self.fast > deviations * sigma
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
    fn a_filter_that_was_never_right_is_doubted_by_the_last_sign_alone() {
        let run = |params| {
            let mut recovery = recovery(params);
            (0..50).map(|_| recovery.observed(0.05_f64.ln(), Some(0.2))).last().unwrap()
        };
        assert_eq!(run(RecoveryParams::augmented(0.001, 0.1)), 0.0);
        assert_eq!(run(RecoveryParams::default()), 0.25);
        assert_eq!(run(RecoveryParams::never()), 0.0);
    }

    /// A fall by a tenth, which is five times the scatter of one value, is seen in a few observations; the scatter alone is not
    /// mistaken for one.
    #[test]
    fn a_small_fall_is_seen_where_there_is_little_scatter() {
        let mut recovery = recovery(RecoveryParams::default());
        let scatter = |i: u32| f64::from(i * 37 % 11) * 0.006 - 0.03;
        for i in 0..400 {
            assert_eq!(recovery.observed((0.9 + scatter(i)).ln(), Some(1.0)), 0.0, "{i}");
        }
        let seen = (0..30).position(|i| recovery.observed((0.8 + scatter(i)).ln(), Some(1.0)) > 0.0);
        assert!(seen.is_some_and(|n| n < 10), "{seen:?}");
    }

    #[test]
    fn the_search_goes_on_for_a_while() {
        let mut recovery = recovery(RecoveryParams { persistence: 4, ..Default::default() });
        let mut share = |explained| recovery.observed(0.5_f64.ln(), Some(explained));
        assert_eq!(share(0.9), 0.0);
        (0..5).for_each(|_| assert!(share(0.1) == 0.25 || share(0.1) == 0.25));
        let after: Vec<f64> = (0..12).map(|_| share(1.0)).collect();
        let searched = after.iter().filter(|&&share| share == 0.25).count();
        // One until the mean is back above 0.6, and four more.
        assert!((4..7).contains(&searched) && after[11] == 0.0, "{after:?}");
        recovery.clear();
        recovery.search();
        let shares: Vec<f64> = (0..6).map(|_| recovery.observed(0.5_f64.ln(), Some(1.0))).collect();
        assert_eq!(shares, [0.25, 0.25, 0.25, 0.25, 0.0, 0.0]);
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
            ("deviations", RecoveryParams { deviations: f64::NAN, ..good }),
            ("explained", RecoveryParams { explained: 2.0, ..good }),
            ("smoothing", RecoveryParams { smoothing: 0.0, ..good }),
            ("search_share", RecoveryParams { search_share: -0.1, ..good }),
            ("max_share", RecoveryParams { max_share: 1.5, ..good }),
        ] {
            assert!(Recovery::new(bad).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
