//! A transfer function in time: exact at the samples, behind an actuator and a dead time.

use super::state_space::{Discrete, StateSpace, Vector};
use super::{ActuatorLimits, Plant, TransferFunction};
use crate::Error;
use agv_core::check;

/// A [`TransferFunction`] driven by an input that is held between the samples, behind an actuator and a dead time:
/// `y(s) = G(s) e^(-L s) sat(u)`. The output is exact at the samples for every `dt` (zero-order hold); it is
/// discretised when `dt` changes and costs `n²` multiplications a step otherwise.
///
/// A `dt` that changes while inputs are under way in a dead time resamples them.
///
/// ```
/// use agv_control::plant::{ActuatorLimits, LinearPlant, Plant, TransferFunction};
///
/// // An integrator behind 0.25 s of dead time and an actuator that gives at most 2.
/// let mut plant = LinearPlant::new(TransferFunction::new(&[1.0], &[1.0, 0.0])?)?
///     .with_dead_time(0.25)?
///     .with_actuator(ActuatorLimits::symmetric(2.0))?;
/// for _ in 0..10 {
///     plant.step(100.0, 0.1)?;
/// }
/// assert!((plant.output() - 2.0 * (1.0 - 0.25)).abs() < 1e-12);
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct LinearPlant {
    transfer_function: TransferFunction,
    dead_time: f64,
    actuator: ActuatorLimits,
    model: StateSpace,
    discrete: Option<Discrete>,
    state: Vector,
    output: f64,
    /// Input after the actuator, in the last step.
    input: f64,
    /// Inputs under way, as a ring of `delay + 1`; the next one goes to `head`, where the oldest is.
    line: Vec<f64>,
    head: usize,
}

impl LinearPlant {
    /// The plant at rest, without dead time or limits.
    ///
    /// # Errors
    /// Coefficients so far apart that the states leave the range of numbers.
    pub fn new(transfer_function: TransferFunction) -> Result<Self, Error> {
        let model = StateSpace::new(&transfer_function);
        if !model.a.iter().flatten().chain(&model.c).all(|v| v.is_finite()) {
            return Err(Error::Overflow { name: "state space of the plant" });
        }
        Ok(Self {
            transfer_function,
            dead_time: 0.0,
            actuator: ActuatorLimits::default(),
            model,
            discrete: None,
            state: Vector::default(),
            output: 0.0,
            input: 0.0,
            line: Vec::new(),
            head: 0,
        })
    }

    /// The same with a dead time in seconds, at rest.
    ///
    /// # Errors
    /// A dead time that is negative or not finite.
    pub fn with_dead_time(mut self, seconds: f64) -> Result<Self, Error> {
        self.dead_time = check::non_negative("dead_time", seconds)?;
        self.discrete = None;
        self.reset();
        Ok(self)
    }

    /// The same behind an actuator.
    ///
    /// # Errors
    /// As [`ActuatorLimits::validate`].
    pub fn with_actuator(mut self, limits: ActuatorLimits) -> Result<Self, Error> {
        limits.validate()?;
        self.actuator = limits;
        Ok(self)
    }

    /// What is driven.
    pub const fn transfer_function(&self) -> &TransferFunction {
        &self.transfer_function
    }

    /// Dead time, in seconds.
    pub const fn dead_time(&self) -> f64 {
        self.dead_time
    }

    /// Limits of the actuator.
    pub const fn actuator(&self) -> &ActuatorLimits {
        &self.actuator
    }

    /// The plant for samples of `dt`.
    pub(crate) fn discretise(&self, dt: f64) -> Result<Discrete, Error> {
        Discrete::new(&self.model, self.dead_time, check::positive("dt", dt)?)
    }

    /// Takes a new `dt`, with the inputs under way sampled anew at the middle of each.
    fn resample(&mut self, discrete: &Discrete) {
        let len = discrete.delay + 1;
        let old_dt = self.discrete.map_or(discrete.dt, |old| old.dt);
        let value = |age: f64| {
            let (samples, held) = ((age / old_dt) as usize, self.line.len());
            // The newest of the ring is the one before the head.
            if samples < held { self.line[(self.head + held - 1 - samples) % held] } else { 0.0 }
        };
        let line = (0..len).map(|i| value((len - i) as f64 * discrete.dt - 0.5 * discrete.dt)).collect();
        (self.line, self.head, self.discrete) = (line, 0, Some(*discrete));
    }
}

impl Plant for LinearPlant {
    fn output(&self) -> f64 {
        self.output
    }

    fn step(&mut self, input: f64, dt: f64) -> Result<f64, Error> {
        check::finite("input", input)?;
        if self.discrete.is_none_or(|discrete| discrete.dt != dt) {
            let discrete = self.discretise(dt)?;
            self.resample(&discrete);
        }
        let Some(plant) = &self.discrete else { return Ok(self.output) };
        self.input = self.actuator.apply(input, self.input, dt);
        let n = plant.order;
        // The ring holds u[k-m-1] .. u[k-1]; the oldest leaves for the newest.
        let late = std::mem::replace(&mut self.line[self.head], self.input);
        self.head = if self.head == plant.delay { 0 } else { self.head + 1 };
        let due = self.line[self.head];
        let due = if plant.delay == 0 { self.input } else { due };
        let mut next = Vector::default();
        for (i, sum) in next.iter_mut().enumerate().take(n) {
            *sum = plant.b[i] * due + plant.b_late[i] * late;
            for j in 0..n {
                *sum += plant.a[i][j] * self.state[j];
            }
        }
        self.state = next;
        self.output = plant.d * due + (0..n).map(|i| plant.c[i] * self.state[i]).sum::<f64>();
        Ok(self.output)
    }

    fn reset(&mut self) {
        self.state = Vector::default();
        (self.output, self.input, self.head) = (0.0, 0.0, 0);
        self.line.fill(0.0);
    }
}
