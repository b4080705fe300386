//! What engineers read off a step response.

use super::figures::ErrorSums;
use crate::Error;
use agv_core::check;

/// How the figures of a [`StepMetrics`] are defined.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepMetricsParams {
    /// Half width of the band in which a response counts as settled, as a share of the step.
    pub settling_band: f64,
    /// Share of the step at which the rise starts.
    pub rise_start: f64,
    /// Share of the step at which the rise ends.
    pub rise_end: f64,
}

impl Default for StepMetricsParams {
    /// 2 % band and a rise from 10 % to 90 %, as control toolboxes define them (Ogata, *Modern Control Engineering*,
    /// section 5.3).
    fn default() -> Self {
        Self { settling_band: 0.02, rise_start: 0.1, rise_end: 0.9 }
    }
}

/// Figures of a step from one value to a set-point. The response is taken as straight between its samples for the times;
/// the sums are `Σ ... dt` over the samples after the step. Reference is the set-point, not the value that the response
/// ends at: a loop that stops short of it has not settled.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepMetrics {
    /// From the first crossing of [`rise_start`](StepMetricsParams::rise_start) to the first one of
    /// [`rise_end`](StepMetricsParams::rise_end), in seconds; none if it never got there.
    pub rise_time: Option<f64>,
    /// When the response entered the band for the last time, in seconds after the step; none if it ends outside.
    pub settling_time: Option<f64>,
    /// Greatest excess over the set-point as a share of the step; zero if there was none.
    pub overshoot: f64,
    /// The sample farthest along the step.
    pub peak: f64,
    /// When that was, in seconds after the step.
    pub peak_time: f64,
    /// Mean error over the last tenth of the samples, in the measurement's unit; none unless the response has settled
    /// or at least stays within a band's width there: what still moves has no steady state.
    pub steady_state_error: Option<f64>,
    /// `Σ |e| dt`.
    pub iae: f64,
    /// `Σ e² dt`.
    pub ise: f64,
    /// `Σ t |e| dt`.
    pub itae: f64,
    /// `Σ t e² dt`.
    pub itse: f64,
}

impl StepMetrics {
    /// Metrics of `outputs`, of which the first is the value before the step and the `k`-th that at `k dt` after it.
    ///
    /// # Errors
    /// Fewer than two samples, one that is not finite, a step of zero, a `dt` that is not positive, or parameters out of
    /// their range.
    pub fn new(outputs: &[f64], set_point: f64, dt: f64, params: StepMetricsParams) -> Result<Self, Error> {
        check::at_least("outputs", outputs.len(), 2)?;
        check::all_finite("outputs", outputs)?;
        check::finite("set_point", set_point)?;
        check::positive("dt", dt)?;
        check::in_range("settling_band", check::positive("settling_band", params.settling_band)?, 0.0, 1.0)?;
        check::in_range("rise_end", params.rise_end, 0.0, 1.0)?;
        check::in_range("rise_start", params.rise_start, 0.0, params.rise_end)?;
        let (start, step) = (outputs[0], set_point - outputs[0]);
        if step == 0.0 {
            return Err(agv_core::Error::NotPositive { name: "step of the set-point", value: step }.into());
        }
        let share = |y: f64| (y - start) / step;

        let ErrorSums { iae, ise, itae, itse } = ErrorSums::of(outputs.iter().skip(1).map(|y| set_point - y), dt);
        let mut metrics = Self {
            rise_time: None,
            settling_time: None,
            overshoot: 0.0,
            peak: start,
            peak_time: 0.0,
            steady_state_error: None,
            iae,
            ise,
            itae,
            itse,
        };
        for (k, &y) in outputs.iter().enumerate().skip(1) {
            if share(y) > share(metrics.peak) {
                (metrics.peak, metrics.peak_time) = (y, k as f64 * dt);
            }
        }
        metrics.overshoot = (share(metrics.peak) - 1.0).max(0.0);

        let first_at = |level: f64| {
            let k = outputs.iter().position(|&y| share(y) >= level)?;
            let Some(before) = k.checked_sub(1) else { return Some(0.0) };
            Some((before as f64 + between(share(outputs[before]), share(outputs[k]), level)) * dt)
        };
        if let (Some(from), Some(to)) = (first_at(params.rise_start), first_at(params.rise_end)) {
            metrics.rise_time = Some(to - from);
        }

        let outside = outputs.iter().rposition(|&y| (share(y) - 1.0).abs() > params.settling_band);
        metrics.settling_time = match outside {
            None => Some(0.0),
            Some(last) if last + 1 == outputs.len() => None,
            Some(last) => {
                let (y, next) = (share(outputs[last]), share(outputs[last + 1]));
                let edge = if y > 1.0 { 1.0 + params.settling_band } else { 1.0 - params.settling_band };
                Some((last as f64 + between(y, next, edge)) * dt)
            }
        };

        let tail = &outputs[outputs.len() - (outputs.len() / 10).max(1)..];
        let (low, high) = tail.iter().fold((f64::MAX, f64::MIN), |(low, high), &y| (low.min(y), high.max(y)));
        let still = tail.len() > 1 && (high - low) <= params.settling_band * step.abs();
        if still || metrics.settling_time.is_some() {
            metrics.steady_state_error = Some(set_point - tail.iter().sum::<f64>() / tail.len() as f64);
        }
        Ok(metrics)
    }
}

