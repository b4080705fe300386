//! State space form of a transfer function, and its exact discretisation.
//!
//! Controllable canonical form (Franklin, Powell and Emami-Naeini, *Feedback Control of Dynamic Systems*, section 7.4)
//! with the states scaled to one frequency. Between two samples the input is held, so with a dead time of
//! `(m + f) dt`, `0 <= f < 1`, the state at the next sample is exactly
//!
//! ```text
//! x' = Φ(dt) x + Γ((1-f) dt) u[k-m] + Φ((1-f) dt) Γ(f dt) u[k-m-1],      Φ(t) = exp(A t),  Γ(t) = ∫₀ᵗ Φ dτ B
//! ```
//!
//! (Åström and Wittenmark, *Computer-Controlled Systems*, section 2.3). `Φ` and `Γ` come out of one exponential of
//! `[A B; 0 0]` (Van Loan 1978).

use super::expm::{Square, expm};
use super::{MAX_ORDER, TransferFunction};
use crate::Error;

pub(crate) type Vector = [f64; MAX_ORDER];
pub(crate) type Matrix = [[f64; MAX_ORDER]; MAX_ORDER];

/// `x' = A x + B u`, `y = C x + D u`; what lies beyond the order is zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StateSpace {
    pub(crate) order: usize,
    pub(crate) a: Matrix,
    pub(crate) b: Vector,
    pub(crate) c: Vector,
    pub(crate) d: f64,
}

impl StateSpace {
    pub(crate) fn new(g: &TransferFunction) -> Self {
        let (order, a, b) = (g.order(), g.denominator(), g.numerator());
        let d = b[order];
        // States scaled by powers of a frequency near the fastest pole: the entries of A are then alike, and the
        // exponential needs few squarings. A power of two scales without rounding.
        let fastest = (1..=order).map(|i| a[order - i].abs().powf(1.0 / i as f64)).fold(0.0, f64::max);
        let w = if fastest > 0.0 { fastest.log2().round().exp2() } else { 1.0 };
        let mut model = Self { order, a: Matrix::default(), b: Vector::default(), c: Vector::default(), d };
        for i in 0..order {
            if i + 1 < order {
                model.a[i][i + 1] = w;
            }
            model.a[order - 1][i] = -a[i] / w.powi((order - 1 - i) as i32);
            model.c[i] = (b[i] - a[i] * d) / w.powi((order - i) as i32);
        }
        if order > 0 {
            model.b[order - 1] = w;
        }
        model
    }
}

/// A [`StateSpace`] under an input that is held for `dt` and reaches it late.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Discrete {
    pub(crate) dt: f64,
    pub(crate) order: usize,
    pub(crate) a: Matrix,
    /// Weight of `u[k-m]`.
    pub(crate) b: Vector,
    /// Weight of `u[k-m-1]`, the part of the sample that a fractional dead time leaves to the older input.
    pub(crate) b_late: Vector,
    pub(crate) c: Vector,
    pub(crate) d: f64,
    /// `m`, whole samples of dead time.
    pub(crate) delay: usize,
}

/// Part of a sample that counts as rounding of the dead time.
const WHOLE: f64 = 1e-9;

impl Discrete {
    /// `dt` must be positive, `dead_time` not negative.
    pub(crate) fn new(model: &StateSpace, dead_time: f64, dt: f64) -> Result<Self, Error> {
        let samples = dead_time / dt;
        if samples > MAX_DELAY {
            return Err(agv_core::Error::OutOfRange {
                name: "dead_time / dt",
                value: samples,
                min: 0.0,
                max: MAX_DELAY,
            }
            .into());
        }
        let (whole, part) = if samples - samples.floor() > 1.0 - WHOLE {
            (samples.ceil(), 0.0)
        } else {
            (samples.floor(), if samples.fract() < WHOLE { 0.0 } else { samples.fract() })
        };
        let (phi, _) = transition(model, dt)?;
        let (phi_new, b) = transition(model, (1.0 - part) * dt)?;
        let (_, gamma_late) = transition(model, part * dt)?;
        let mut b_late = Vector::default();
        for (sum, row) in b_late.iter_mut().zip(&phi_new) {
            *sum = row.iter().zip(&gamma_late).map(|(p, g)| p * g).sum();
        }
        Ok(Self { dt, order: model.order, a: phi, b, b_late, c: model.c, d: model.d, delay: whole as usize })
    }
}

/// Greatest dead time, in samples.
const MAX_DELAY: f64 = 1e6;

/// `Φ(t)` and `Γ(t)`.
fn transition(model: &StateSpace, t: f64) -> Result<(Matrix, Vector), Error> {
    let (n, mut block) = (model.order, Square::zeros());
    for i in 0..n {
        for j in 0..n {
            block[(i, j)] = model.a[i][j] * t;
        }
        block[(i, n)] = model.b[i] * t;
    }
    let exponential = expm(&block).ok_or(Error::Overflow { name: "matrix exponential of the plant" })?;
    let (mut phi, mut gamma) = (Matrix::default(), Vector::default());
    for i in 0..n {
        for j in 0..n {
            phi[i][j] = exponential[(i, j)];
        }
        gamma[i] = exponential[(i, n)];
    }
    Ok((phi, gamma))
}
