//! Convex quadratic programmes of tens of unknowns and hundreds of limits, as model predictive control has them.
//!
//! ```text
//! minimise  ½ xᵀH x + gᵀx      subject to  lower ≤ x ≤ upper,   row_lower ≤ A x ≤ row_upper
//! ```
//!
//! # Method
//! A dual active-set method: Goldfarb and Idnani, *A numerically stable dual method for solving strictly convex quadratic
//! programs*, 1983, on any dual feasible working set as Arnström, Bemporad and Axehill, *A dual active-set solver for embedded
//! quadratic programming*, 2022. With `H = L Lᵀ`, `Jᵀ = Qᵀ L⁻¹` and `Jᵀ A_Wᵀ = [R; 0]`, the
//! minimum on a working set `W` of limits held with equality is a matter of two triangles:
//!
//! ```text
//! y₁ = R⁻ᵀ b_W     y₂ = -J₂ᵀ g     x = J y     R λ = y₁ + J₁ᵀ g
//! ```
//!
//! A negative `λ` drops its limit, the most violated limit comes in, `Q` and `R` follow by one reflection or a few rotations.
//!
//! # Why this one
//! - The unconstrained minimum is a good start where a handful of the limits bind, and that is what a tracking controller
//!   solves: an iteration costs `O(n² + m n)`, and there are about as many as limits that bind. An interior point method
//!   pays `O(n³ + m n²)` for each of its 10 to 20 iterations, however easy the problem, and cannot start from the last cycle.
//! - The next cycle's working set is nearly the last one's: a warm start needs a few iterations or none.
//! - The answer is exact to rounding, without a step length, penalty or polish to tune, as ADMM (OSQP) would need; limits that
//!   bind, bind to the last digits, and a problem without a feasible point is proved to be so after finitely many steps.
//! - The state of a chain of `N` stages need not stay in the problem: condensed, a horizon of 10 to 30 with 1 to 3 inputs
//!   is 10 to 90 dense unknowns. A banded interior point method pays off beyond that.
//!
//! The price: before its end the method has no feasible point. At the iteration limit the answer is that of a problem with
//! fewer limits, and says so. And like any exact solver it turns a problem down whose limits contradict each other: give
//! limits of predicted states that a disturbance may break (the distance to a path, say) an unknown of their own that
//! widens them at a cost, and leave those of the inputs hard.
//!
//! A Hessian that is only semi-definite (linear costs, inputs without weight) is solved by proximal steps, `H + P` with a
//! small diagonal `P` and `g - P x` of the last step (Rockafellar 1976): the same factor serves all of them.

mod factor;
mod report;
mod solver;

pub use solver::QuadraticSolver;

use crate::{Error, check};

/// How exactly, and for how long.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct QuadraticParams {
    /// Most changes of the working set in one call.
    pub max_iterations: usize,
    /// Violation at which a limit counts as kept, relative to the greater of the limit and its row's norm.
    pub feasibility_tolerance: f64,
    /// Slope of the Lagrangian at which the proximal steps for a semi-definite Hessian end, relative to one plus the
    /// greatest entry of the gradient.
    pub stationarity_tolerance: f64,
}

impl Default for QuadraticParams {
    /// Seven digits better than any actuator follows, and seven above rounding; a problem of 90 unknowns and 400 limits
    /// from a cold start stays well below the limit of iterations.
    fn default() -> Self {
        Self { max_iterations: 1000, feasibility_tolerance: 1e-9, stationarity_tolerance: 1e-9 }
    }
}

impl QuadraticParams {
    fn checked(self) -> Result<Self, Error> {
        check::positive("feasibility_tolerance", self.feasibility_tolerance)?;
        check::positive("stationarity_tolerance", self.stationarity_tolerance)?;
        Ok(self)
    }
}

/// The vectors of a programme, which change from one cycle to the next. A limit that is absent is infinite; two equal
/// limits make an equation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadraticVectors<'a> {
    /// Linear part `g` of the cost, one entry per unknown.
    pub gradient: &'a [f64],
    /// Least value of each unknown.
    pub lower: &'a [f64],
    /// Greatest value of each unknown.
    pub upper: &'a [f64],
    /// Least value of each row of `A x`.
    pub row_lower: &'a [f64],
    /// Greatest value of each row of `A x`.
    pub row_upper: &'a [f64],
}

impl QuadraticVectors<'_> {
    /// Accepts vectors of `n` unknowns and `m` rows.
    fn check(&self, n: usize, m: usize) -> Result<(), Error> {
        check::length("gradient", self.gradient.len(), n)?;
        check::all_finite("gradient", self.gradient)?;
        let Self { lower, upper, row_lower, row_upper, .. } = *self;
        for ([low, high], lower, upper, count) in
            [(["lower", "upper"], lower, upper, n), (["row_lower", "row_upper"], row_lower, row_upper, m)]
        {
            check::length(low, lower.len(), count)?;
            check::length(high, upper.len(), count)?;
            for (&value, &max) in lower.iter().zip(upper) {
                if value.is_nan() || max.is_nan() {
                    return Err(Error::NotFinite { name: if value.is_nan() { low } else { high }, value: f64::NAN });
                }
                if value > max || value == f64::INFINITY || max == f64::NEG_INFINITY {
                    return Err(Error::OutOfRange { name: low, value, min: f64::NEG_INFINITY, max });
                }
            }
        }
        Ok(())
    }

    /// Both limits of an unknown, or of a row, which are counted after the unknowns.
    fn limits(&self, index: usize) -> (f64, f64) {
        match index.checked_sub(self.lower.len()) {
            None => (self.lower[index], self.upper[index]),
            Some(row) => (self.row_lower[row], self.row_upper[row]),
        }
    }
}

/// A limit of the programme.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Constraint {
    /// A limit of the unknown of this index.
    Variable(usize),
    /// A limit of the row of this index.
    Row(usize),
}

/// Which of the two limits of an unknown or a row a working set holds with equality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Bound {
    /// None.
    #[default]
    Free,
    /// The lower one.
    Lower,
    /// The upper one.
    Upper,
}

/// How a solution came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum QuadraticStatus {
    /// The minimum is found.
    Solved,
    /// No point keeps all limits: this one contradicts the working set.
    Infeasible {
        /// The limit that cannot be kept together with those of the working set.
        constraint: Constraint,
    },
    /// As many iterations as were allowed; the limits outside of the working set may be violated.
    IterationLimit,
}

/// What became of a programme.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadraticOutcome {
    /// How it ended.
    pub status: QuadraticStatus,
    /// Changes of the working set.
    pub iterations: usize,
    /// `½ xᵀH x + gᵀx`.
    pub cost: f64,
    /// Greatest violation of a limit, in its own unit.
    pub primal_residual: f64,
    /// Greatest entry of `H x + g - μ - Aᵀλ`, in the unit of the gradient.
    pub dual_residual: f64,
}

impl QuadraticOutcome {
    /// Whether the minimum is found.
    pub const fn solved(&self) -> bool {
        matches!(self.status, QuadraticStatus::Solved)
    }
}

#[cfg(test)]
mod tests;
