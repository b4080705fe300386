//! The cost of PID gains on a linear plant.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::figures::{DIVERGED, StepFigures, finite_or_infinite};
use super::kernel::{Sums, Test, run};
use super::lane::{Lane, MOST_LANES, Wide};
use crate::Error;
use crate::pid::{AntiWindup, PidParams};
use crate::plant::LinearPlant;
use agv_core::check;
use pulp::{Arch, Simd, WithSimd};

/// The three gains of a PID controller.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PidGains {
    /// Kp, output per error.
    pub proportional: f64,
    /// Ki, output per error and second.
    pub integral: f64,
    /// Kd, output per error rate (error per second).
    pub derivative: f64,
}

impl PidGains {
    /// Gains so large that they can only diverge are not worth a run.
    pub(crate) fn can_be_simulated(&self) -> bool {
        [self.proportional, self.integral, self.derivative].iter().all(|gain| gain.abs() <= DIVERGED)
    }
}

impl From<[f64; 3]> for PidGains {
    fn from([proportional, integral, derivative]: [f64; 3]) -> Self {
        Self { proportional, integral, derivative }
    }
}

impl From<PidGains> for [f64; 3] {
    fn from(gains: PidGains) -> Self {
        [gains.proportional, gains.integral, gains.derivative]
    }
}

/// How a step test is run.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepTestParams {
    /// Set-point after the step, in the measurement's unit.
    pub set_point: f64,
    /// Sampling time of the controller, in seconds.
    pub dt: f64,
    /// Length of the test, in seconds.
    pub horizon: f64,
    /// Tf, time constant of the derivative's filter, in seconds; zero for none.
    pub filter_time: f64,
}

impl Default for StepTestParams {
    /// The test of the stand-in plant [`P1`](crate::plant::StandIn::P1).
    fn default() -> Self {
        Self { set_point: 1.0, dt: 0.01, horizon: 10.0, filter_time: 0.02 }
    }
}

/// The step test of a linear plant under a plain PID controller without anti-windup, and its cost
///
/// ```text
/// ITAE = Σ t_k |e_k| dt,      t_k = k dt,  k = 1 .. horizon / dt
/// ```
///
/// The loop starts at rest with its last error equal to the first one, so that the step does not kick the derivative,
/// which makes it the derivative of the measurement. Unstable loops are simulated to the end of the horizon; the cost of
/// one that diverges, and of gains that are not numbers, is infinite, never NaN (see [`StepFigures`]).
///
/// ```
/// use agv_control::plant::StandIn;
///
/// let test = StandIn::P1.step_test()?;
/// let cost = test.cost([3.18, 3.4, 1.61].into());
/// assert!((cost - 1.03717).abs() < 1e-5);
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct StepTest {
    params: StepTestParams,
    test: Test,
    /// No dead time, rate limit or feed-through, of an order with its own loop.
    plain: bool,
    arch: Arch,
}

impl StepTest {
    /// The test of a plant, from rest, whatever its state.
    ///
    /// # Errors
    /// A parameter out of its range, a horizon of no sample or of more than a million, or a plant that cannot
    /// be discretised.
    pub fn new(plant: &LinearPlant, params: StepTestParams) -> Result<Self, Error> {
        let StepTestParams { set_point, dt, horizon, filter_time } = params;
        check::finite("set_point", set_point)?;
        check::positive("dt", dt)?;
        check::non_negative("filter_time", filter_time)?;
        check::positive("horizon", horizon)?;
        let steps = check::in_range("horizon / dt", (horizon / dt).round(), 1.0, 1e6)? as u32;
        let (discrete, actuator) = (plant.discretise(dt)?, *plant.actuator());
        let plain =
            plant.dead_time() == 0.0 && discrete.d == 0.0 && actuator.rate == f64::MAX && discrete.order <= PLAIN_ORDER;
        let test = Test { plant: discrete, actuator, set_point, filter_time, steps };
        Ok(Self { params, test, plain, arch: Arch::new() })
    }

    /// How the test is run.
    pub const fn params(&self) -> &StepTestParams {
        &self.params
    }

    /// The controller that is tested: for [`simulate_step`](super::simulate_step), or with limits and an anti-windup of
    /// its own for use.
    pub fn controller(&self, gains: PidGains) -> PidParams {
        PidParams {
            proportional: gains.proportional,
            integral: gains.integral,
            derivative: gains.derivative,
            filter_time: self.params.filter_time,
            anti_windup: AntiWindup::Off,
            ..PidParams::default()
        }
    }

    /// ITAE of one set of gains.
    pub fn cost(&self, gains: PidGains) -> f64 {
        if gains.can_be_simulated() { cost_of(self.run(gains.into(), self.plain)) } else { f64::INFINITY }
    }

