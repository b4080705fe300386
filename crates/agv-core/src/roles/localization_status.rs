//! Whether an estimate can be trusted, from the spread of the belief and from how well it explains the observations.
//!
//! ```text
//!                    confirmed, narrow, explained
//!    Converging  ------------------------------->  Tracking
//!        |                                          |   ^
//!        | narrow, unexplained    wide, unexplained |   | narrow, explained
//!        +------------->  Lost  <-------------------+   |
//!                          +----------------------------+
//! ```
//!
//! A belief that is narrow in the wrong place looks as sure of itself as one in the right place: only the observations
//! tell the two apart. Each threshold is a pair, so that a value near it does not make the status flicker.

use super::{SkipReason, UpdateOutcome};
use crate::{
    Error, check,
    geometry::{LieGroup, UncertainPose},
};

/// How far an estimate can be trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum LocalizationStatus {
    /// There is no belief yet.
    Uninitialized,
    /// The belief was given and is not yet narrowed down and confirmed by observations.
    Converging {
        /// What is missing.
        doubt: Doubt,
    },
    /// The belief is narrow, and explains what is observed.
    Tracking,
    /// The belief is no longer to be trusted: do not drive on it.
    Lost {
        /// What speaks against it.
        doubt: Doubt,
    },
}

/// Why an estimate is not trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Doubt {
    /// Fewer observations than needed were applied since the belief was given.
    Unconfirmed,
    /// The belief is too wide.
    Spread {
        /// Deviation of the position, in metres.
        position: f64,
        /// Deviation of the rotation, in radians.
        rotation: f64,
    },
    /// The estimate explains too little of what is observed.
    Unexplained {
        /// Share of the usable readings that it explained over the last updates.
        share: f64,
    },
}

/// Thresholds of a [`StatusMonitor`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StatusParams {
    /// Deviation of the position up to which a belief is narrow, in metres.
    pub narrow_position: f64,
    /// Deviation of the rotation up to which a belief is narrow, in radians.
    pub narrow_rotation: f64,
    /// How many times that a tracked belief may widen before it is lost; at least one.
    pub widening: f64,
    /// Share of explained readings from which on observations confirm the belief, in [0, 1].
    pub explained: f64,
    /// Share of explained readings below which they contradict it; at most [`explained`](Self::explained).
    pub unexplained: f64,
    /// Weight of the latest update in the mean share, in (0, 1].
    pub smoothing: f64,
    /// Observations that must be applied before a belief counts as confirmed.
    pub confirmations: u64,
}

impl Default for StatusParams {
    /// 0.3 m and 0.2 rad, within which planners for aisles can still work; three times that is a metre.
    ///
    /// Of the beams of the Intel log, 0.98 end within 0.2 m of what the map shows if the pose is right (0.83 in the worst
    /// hundredth of the scans), 0.39 if it is off by half a metre and 0.25 anywhere else: 0.6 and 0.4 lie between, with room for
    /// people and pallets. Three updates are 0.6 m of travel at the usual update distance of 0.2 m.
    fn default() -> Self {
        Self {
            narrow_position: 0.3,
            narrow_rotation: 0.2,
            widening: 3.0,
            explained: 0.6,
            unexplained: 0.4,
            smoothing: 0.2,
            confirmations: 3,
        }
    }
}

impl StatusParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A deviation that is not finite and positive, a widening below one, shares outside [0, 1] or in the wrong order, or
    /// a smoothing outside (0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("narrow_position", self.narrow_position)?;
        check::positive("narrow_rotation", self.narrow_rotation)?;
        check::in_range("widening", self.widening, 1.0, f64::MAX)?;
        check::in_range("explained", self.explained, 0.0, 1.0)?;
        check::in_range("unexplained", self.unexplained, 0.0, self.explained)?;
        check::positive("smoothing", self.smoothing)?;
        check::in_range("smoothing", self.smoothing, 0.0, 1.0)?;
        Ok(())
    }
}

/// Derives a [`LocalizationStatus`] from what a localizer's calls bring; any player of the role can keep one.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::roles::{LocalizationStatus, StatusMonitor, StatusParams, UpdateOutcome, UpdateReport};
///
/// let mut monitor = StatusMonitor::new(StatusParams::default())?;
/// assert_eq!(monitor.status(), LocalizationStatus::Uninitialized);
/// let estimate = UncertainPose::new(Se2::new(2.0, 1.0, 0.0), Matrix3::identity() * 1e-4)?;
/// monitor.initialized(&estimate);
/// assert!(matches!(monitor.status(), LocalizationStatus::Converging { .. }));
/// for _ in 0..3 {
///     monitor.updated(&estimate, &UpdateOutcome::Applied(UpdateReport::explaining(0.9)));
/// }
/// assert_eq!(monitor.status(), LocalizationStatus::Tracking);
/// // The vehicle is carried away: the belief stays narrow, but the scans do not fit any more.
/// for _ in 0..10 {
///     monitor.updated(&estimate, &UpdateOutcome::Applied(UpdateReport::explaining(0.1)));
/// }
/// assert!(matches!(monitor.status(), LocalizationStatus::Lost { .. }));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawMonitor"))]
pub struct StatusMonitor {
    params: StatusParams,
    status: LocalizationStatus,
    /// Observations applied since the belief was given.
    applied: u64,
    /// Mean share of explained readings over the last updates.
    share: Option<f64>,
}

