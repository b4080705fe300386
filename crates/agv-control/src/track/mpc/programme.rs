//! The quadratic programme of a horizon, condensed: the states are eliminated, the inputs of all stages are the unknowns.
//!
//! ```text
//! minimise Σ y²/y₀² + θ²/θ₀² + (u - u_ref)ᵀR(u - u_ref) + xᵀP x at the end
//! subject to  lower ≤ u ≤ upper,   |u⁺ - u| ≤ rate · step
//! ```
//!
//! Only the inputs have limits, and these are built so that braking and straightening as hard as allowed keeps them all: there is always
//! an answer.

use super::{
    super::lateral::Sampled,
    stage::{HEADING, SIDE, Stage, State},
};
use agv_core::{
    Error,
    solve::{Bound, QuadraticOutcome, QuadraticParams, QuadraticSolver, QuadraticVectors},
};
use nalgebra::{Matrix3, Vector3};

/// Limits of one input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct InputLimits {
    /// The input now, and how far it may fall and rise until the first stage.
    pub(super) now: f64,
    pub(super) first: [f64; 2],
    /// How far it may fall and rise from one stage to the next.
    pub(super) change: [f64; 2],
}

/// What a horizon costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Costs {
    pub(super) side: f64,
    pub(super) heading: f64,
    /// Cost to go at the end, of side, heading and turn rate.
    pub(super) terminal: Matrix3<f64>,
}

/// The programme for a number of inputs and stages.
#[derive(Debug, Clone)]
pub(super) struct Programme {
    inputs: usize,
    stages: usize,
    solver: QuadraticSolver,
    hessian: Vec<f64>,
    rows: Vec<f64>,
    gradient: Vec<f64>,
    pub(super) lower: Vec<f64>,
    pub(super) upper: Vec<f64>,
    row_lower: Vec<f64>,
    row_upper: Vec<f64>,
    /// State at the stage that is being added, per unit of each unknown.
    columns: Vec<State>,
    shifted: Vec<Bound>,
}

impl Programme {
    pub(super) fn new(inputs: usize, stages: usize, params: QuadraticParams) -> Result<Self, Error> {
        let (n, m) = (inputs * stages, inputs * (stages - 1));
        let mut rows = vec![0.0; m * n];
        for (row, entries) in rows.chunks_exact_mut(n).enumerate() {
            (entries[row], entries[row + inputs]) = (-1.0, 1.0);
        }
        Ok(Self {
            inputs,
            stages,
            solver: QuadraticSolver::new(n, m, params)?,
            hessian: vec![0.0; n * n],
            rows,
            gradient: vec![0.0; n],
            lower: vec![0.0; n],
            upper: vec![0.0; n],
            row_lower: vec![0.0; m],
            row_upper: vec![0.0; m],
            columns: vec![[0.0; 6]; n],
            shifted: vec![Bound::Free; n + m],
        })
    }

    /// Sets the limits of the inputs: the range of each at each stage, widened to what can be reached, and the rates.
    pub(super) fn set_limits(&mut self, limits: &[InputLimits], range: impl Fn(usize, usize) -> (f64, f64)) {
        for (input, limit) in limits.iter().enumerate().take(self.inputs) {
            let [fall, rise] = limit.first;
            let (mut least, mut greatest) = (limit.now, limit.now);
            for stage in 0..self.stages {
                let (down, up) = if stage == 0 { (fall, rise) } else { (limit.change[0], limit.change[1]) };
                let (low, high) = range(stage, input);
                (least, greatest) = (low.min(least + up), high.max(greatest - down));
                let k = stage * self.inputs + input;
                (self.lower[k], self.upper[k]) = (least, greatest);
                if stage == 0 {
                    self.lower[k] = least.max(limit.now - fall);
                    self.upper[k] = greatest.min(limit.now + rise);
                } else {
                    (self.row_lower[k - self.inputs], self.row_upper[k - self.inputs]) = (-down, up);
                }
            }
        }
    }

    /// Sets the cost of a horizon that begins at `state`. `effort` is what one unit of an input costs beyond its reference.
    pub(super) fn set_cost(
        &mut self,
        state: &State,
        stages: &[Stage],
        step: &Sampled,
        costs: &Costs,
        effort: impl Fn(&Stage, usize) -> (f64, f64),
    ) {
        let (inputs, n) = (self.inputs, self.inputs * self.stages);
        self.hessian.fill(0.0);
        self.gradient.fill(0.0);
        let mut free = *state;
        for (k, stage) in stages.iter().enumerate().take(self.stages) {
            let active = k * inputs;
            let moved = stage.advance(&free, step);
            let drift = stage.drift(step);
            free = std::array::from_fn(|i| moved[i] + drift[i]);
            for column in &mut self.columns[..active] {
                *column = stage.advance(column, step);
            }
            for input in 0..inputs {
                let unknown = active + input;
                self.columns[unknown] = stage.response(input, step);
                let (weight, reference) = effort(stage, input);
                self.hessian[unknown * n + unknown] += weight;
                self.gradient[unknown] -= weight * reference;
            }
            let count = active + inputs;
            if k + 1 < self.stages {
                self.add(
                    count,
                    |x| Vector3::new(x[SIDE], x[HEADING], 0.0),
                    &free,
                    0.0,
                    &Matrix3::from_diagonal(&Vector3::new(costs.side, costs.heading, 0.0)),
                );
            } else {
                let seen = |x: &State| Vector3::new(x[SIDE], x[HEADING], stage.excess(x));
                self.add(count, seen, &free, stage.rest, &costs.terminal);
            }
        }
    }

    /// Adds `xᵀ weight x` of what is seen of the state.
    fn add(
        &mut self,
        count: usize,
        seen: impl Fn(&State) -> Vector3<f64>,
        free: &State,
        rest: f64,
        weight: &Matrix3<f64>,
    ) {
        let n = self.gradient.len();
        let constant = seen(free) + Vector3::new(0.0, 0.0, rest);
        for row in 0..count {
            let weighted = weight * seen(&self.columns[row]);
            self.gradient[row] += weighted.dot(&constant);
            for (entry, column) in self.hessian[row * n..].iter_mut().zip(&self.columns[..=row]) {
                *entry += weighted.dot(&seen(column));
            }
        }
    }

    /// Moves the working set on by a stage.
    pub(super) fn shift(&mut self) -> Result<(), Error> {
        let (inputs, n) = (self.inputs, self.inputs * self.stages);
        let held = self.solver.working_set();
        self.shifted.fill(Bound::Free);
        self.shifted[..n - inputs].copy_from_slice(&held[inputs..n]);
        if held.len() > n {
            let m = held.len() - n;
            self.shifted[n..n + m - inputs].copy_from_slice(&held[n + inputs..]);
        }
        self.solver.warm_start(&self.shifted)
    }

    pub(super) fn forget(&mut self) {
        self.solver.cold_start();
    }

    pub(super) fn solve(&mut self) -> Result<QuadraticOutcome, Error> {
        self.solver.set_matrices(&self.hessian, &self.rows)?;
        self.solver.solve(&QuadraticVectors {
            gradient: &self.gradient,
            lower: &self.lower,
            upper: &self.upper,
            row_lower: &self.row_lower,
            row_upper: &self.row_upper,
        })
    }

    /// The inputs of all stages, one stage after the other.
    pub(super) fn solution(&self) -> &[f64] {
        self.solver.solution()
    }
}