    /// ITAE of many sets of gains side by side; the same bits as [`cost`](Self::cost) of each.
    ///
    /// # Errors
    /// Slices of different lengths.
    pub fn cost_batch(&self, gains: &[PidGains], costs: &mut [f64]) -> Result<(), Error> {
        check::length("costs", costs.len(), gains.len())?;
        self.arch.dispatch(Batch { test: self, gains, results: Costs(costs) });
        Ok(())
    }

    /// All figures of one set of gains.
    pub fn figures(&self, gains: PidGains) -> StepFigures {
        if gains.can_be_simulated() { self.run(gains.into(), false).into() } else { StepFigures::DIVERGED }
    }

    /// All figures of many sets of gains side by side; the same bits as [`figures`](Self::figures) of each.
    ///
    /// # Errors
    /// Slices of different lengths.
    pub fn figures_batch(&self, gains: &[PidGains], figures: &mut [StepFigures]) -> Result<(), Error> {
        check::length("figures", figures.len(), gains.len())?;
        self.arch.dispatch(Batch { test: self, gains, results: Figures(figures) });
        Ok(())
    }

    /// Runs with the smallest unrolled order that holds the plant.
    #[inline(always)]
    fn run<T: Lane>(&self, gains: [T; 3], plain: bool) -> Sums<T> {
        let (test, zero) = (&self.test, gains[0].like(0.0));
        match (test.plant.order, plain) {
            (0 | 1, true) => run::<T, 1, true>(test, gains, &mut []),
            (2, true) => run::<T, 2, true>(test, gains, &mut []),
            (3, true) => run::<T, 3, true>(test, gains, &mut []),
            (4, true) => run::<T, 4, true>(test, gains, &mut []),
            _ => {
                let (mut short, mut long) = ([zero; SHORT_LINE], Vec::new());
                let line = if test.plant.delay < SHORT_LINE {
                    &mut short[..]
                } else {
                    long.resize(test.plant.delay + 1, zero);
                    &mut long
                };
                if test.plant.order <= 2 {
                    run::<T, 2, false>(test, gains, line)
                } else if test.plant.order <= 4 {
                    run::<T, 4, false>(test, gains, line)
                } else {
                    run::<T, 8, false>(test, gains, line)
                }
            }
        }
    }
}

/// Greatest order that has a loop of its own for the ITAE.
const PLAIN_ORDER: usize = 4;

/// Inputs under way in a dead time that are kept on the stack.
const SHORT_LINE: usize = 32;

#[inline(always)]
fn cost_of(sums: Sums<f64>) -> f64 {
    finite_or_infinite(sums.itae)
}

/// Where the results of a batch go.
trait Results {
    const COST_ONLY: bool;
    fn take(&mut self, at: usize, sums: Option<Sums<f64>>);
}

struct Costs<'a>(&'a mut [f64]);

impl Results for Costs<'_> {
    const COST_ONLY: bool = true;

    #[inline(always)]
    fn take(&mut self, at: usize, sums: Option<Sums<f64>>) {
        self.0[at] = sums.map_or(f64::INFINITY, cost_of);
    }
}

struct Figures<'a>(&'a mut [StepFigures]);

impl Results for Figures<'_> {
    const COST_ONLY: bool = false;

    #[inline(always)]
    fn take(&mut self, at: usize, sums: Option<Sums<f64>>) {
        self.0[at] = sums.map_or(StepFigures::DIVERGED, StepFigures::from);
    }
}

struct Batch<'a, R> {
    test: &'a StepTest,
    gains: &'a [PidGains],
    results: R,
}

impl<R: Results> WithSimd for Batch<'_, R> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let lanes = Wide::<S>::LANES;
        for (chunk, gains) in self.gains.chunks(lanes).enumerate() {
            let mut columns = [[0.0; MOST_LANES]; 3];
            for (l, gains) in gains.iter().enumerate().filter(|(_, gains)| gains.can_be_simulated()) {
                (columns[0][l], columns[1][l], columns[2][l]) = (gains.proportional, gains.integral, gains.derivative);
            }
            let [kp, ki, kd] = &columns;
            let loaded =
                [Wide::load(simd, &kp[..lanes]), Wide::load(simd, &ki[..lanes]), Wide::load(simd, &kd[..lanes])];
            let sums = self.test.run(loaded, self.test.plain && R::COST_ONLY);
            for (l, gains) in gains.iter().enumerate() {
                self.results.take(chunk * lanes + l, gains.can_be_simulated().then(|| sums.map(|sum| sum.lane(l))));
            }
        }
    }
}
