//! How far a loop is from instability: gain margin, phase margin, maximum sensitivity.
//!
//! The loop is the one that runs: a PID controller in discrete time and a plant behind a zero-order hold. With
//! `z = exp(i ω dt)` its open loop is `L = C(z) G(z)`,
//!
//! ```text
//! C(z) = Kp + Ki dt / (1 - 1/z) + Kd (1 - 1/z) / (Tf (1 - 1/z) + dt)
//! G(z) = (C (z - Φ)⁻¹ (Γ + Γ_late / z) + D / z) / z^m
//! ```
//!
//! and the maximum sensitivity is `Ms = max |1 / (1 + L)|`, the inverse of the Nyquist curve's least distance from -1
//! (Åström and Hägglund, *Advanced PID Control*, section 4.6): 1.4 is calm, 2 is brisk. It bounds both classical margins:
//! the gain margin is at least `Ms / (Ms - 1)` and the phase margin at least `2 asin(1 / (2 Ms))`.

use crate::Error;
use crate::plant::{LinearPlant, MAX_ORDER, state_space::Discrete};
use crate::step_response::PidGains;
use agv_core::check;
use nalgebra::{Complex, SMatrix, SVector};

/// Distances of a loop from instability. They are properties of the frequency response: that the loop is stable at all
/// is for a step test to say.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Margins {
    /// Least factor above one by which the gain may grow before the loop is at its limit; none if it may grow at will.
    pub gain_margin: Option<f64>,
    /// Greatest factor below one to which the gain may shrink before the loop is at its limit; none if it may vanish, as
    /// for every plant that is stable by itself.
    pub gain_reduction: Option<f64>,
    /// Least lag that brings the loop to its limit, in radians; none if the open loop's gain never passes one.
    pub phase_margin: Option<f64>,
    /// Frequency at which the phase margin is, in rad/s.
    pub crossover: Option<f64>,
    /// Ms, the maximum sensitivity.
    pub sensitivity: f64,
}

/// The frequency response of a plant, kept for the loops with many sets of gains: margins
/// cost some 12 µs each, ten times a batched step test: a penalty on what is nearly chosen.
///
/// Five decades up to half the sampling rate, sixty frequencies each, are swept; between them the Nyquist curve is taken
/// as straight. Resonances that are narrower than 4 % of their frequency may be missed. Actuator limits do not count.
///
/// ```
/// use agv_control::margin::FrequencySweep;
/// use agv_control::plant::StandIn;
///
/// let sweep = FrequencySweep::new(&StandIn::P1.plant()?, 0.01, 0.02)?;
/// let margins = sweep.margins([3.18, 3.4, 1.61].into());
/// assert!(margins.sensitivity < 1.5 && margins.phase_margin.is_some_and(|pm| pm > 0.9));
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FrequencySweep {
    points: Vec<Point>,
    /// `G(1)`; none for a plant that integrates.
    static_gain: Option<f64>,
}

/// The loop's parts at a frequency; the controller's are those of gains of one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    frequency: f64,
    plant: Complex<f64>,
    integral: Complex<f64>,
    derivative: Complex<f64>,
}

const DECADES: i32 = 5;
const PER_DECADE: i32 = 60;

impl FrequencySweep {
    /// Sweeps a plant that is sampled every `dt` seconds, under controllers with a derivative filter of `filter_time`.
    ///
    /// # Errors
    /// A `dt` that is not positive, a negative filter time, or a plant that cannot be discretised or has a pole on a
    /// frequency of the sweep.
    pub fn new(plant: &LinearPlant, dt: f64, filter_time: f64) -> Result<Self, Error> {
        let discrete = plant.discretise(dt)?;
        check::non_negative("filter_time", filter_time)?;
        let count = DECADES * PER_DECADE;
        let points = (-count..=0).map(|k| {
            let angle = std::f64::consts::PI * 10.0_f64.powf(f64::from(k) / f64::from(PER_DECADE));
            let lag = Complex::from_polar(1.0, -angle);
            let change = Complex::from(1.0) - lag;
            Ok(Point {
                frequency: angle / dt,
                plant: response(&discrete, angle)?,
                integral: Complex::from(dt) / change,
                derivative: change / (change * filter_time + dt),
            })
        });
        let static_gain = Some(plant.transfer_function().dc_gain()).filter(|gain| gain.is_finite());
        Ok(Self { points: points.collect::<Result<_, Error>>()?, static_gain })
    }

