//! What a controller computes from `dt` alone, kept while `dt` does not change.

use super::{AntiWindup, PidParams};
use agv_core::{Error, check};

/// Coefficients for one `dt`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timing {
    /// In seconds; zero for none yet, which no valid `dt` equals.
    pub(super) dt: f64,
    /// `Tf / (Tf + dt)` and `1 / (Tf + dt)`: backward Euler of `Tf d' + d = y'`.
    filter_decay: f64,
    filter_slope: f64,
    /// Whether there is a filter.
    filters: bool,
    /// `Ki dt`.
    pub(super) integral_step: f64,
    /// Whether the change of the output is limited, and how far.
    pub(super) limits_rate: bool,
    pub(super) output_step: f64,
    /// `dt / Tt`, at most one: more would draw the integral beyond its aim.
    pub(super) tracking_share: f64,
}

impl Timing {
    pub(super) const UNSET: Self = Self {
        dt: 0.0,
        filter_decay: 0.0,
        filter_slope: 0.0,
        filters: false,
        integral_step: 0.0,
        limits_rate: false,
        output_step: 0.0,
        tracking_share: 0.0,
    };

    pub(super) fn new(params: &PidParams, dt: f64) -> Result<Self, Error> {
        check::positive("dt", dt)?;
        let filter_slope = 1.0 / (params.filter_time + dt);
        Ok(Self {
            dt,
            filter_decay: params.filter_time * filter_slope,
            filter_slope,
            filters: params.filter_time > 0.0,
            integral_step: params.integral * dt,
            limits_rate: params.output_rate < f64::MAX,
            output_step: params.output_rate * dt,
            tracking_share: match params.anti_windup {
                AntiWindup::BackCalculation { tracking_time } => (dt / tracking_time).min(1.0),
                AntiWindup::Clamping | AntiWindup::Off => 0.0,
            },
        })
    }

    /// The filtered derivative after a change of the measurement.
    #[inline]
    pub(super) fn rate(&self, last: f64, change: f64) -> f64 {
        let fresh = self.filter_slope * change;
        // Without a filter the last rate does not count, and nothing has to wait for it.
        if self.filters { self.filter_decay * last + fresh } else { fresh }
    }
}