/// A [`StatusMonitor`] as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawMonitor {
    params: StatusParams,
    status: LocalizationStatus,
    applied: u64,
    share: Option<f64>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawMonitor> for StatusMonitor {
    type Error = Error;

    fn try_from(raw: RawMonitor) -> Result<Self, Error> {
        let RawMonitor { params, status, applied, share } = raw;
        params.validate()?;
        if let Some(share) = share {
            check::in_range("share", share, 0.0, 1.0)?;
        }
        Ok(Self { params, status, applied, share })
    }
}

impl StatusMonitor {
    /// A monitor of a localizer without a belief.
    ///
    /// # Errors
    /// Parameters that [`validate`](StatusParams::validate) refuses.
    pub fn new(params: StatusParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, status: LocalizationStatus::Uninitialized, applied: 0, share: None })
    }

    /// The thresholds.
    pub const fn params(&self) -> &StatusParams {
        &self.params
    }

    /// The status now.
    pub const fn status(&self) -> LocalizationStatus {
        self.status
    }

    /// Mean share of explained readings over the last updates, as far as they told.
    pub const fn explained(&self) -> Option<f64> {
        self.share
    }

    /// A belief was given.
    pub fn initialized<G: LieGroup>(&mut self, estimate: &UncertainPose<G>) {
        (self.applied, self.share) = (0, None);
        self.status = LocalizationStatus::Converging { doubt: Doubt::Unconfirmed };
        self.judge(estimate);
    }

    /// The belief followed a motion.
    pub fn moved<G: LieGroup>(&mut self, estimate: &UncertainPose<G>) {
        self.judge(estimate);
    }

    /// An observation was applied or skipped, which led to this estimate.
    ///
    /// One that was gated or that nothing explains counts as an observation of which nothing is explained; other skipped
    /// ones say nothing.
    pub fn updated<G: LieGroup>(&mut self, estimate: &UncertainPose<G>, outcome: &UpdateOutcome) {
        let explained = match outcome {
            UpdateOutcome::Applied(report) => {
                self.applied = self.applied.saturating_add(1);
                report.explained
            }
            UpdateOutcome::Skipped(SkipReason::Gated { .. } | SkipReason::Unexplained) => Some(0.0),
            UpdateOutcome::Skipped(_) => return,
        };
        // The mean of a belief that is still spread over a building explains nothing and says nothing.
        let is_open = matches!(self.status, LocalizationStatus::Converging { .. }) && !self.is_within(estimate, 1.0);
        if let Some(explained) = explained.filter(|share| !is_open && share.is_finite()) {
            let explained = explained.clamp(0.0, 1.0);
            let mean = self.share.unwrap_or(explained);
            self.share = Some(mean + self.params.smoothing * (explained - mean));
        }
        self.judge(estimate);
    }

    fn is_within<G: LieGroup>(&self, estimate: &UncertainPose<G>, factor: f64) -> bool {
        estimate.position_deviation() <= factor * self.params.narrow_position
            && estimate.rotation_deviation() <= factor * self.params.narrow_rotation
    }

    fn judge<G: LieGroup>(&mut self, estimate: &UncertainPose<G>) {
        use LocalizationStatus::{Converging, Lost, Tracking, Uninitialized};
        let spread = Doubt::Spread { position: estimate.position_deviation(), rotation: estimate.rotation_deviation() };
        let is_narrow = self.is_within(estimate, 1.0);
        let share = self.share.unwrap_or(1.0);
        let unexplained = Doubt::Unexplained { share };
        let is_confirmed = self.applied >= self.params.confirmations;
        self.status = match self.status {
            Uninitialized => Uninitialized,
            Tracking if !self.is_within(estimate, self.params.widening) => Lost { doubt: spread },
            Converging { .. } if !is_narrow => Converging { doubt: spread },
            Converging { .. } if !is_confirmed => Converging { doubt: Doubt::Unconfirmed },
            Lost { .. } if !is_narrow => Lost { doubt: spread },
            Tracking | Converging { .. } if share < self.params.unexplained => Lost { doubt: unexplained },
            Converging { .. } if share < self.params.explained => Converging { doubt: unexplained },
            Lost { .. } if share < self.params.explained => Lost { doubt: unexplained },
            Tracking | Converging { .. } | Lost { .. } => Tracking,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{geometry::Se2, roles::UpdateReport};
    use nalgebra::{Matrix3, Vector3};

    fn pose(position: f64, heading: f64) -> UncertainPose<Se2> {
        let variances = Vector3::new(position * position, 0.0, heading * heading);
        UncertainPose::new(Se2::new(1.0, 2.0, 3.0), Matrix3::from_diagonal(&variances)).unwrap()
    }

    fn tracking() -> StatusMonitor {
        let mut monitor = StatusMonitor::new(StatusParams::default()).unwrap();
        monitor.initialized(&pose(0.1, 0.05));
        see(&mut monitor, 0.9, 3);
        assert_eq!(monitor.status(), LocalizationStatus::Tracking);
        monitor
    }

    fn see(monitor: &mut StatusMonitor, share: f64, times: usize) {
        for _ in 0..times {
            monitor.updated(&pose(0.05, 0.02), &UpdateOutcome::Applied(UpdateReport::explaining(share)));
        }
    }

    #[test]
    fn a_wide_belief_converges_whatever_its_mean_explains() {
        let mut monitor = StatusMonitor::new(StatusParams::default()).unwrap();
        monitor.initialized(&pose(8.0, 1.8));
        for _ in 0..20 {
            monitor.updated(&pose(5.0, 1.0), &UpdateOutcome::Applied(UpdateReport::explaining(0.0)));
        }
        assert!(matches!(monitor.status(), LocalizationStatus::Converging { doubt: Doubt::Spread { .. } }));
        see(&mut monitor, 0.8, 1);
        assert_eq!(monitor.status(), LocalizationStatus::Tracking);
    }

    #[test]
    fn narrow_in_the_wrong_place_is_lost_until_it_fits_again() {
        let mut monitor = tracking();
        see(&mut monitor, 0.1, 10);
        assert!(
            matches!(monitor.status(), LocalizationStatus::Lost { doubt: Doubt::Unexplained { share } } if share < 0.4)
        );
        // Between the two thresholds nothing changes.
        see(&mut monitor, 0.5, 30);
        assert!(matches!(monitor.status(), LocalizationStatus::Lost { .. }));
        see(&mut monitor, 0.8, 5);
        assert_eq!(monitor.status(), LocalizationStatus::Tracking);
        see(&mut monitor, 0.5, 30);
        assert_eq!(monitor.status(), LocalizationStatus::Tracking);
    }

    #[test]
    fn observations_that_nothing_explains_count_and_skipped_ones_do_not() {
        let mut monitor = tracking();
        let estimate = pose(0.05, 0.02);
        for skip in [SkipReason::LittleMotion, SkipReason::TooFewReadings { usable: 0, needed: 5 }] {
            let before = monitor;
            (0..30).for_each(|_| monitor.updated(&estimate, &UpdateOutcome::Skipped(skip)));
            assert_eq!(monitor, before);
        }
        (0..10).for_each(|_| monitor.updated(&estimate, &UpdateOutcome::Skipped(SkipReason::Unexplained)));
        assert!(matches!(monitor.status(), LocalizationStatus::Lost { .. }));
    }

    #[test]
    fn driving_blind_loses_the_place_in_the_end() {
        let mut monitor = tracking();
        monitor.moved(&pose(0.6, 0.1));
        assert_eq!(monitor.status(), LocalizationStatus::Tracking, "within the hysteresis");
        monitor.moved(&pose(0.95, 0.1));
        assert!(matches!(monitor.status(), LocalizationStatus::Lost { doubt: Doubt::Spread { .. } }));
        monitor.moved(&pose(0.6, 0.1));
        assert!(matches!(monitor.status(), LocalizationStatus::Lost { .. }), "within the hysteresis");
        see(&mut monitor, 0.9, 1);
        assert_eq!(monitor.status(), LocalizationStatus::Tracking);
    }

    #[test]
    fn a_localizer_that_cannot_tell_what_it_explains_is_judged_by_its_spread() {
        let mut monitor = StatusMonitor::new(StatusParams::default()).unwrap();
        monitor.initialized(&pose(0.1, 0.1));
        for _ in 0..3 {
            monitor.updated(&pose(0.1, 0.1), &UpdateOutcome::Applied(UpdateReport::default()));
        }
        assert_eq!((monitor.status(), monitor.explained()), (LocalizationStatus::Tracking, None));
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = StatusParams::default();
        for (name, bad) in [
            ("narrow_position", StatusParams { narrow_position: 0.0, ..good }),
            ("narrow_rotation", StatusParams { narrow_rotation: f64::NAN, ..good }),
            ("widening", StatusParams { widening: 0.9, ..good }),
            ("explained", StatusParams { explained: 1.1, ..good }),
            ("unexplained", StatusParams { unexplained: 0.7, ..good }),
            ("smoothing", StatusParams { smoothing: 0.0, ..good }),
        ] {
            assert!(StatusMonitor::new(bad).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