    /// Margins of the loop under some gains. Gains that are not numbers have the worst of all margins.
    pub fn margins(&self, gains: PidGains) -> Margins {
        let PidGains { proportional, integral, derivative } = gains;
        if !gains.can_be_simulated() {
            return Margins {
                gain_margin: Some(1.0),
                gain_reduction: Some(1.0),
                phase_margin: Some(0.0),
                crossover: None,
                sensitivity: f64::INFINITY,
            };
        }
        let mut margins =
            Margins { gain_margin: None, gain_reduction: None, phase_margin: None, crossover: None, sensitivity: 0.0 };
        // Both ends of the curve are on the real axis, unless it comes from infinity.
        if let (Some(gain), 0.0) = (self.static_gain, integral) {
            margins.at_axis(proportional * gain);
        }
        let mut last: Option<(f64, Complex<f64>)> = None;
        for point in &self.points {
            let controller = point.integral * integral + point.derivative * derivative + proportional;
            let open = controller * point.plant;
            let sensitivity = 1.0 / (open + 1.0).norm();
            margins.sensitivity = margins.sensitivity.max(sensitivity);
            if let Some((frequency, before)) = last {
                margins.cross_axis(before, open);
                margins.cross_circle((frequency, before), (point.frequency, open));
            }
            last = Some((point.frequency, open));
        }
        if let Some((_, open)) = last {
            margins.at_axis(open.re);
        }
        margins
    }
}

impl Margins {
    /// Takes a piece of the Nyquist curve that may cross the negative real axis.
    fn cross_axis(&mut self, from: Complex<f64>, to: Complex<f64>) {
        if (from.im < 0.0) != (to.im < 0.0) {
            self.at_axis(from.re + (to.re - from.re) * from.im / (from.im - to.im));
        }
    }

    fn at_axis(&mut self, real: f64) {
        let factor = -1.0 / real;
        if factor >= 1.0 && factor.is_finite() {
            self.gain_margin = Some(self.gain_margin.map_or(factor, |least| least.min(factor)));
        } else if factor > 0.0 && factor.is_finite() {
            self.gain_reduction = Some(self.gain_reduction.map_or(factor, |most| most.max(factor)));
        }
    }

