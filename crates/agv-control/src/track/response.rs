//! How a vehicle answers to commands: its drives lag, and its wheels slip.
//!
//! Drives follow a commanded twist `u` late, `u_actual' = (u - u_actual) / τ`, and a slipping or worn wheel turns the vehicle by
//! another share than commanded, `θ' = g ω_actual`. The first is a model that runs along; the second is learnt from the poses
//! by a Kalman filter of two states, the heading and `g`:
//!
//! ```text
//! θ += g ω_actual dt        innovation = measured heading - θ
//! ```
//!
//! Steering by where the vehicle will be takes the lag out of the loop (Smith, *Closer control of loops with dead time*, 1957):
//! in errors `y' = v e`, `e' = ω - v κ`, the predicted ones, `y + v τ e` and `e + τ (ω - v κ)`, follow the command without delay,
//! exactly.

use super::lateral::Sampled;
use agv_core::geometry::{LieGroup, So2, Twist2, small_angle};
use nalgebra::UnitComplex;

/// What is known of the drives.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Response {
    /// Time constant of the lag, in seconds.
    time: f64,
    /// Velocity that the vehicle is believed to have, without slip; none before the first cycle.
    twist: Option<Twist2>,
    /// The lag over a cycle.
    cycle: Sampled,
    slip: YawSlip,
}

impl Response {
    pub(super) fn new(time: f64, max_slip: f64) -> Self {
        Self { time, twist: None, cycle: Sampled::new(time, 0.0), slip: YawSlip::new(max_slip) }
    }

    pub(super) const fn time(&self) -> f64 {
        self.time
    }

    /// Yaw per commanded yaw.
    pub(super) const fn yaw_gain(&self) -> f64 {
        self.slip.gain
    }

    /// Takes what the drives were told in the last `dt` seconds and the heading that came of it; returns the velocity that the
    /// vehicle has now, slip and all.
    #[inline]
    pub(super) fn update(&mut self, told: &Twist2, heading: So2, dt: f64) -> Twist2 {
        if self.cycle.dt != dt {
            self.cycle = Sampled::new(self.time, dt);
        }
        let left = self.cycle.kept;
        let before = self.twist.unwrap_or(*told);
        let mix = |told: f64, before: f64| told + left * (before - told);
        let now = Twist2::new(mix(told.vx, before.vx), mix(told.vy, before.vy), mix(told.yaw_rate, before.yaw_rate));
        // What was told may have been near the end of the numbers.
        let now = if now.is_finite() { now } else { *told };
        self.twist = Some(now);
        self.slip.update(0.5 * (before.yaw_rate + now.yaw_rate) * dt, heading, dt);
        Twist2::new(now.vx, now.vy, self.slip.gain * now.yaw_rate)
    }
}

/// Learns how much a vehicle turns per commanded turn.
#[derive(Debug, Clone, PartialEq)]
struct YawSlip {
    /// Greatest share by which the gain differs from one.
    max: f64,
    gain: f64,
    heading: Option<So2>,
    /// Variances of the heading and the gain, and their covariance.
    heading_variance: f64,
    gain_variance: f64,
    covariance: f64,
}

/// Variance of a measured heading: 0.01 rad, what localisation by a laser scanner gives.
const HEADING_NOISE: f64 = 1e-4;
/// Growth of the heading's variance per second: what the model leaves out, 0.01 rad in the first second.
const HEADING_DRIFT: f64 = 1e-4;
/// Growth of the gain's variance per second: floors and tyres change by 2 % a minute.
const GAIN_DRIFT: f64 = 4e-4 / 60.0;
/// Sine of the innovation beyond which the pose has jumped: nothing is learnt from that.
const JUMP: f64 = 0.2;

impl YawSlip {
    const fn new(max: f64) -> Self {
        Self {
            max,
            gain: 1.0,
            heading: None,
            heading_variance: HEADING_NOISE,
            gain_variance: 0.25 * max * max,
            covariance: 0.0,
        }
    }