/// Where between two samples, as a share of their distance, a level is crossed.
fn between(before: f64, after: f64, level: f64) -> f64 {
    if after == before { 1.0 } else { ((level - before) / (after - before)).clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(horizon: f64, dt: f64, y: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..=(horizon / dt).round() as usize).map(|k| y(k as f64 * dt)).collect()
    }

    /// `1 - exp(-t)`: rise `ln 9`, settling `ln 50`, no overshoot, IAE 1, ISE 1/2, ITAE 1, ITSE 1/4.
    #[test]
    fn first_order() {
        let dt = 1e-3;
        let m =
            StepMetrics::new(&sampled(20.0, dt, |t| 1.0 - (-t).exp()), 1.0, dt, StepMetricsParams::default()).unwrap();
        assert!((m.rise_time.unwrap() - 9.0_f64.ln()).abs() < 1e-6);
        assert!((m.settling_time.unwrap() - 50.0_f64.ln()).abs() < 1e-6);
        assert_eq!(m.overshoot, 0.0);
        assert!(m.steady_state_error.unwrap().abs() < 1e-7);
        for (sum, expected) in [(m.iae, 1.0), (m.ise, 0.5), (m.itae, 1.0), (m.itse, 0.25)] {
            assert!((sum - expected).abs() < 1e-3, "{sum} {expected}");
        }
    }

    /// Damping ζ = 0.3, ω = 2: overshoot `exp(-π ζ / √(1-ζ²))` at `π / (ω √(1-ζ²))`. A step down from 5 to 3 is the same.
    #[test]
    fn second_order_and_its_mirror() {
        let (zeta, omega, dt) = (0.3_f64, 2.0, 1e-3);
        let root = (1.0 - zeta * zeta).sqrt();
        let y = |t: f64| {
            1.0 - (-zeta * omega * t).exp() * ((omega * root * t).cos() + zeta / root * (omega * root * t).sin())
        };
        let up = StepMetrics::new(&sampled(30.0, dt, y), 1.0, dt, StepMetricsParams::default()).unwrap();
        assert!((up.overshoot - (-std::f64::consts::PI * zeta / root).exp()).abs() < 1e-6);
        assert!((up.peak_time - std::f64::consts::PI / (omega * root)).abs() < dt);
        assert!((up.peak - 1.0 - up.overshoot).abs() < 1e-12);
        let down =
            StepMetrics::new(&sampled(30.0, dt, |t| 5.0 - 2.0 * y(t)), 3.0, dt, StepMetricsParams::default()).unwrap();
        assert!((down.overshoot - up.overshoot).abs() < 1e-9);
        assert!((down.rise_time.unwrap() - up.rise_time.unwrap()).abs() < 1e-9);
        assert!((down.settling_time.unwrap() - up.settling_time.unwrap()).abs() < 1e-9);
        assert!((down.iae - 2.0 * up.iae).abs() < 1e-9);
    }

    #[test]
    fn what_did_not_happen_is_none() {
        let metrics = |y: &dyn Fn(f64) -> f64| {
            StepMetrics::new(&sampled(10.0, 0.01, y), 1.0, 0.01, StepMetricsParams::default()).unwrap()
        };
        let short = metrics(&|t| 0.8 * (1.0 - (-3.0 * t).exp()));
        assert_eq!((short.rise_time, short.settling_time), (None, None));
        assert!((short.steady_state_error.unwrap() - 0.2).abs() < 1e-9);
        let swinging = metrics(&|t| 1.0 - (3.0 * t).cos());
        assert!(swinging.rise_time.is_some());
        assert_eq!((swinging.settling_time, swinging.steady_state_error), (None, None));
        let still = metrics(&|_| 0.0);
        assert_eq!((still.rise_time, still.settling_time, still.peak_time), (None, None, 0.0));
    }

    #[test]
    fn bad_input_is_refused() {
        let (good, p) = ([0.0, 0.5, 1.0], StepMetricsParams::default());
        assert!(StepMetrics::new(&good, 1.0, 0.1, p).is_ok());
        assert!(StepMetrics::new(&[], 1.0, 0.1, p).is_err());
        assert!(StepMetrics::new(&[0.0], 1.0, 0.1, p).is_err());
        assert!(StepMetrics::new(&[0.0, f64::NAN], 1.0, 0.1, p).is_err());
        assert!(StepMetrics::new(&good, 0.0, 0.1, p).is_err(), "no step");
        assert!(StepMetrics::new(&good, f64::INFINITY, 0.1, p).is_err());
        assert!(StepMetrics::new(&good, 1.0, 0.0, p).is_err());
        for bad in [
            StepMetricsParams { settling_band: 0.0, ..p },
            StepMetricsParams { settling_band: f64::NAN, ..p },
            StepMetricsParams { rise_start: 0.95, ..p },
            StepMetricsParams { rise_end: 1.5, ..p },
        ] {
            assert!(StepMetrics::new(&good, 1.0, 0.1, bad).is_err(), "{bad:?}");
        }
    }
}