    /// Takes a piece of the Nyquist curve that may cross the unit circle.
    fn cross_circle(&mut self, from: (f64, Complex<f64>), to: (f64, Complex<f64>)) {
        let (outside, inside) = (from.1.norm().ln(), to.1.norm().ln());
        if (outside < 0.0) == (inside < 0.0) {
            return;
        }
        let share = outside / (outside - inside);
        let turn = (to.1 / from.1).arg();
        // Lag down to -180°, in [0, 2 π).
        let margin = (from.1.arg() + share * turn + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
        if self.phase_margin.is_none_or(|least| margin < least) {
            self.phase_margin = Some(margin);
            self.crossover = Some(from.0 * (to.0 / from.0).powf(share));
        }
    }
}

/// `G(z)` at `z = exp(i angle)`.
fn response(plant: &Discrete, angle: f64) -> Result<Complex<f64>, Error> {
    let (z, lag) = (Complex::from_polar(1.0, angle), Complex::from_polar(1.0, -angle));
    let system = SMatrix::<Complex<f64>, MAX_ORDER, MAX_ORDER>::from_fn(|i, j| {
        Complex::from(-plant.a[i][j]) + if i == j { z } else { Complex::from(0.0) }
    });
    let input = SVector::<Complex<f64>, MAX_ORDER>::from_fn(|i, _| lag * plant.b_late[i] + plant.b[i]);
    let state = system.lu().solve(&input).ok_or(Error::Overflow { name: "frequency response" })?;
    let free = state.iter().zip(&plant.c).fold(lag * plant.d, |sum, (x, c)| sum + x * *c);
    let result = free * Complex::from_polar(1.0, -angle * plant.delay as f64);
    if result.is_finite() { Ok(result) } else { Err(Error::Overflow { name: "frequency response" }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::TransferFunction;
    use crate::step_response::{StepTest, StepTestParams};
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn plant(numerator: &[f64], denominator: &[f64]) -> LinearPlant {
        LinearPlant::new(TransferFunction::new(numerator, denominator).unwrap()).unwrap()
    }

    fn proportional(gain: f64) -> PidGains {
        PidGains { proportional: gain, ..PidGains::default() }
    }

    /// `L = k dt / (z - 1)`: crossover where `2 sin(ω dt / 2) = k dt`, phase `-π/2 - ω dt / 2`, limit at `k dt = 2`,
    /// greatest sensitivity at half the sampling rate.
    #[test]
    fn sampled_integrator() {
        let (dt, k) = (0.1, 3.0);
        let margins = FrequencySweep::new(&plant(&[1.0], &[1.0, 0.0]), dt, 0.0).unwrap().margins(proportional(k));
        let half_turn = (k * dt / 2.0_f64).asin();
        assert!((margins.phase_margin.unwrap() - (FRAC_PI_2 - half_turn)).abs() < 1e-3);
        assert!((margins.crossover.unwrap() - 2.0 * half_turn / dt).abs() < 1e-2);
        assert!((margins.gain_margin.unwrap() - 2.0 / (k * dt)).abs() < 1e-6);
        assert!((margins.sensitivity - 2.0 / (2.0 - k * dt)).abs() < 1e-9);
        assert_eq!(margins.gain_reduction, None);
    }

    /// `1 / (s + 1)³` reaches -180° at √3 rad/s with a gain of 1/8; dead time turns by `ω L`.
    #[test]
    fn continuous_limits() {
        let triple = plant(&[1.0], &[1.0, 3.0, 3.0, 1.0]);
        let margins = FrequencySweep::new(&triple, 1e-3, 0.0).unwrap().margins(proportional(2.0));
        assert!((margins.gain_margin.unwrap() - 4.0).abs() < 0.02, "{margins:?}");
        for dead_time in [0.3, 0.2995] {
            let late = plant(&[1.0], &[1.0, 0.0]).with_dead_time(dead_time).unwrap();
            let margins = FrequencySweep::new(&late, 1e-3, 0.0).unwrap().margins(proportional(2.0));
            assert!((margins.phase_margin.unwrap() - (FRAC_PI_2 - 2.0 * dead_time - 1e-3)).abs() < 1e-3);
            assert!((margins.gain_margin.unwrap() - PI / (4.0 * dead_time)).abs() < 0.01);
        }
    }

    /// An unstable plant has a least gain too: `k / (s - 1)` needs `k > 1`.
    #[test]
    fn unstable_plants_need_gain() {
        let margins = FrequencySweep::new(&plant(&[1.0], &[1.0, -1.0]), 1e-3, 0.0).unwrap().margins(proportional(4.0));
        assert!(margins.gain_margin.unwrap() > 100.0);
        assert!((margins.gain_reduction.unwrap() - 0.25).abs() < 1e-12);
        assert!((margins.sensitivity - 1.0).abs() < 0.01);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// The margins agree with what the loop does: gains a little below the margin are stable, a little above are not.
        #[test]
        fn the_gain_margin_is_where_the_loop_starts_to_swing(
            kp in 0.1..2.0_f64, ki in 0.0..0.5_f64, kd in 0.0..0.5_f64, dead_time in 0.05..0.6_f64,
        ) {
            let late = plant(&[1.0], &[0.5, 1.5, 1.0]).with_dead_time(dead_time).unwrap();
            let sweep = FrequencySweep::new(&late, 0.02, 0.05).unwrap();
            let margins = sweep.margins([kp, ki, kd].into());
            let factor = margins.gain_margin.unwrap();
            let error_after = |factor: f64, horizon: f64| {
                let params = StepTestParams { dt: 0.02, filter_time: 0.05, horizon, ..Default::default() };
                let test = StepTest::new(&late, params).unwrap();
                test.figures([kp * factor, ki * factor, kd * factor].into()).ise
            };
            prop_assume!(factor > 1.1);
            let (stable, unstable) = (factor * 0.97, factor * 1.03);
            prop_assert!(error_after(stable, 500.0) - error_after(stable, 450.0) < 75.0);
            prop_assert!(error_after(unstable, 1500.0) > 1e6);
            // The bounds that Ms gives, up to the width of the sweep.
            let ms = margins.sensitivity;
            prop_assert!(factor >= 0.99 * ms / (ms - 1.0));
            if let Some(phase) = margins.phase_margin {
                prop_assert!(phase >= 2.0 * (0.5 / ms).asin() - 0.02);
            }
        }
    }

    #[test]
    fn bad_input_is_refused_or_loses() {
        let p = plant(&[1.0], &[1.0, 1.0]);
        for (dt, filter_time) in [(0.0, 0.1), (-0.1, 0.1), (f64::NAN, 0.1), (0.1, -0.1), (0.1, f64::NAN)] {
            assert!(FrequencySweep::new(&p, dt, filter_time).is_err(), "{dt} {filter_time}");
        }
        let sweep = FrequencySweep::new(&p, 0.1, 0.1).unwrap();
        for bad in [f64::NAN, f64::INFINITY, f64::MAX] {
            let margins = sweep.margins([bad, bad, 0.0].into());
            assert_eq!(margins.sensitivity, f64::INFINITY, "{bad}");
        }
        let open = sweep.margins(PidGains::default());
        assert_eq!((open.sensitivity, open.gain_margin, open.phase_margin), (1.0, None, None));
    }
}
