//! What a filter did on a drive.

use super::{
    Result,
    drive::{DT, Drive},
    filters::Filter,
};
use agv_nav::{core::geometry::angle_difference, prelude::*};
use agv_support::timing::Timings;

/// Found: nearer than this, in metres and radians.
const FOUND: (f64, f64) = (0.2, 10.0 * std::f64::consts::PI / 180.0);
/// For so many seconds on end.
const HELD: f64 = 1.0;
/// Seconds after which a vehicle that is not found counts as not found.
pub(crate) const CENSORED: f64 = 30.0;

/// One filter on one drive.
#[derive(Default)]
pub(crate) struct Outcome {
    pub(crate) estimates: Vec<Se2>,
    /// Distances from the truth, in metres.
    pub(crate) errors: Vec<f64>,
    pub(crate) heading_errors: Vec<f64>,
    pub(crate) counts: Vec<usize>,
    /// Seconds from the kidnap until it was found; none if it was not.
    pub(crate) recovery: Option<f64>,
    /// Mean distance from the truth at each stop after the kidnap, in metres.
    pub(crate) stop_errors: Vec<f64>,
    pub(crate) timings: Timings,
    /// Share of the steps on which the filter thought that it tracked while it was not within a metre.
    pub(crate) deceived: f64,
}

/// Lets a filter follow a drive.
pub(crate) fn follow(filter: &mut dyn Filter, drive: &Drive) -> Result<Outcome> {
    let mut out = Outcome::default();
    let (mut standing, mut deceived): (Vec<f64>, usize) = (Vec::new(), 0);
    let after = drive.kidnap.unwrap_or(0);
    for (index, step) in drive.steps.iter().enumerate() {
        let mut timings = Timings::default();
        if timings.time(|| filter.follow(step))? {
            out.timings.append(timings);
        }
        let estimate = filter.pose().unwrap_or_default();
        let error = (estimate.translation() - step.truth.translation()).norm();
        deceived += usize::from(error > 1.0 && filter.status() == LocalizationStatus::Tracking);
        out.errors.push(error);
        out.heading_errors.push(angle_difference(estimate.yaw(), step.truth.yaw()).abs());
        out.estimates.push(estimate);
        out.counts.push(filter.particles().len());
        if step.is_standing && index >= after {
            standing.push(error);
        } else if !standing.is_empty() {
            out.stop_errors.push(standing.iter().sum::<f64>() / standing.len() as f64);
            standing.clear();
        }
    }
    out.deceived = deceived as f64 / drive.steps.len() as f64;
    out.recovery = drive.kidnap.and_then(|kidnap| out.found_from(kidnap)).filter(|&seconds| seconds <= CENSORED);
    Ok(out)
}

impl Outcome {
    /// Whether the estimate is right at a step.
    pub(crate) fn is_right(&self, index: usize) -> bool {
        self.errors[index] < FOUND.0 && self.heading_errors[index] < FOUND.1
    }

    /// Whether the last estimate is within 0.2 m and 5°.
    pub(crate) fn ends_right(&self) -> bool {
        let [error, heading] = [&self.errors, &self.heading_errors].map(|errors| errors.last().copied());
        error.is_some_and(|error| error < 0.2) && heading.is_some_and(|heading| heading < 5_f64.to_radians())
    }

    /// Seconds from a step until the estimate is right, and stays so for a second.
    fn found_from(&self, first: usize) -> Option<f64> {
        let held = (HELD / DT) as usize;
        let is_held = |&index: &usize| (index..index + held).all(|i| self.is_right(i));
        (first..self.errors.len().saturating_sub(held)).find(is_held).map(|index| (index - first + 1) as f64 * DT)
    }

    /// Recovery in seconds, censored.
    pub(crate) fn recovery_or_censored(&self) -> f64 {
        self.recovery.unwrap_or(CENSORED)
    }

    /// Root mean square of the errors before the kidnap, from the third second on: position and heading.
    pub(crate) fn tracking(&self, kidnap: usize) -> (f64, f64) {
        let rms = |values: &[f64]| (values.iter().map(|e| e * e).sum::<f64>() / values.len().max(1) as f64).sqrt();
        let first = (3.0 / DT) as usize;
        (rms(&self.errors[first..kidnap]), rms(&self.heading_errors[first..kidnap]))
    }
}