    /// Takes a turn that was commanded, in radians, and the heading after it.
    #[inline]
    fn update(&mut self, turn: f64, measured: So2, dt: f64) {
        if self.max == 0.0 {
            return;
        }
        let Some(heading) = self.heading else {
            self.heading = Some(measured);
            return;
        };
        let predicted = heading.compose(&small(self.gain * turn));
        let between = predicted.inverse().compose(&measured);
        let innovation = between.sin();
        // Put so that what is not a number is no innovation either.
        let usual = innovation.abs() <= JUMP && between.cos() >= 0.0;
        if !usual {
            (self.heading, self.heading_variance, self.covariance) = (Some(measured), HEADING_NOISE, 0.0);
            return;
        }
        let covariance = self.covariance + turn * self.gain_variance;
        let heading_variance = self.heading_variance + turn * (self.covariance + covariance) + HEADING_DRIFT * dt;
        let gain_variance = (self.gain_variance + GAIN_DRIFT * dt).min(0.25 * self.max * self.max);
        let weight = 1.0 / (heading_variance + HEADING_NOISE);
        let (to_heading, to_gain) = (heading_variance * weight, covariance * weight);
        if !(to_heading.is_finite() && to_gain.is_finite()) {
            return;
        }
        self.heading = Some(predicted.compose(&small(to_heading * innovation)));
        self.gain = (self.gain + to_gain * innovation).clamp(1.0 - self.max, 1.0 + self.max);
        self.heading_variance = (1.0 - to_heading) * heading_variance;
        self.covariance = (1.0 - to_heading) * covariance;
        self.gain_variance = gain_variance - to_gain * covariance;
    }
}

/// A rotation by an angle in radians that is small, unless the pose has jumped.
#[inline]
fn small(angle: f64) -> So2 {
    let (sin, cos) = small_angle::sin_cos(angle);
    UnitComplex::from_cos_sin_unchecked(cos, sin).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;
    use proptest::prelude::*;
    use rand_distr::{Distribution, Normal};

    /// A vehicle that weaves for a minute.
    fn learnt(gain: f64, lag: f64, noise: f64, seed: u64) -> f64 {
        let (dt, noise, mut stream) = (0.02, Normal::new(0.0, noise).unwrap(), Seed(seed).stream(0, 0));
        let mut response = Response::new(0.15, 0.1);
        let (mut yaw, mut rate) = (0.0, 0.0);
        for i in 0..3000 {
            let told = 0.8 * (f64::from(i) * dt).sin();
            let before: f64 = rate;
            rate = told + (-dt / lag).exp() * (rate - told);
            yaw += 0.5 * gain * (before + rate) * dt;
            let measured = So2::from_angle(yaw + noise.sample(&mut stream));
            response.update(&Twist2::new(0.5, 0.0, told), measured, dt);
        }
        response.yaw_gain()
    }

    proptest! {
        /// With noise of half a degree the gain is learnt to one percent within a minute, to two if the lag is another.
        #[test]
        fn slip_is_learnt(gain in 0.93..1.07_f64, lag in 0.1..0.25_f64, seed: u64) {
            prop_assert!((learnt(gain, lag, 0.009, seed) - gain).abs() < 0.02);
            prop_assert!((learnt(gain, 0.15, 0.009, seed) - gain).abs() < 0.012);
        }

        /// `y + v τ e` and `e + τ ω` follow the command as `y' = v e`, `e' = u` do.
        #[test]
        fn predicted_errors_do_not_lag(commands in prop::collection::vec(-1.0..1.0_f64, 1..20)) {
            let (tau, dt, v) = (0.15, 1e-4, 0.8);
            let (mut y, mut e, mut rate) = (0.1, 0.2, 0.0);
            let (mut ahead_y, mut ahead_e) = (y + v * tau * e, e + tau * rate);
            for command in commands {
                for _ in 0..500 {
                    y += v * e * dt;
                    e += rate * dt;
                    rate += (command - rate) / tau * dt;
                    ahead_y += v * ahead_e * dt;
                    ahead_e += command * dt;
                }
            }
            prop_assert!((ahead_e - (e + tau * rate)).abs() < 1e-9 && (ahead_y - (y + v * tau * e)).abs() < 1e-3);
        }
    }

    #[test]
    fn a_gain_stays_within_its_bounds_and_jumps_teach_nothing() {
        assert!((learnt(2.0, 0.15, 0.0, 0) - 1.1).abs() < 1e-12);
        let mut response = Response::new(0.15, 0.1);
        for i in 0..100 {
            response.update(&Twist2::new(0.0, 0.0, 1.0), So2::from_angle(f64::from(i)), 0.02);
        }
        assert_eq!(response.yaw_gain(), 1.0);
    }

    #[test]
    fn without_lag_and_slip_told_is_done() {
        let mut response = Response::new(0.0, 0.0);
        let twist = Twist2::new(0.3, 0.1, 0.7);
        assert_eq!(response.update(&twist, So2::default(), 0.02), twist);
    }
}
