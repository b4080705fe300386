//! The loop over working sets.

use super::{
    Bound, Constraint, QuadraticOutcome, QuadraticParams, QuadraticStatus, QuadraticVectors,
    factor::{ActiveFactor, dot},
};
use crate::{Error, check};

/// Solves quadratic programmes of one size, one after the other; each starts from the working set of the last.
///
/// Everything is allocated at construction. The answer depends on the programme and the working set at the start alone.
///
/// ```
/// use agv_core::solve::{QuadraticParams, QuadraticSolver, QuadraticVectors};
///
/// // The point nearest to (3, 2) with x ≤ 2 and x + y ≤ 3.
/// let mut solver = QuadraticSolver::new(2, 1, QuadraticParams::default())?;
/// solver.set_matrices(&[1.0, 0.0, 0.0, 1.0], &[1.0, 1.0])?;
/// let free = f64::NEG_INFINITY;
/// let outcome = solver.solve(&QuadraticVectors {
///     gradient: &[-3.0, -2.0],
///     lower: &[free; 2],
///     upper: &[2.0, f64::INFINITY],
///     row_lower: &[free],
///     row_upper: &[3.0],
/// })?;
/// assert!(outcome.solved());
/// assert!((solver.solution()[0] - 2.0).abs() < 1e-12 && (solver.solution()[1] - 1.0).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct QuadraticSolver {
    params: QuadraticParams,
    pub(super) n: usize,
    m: usize,
    pub(super) hessian: Vec<f64>,
    pub(super) rows: Vec<f64>,
    norms: Vec<f64>,
    ready: bool,
    factor: ActiveFactor,
    /// The working set, in the order of the factor.
    pub(super) working: Vec<Held>,
    /// The limit of each entry of the working set that the multipliers hold with equality.
    bounds: Vec<f64>,
    /// Multipliers of the working set, and those that the present step leads to.
    pub(super) lambda: Vec<f64>,
    target: Vec<f64>,
    /// Which limits of the unknowns, then of the rows, are in the working set.
    pub(super) held: Vec<Bound>,
    pub(super) x: Vec<f64>,
    pub(super) multipliers: Vec<f64>,
    pub(super) gradient: Vec<f64>,
}

/// A limit in the working set, as `sign · normal · x ≥ bound`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
    /// Unknowns first, then rows.
    pub(super) index: usize,
    pub(super) sign: f64,
    /// Both limits are equal: the multiplier may have either sign.
    equation: bool,
}

/// Factor, relative to the normals' norms, below which a combination does without a limit.
const NO_PART: f64 = 1e-11;

impl QuadraticSolver {
    /// A solver for programmes of `variables` unknowns and `rows` inequalities.
    ///
    /// # Errors
    /// [`Error::TooFew`] without unknowns; [`Error::NotPositive`] with the name of the parameter.
    pub fn new(variables: usize, rows: usize, params: QuadraticParams) -> Result<Self, Error> {
        let params = params.checked()?;
        let (n, m) = (check::at_least("variables", variables, 1)?, rows);
        Ok(Self {
            params,
            n,
            m,
            hessian: vec![0.0; n * n],
            rows: vec![0.0; n * m],
            norms: vec![1.0; n + m],
            ready: false,
            factor: ActiveFactor::new(n),
            working: Vec::with_capacity(n),
            bounds: Vec::with_capacity(n),
            lambda: vec![0.0; n],
            target: vec![0.0; n],
            held: vec![Bound::Free; n + m],
            x: vec![0.0; n],
            multipliers: vec![0.0; n + m],
            gradient: vec![0.0; n],
        })
    }

    /// Takes `H` (of which the lower half counts) and `A`, both row by row; `O(n³)`.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`], [`Error::NotFinite`], or [`Error::Singular`] with the pivot if `H` is not convex; the
    /// solver is then without matrices.
    pub fn set_matrices(&mut self, hessian: &[f64], rows: &[f64]) -> Result<(), Error> {
        self.ready = false;
        check::length("hessian", hessian.len(), self.n * self.n)?;
        check::length("rows", rows.len(), self.n * self.m)?;
        check::all_finite("hessian", hessian)?;
        check::all_finite("rows", rows)?;
        self.hessian.copy_from_slice(hessian);
        self.rows.copy_from_slice(rows);
        for (norm, row) in self.norms[self.n..].iter_mut().zip(rows.chunks_exact(self.n)) {
            *norm = dot(row, row).sqrt();
        }
        self.factor.factor(hessian)?;
        self.ready = true;
        Ok(())
    }

    /// Solves with the matrices that were set last, starting from the last working set.
    ///
    /// # Errors
    /// [`Error::Empty`] without matrices; [`Error::LengthMismatch`]; [`Error::NotFinite`] for a gradient that is not, or a
    /// limit that is NaN; [`Error::OutOfRange`] for a lower limit above its upper one, or at the wrong infinity. The last
    /// solution is then still there.
    pub fn solve(&mut self, vectors: &QuadraticVectors<'_>) -> Result<QuadraticOutcome, Error> {
        if !self.ready {
            return Err(Error::Empty { name: "matrices" });
        }
        vectors.check(self.n, self.m)?;
        self.restore(vectors);
        let mut iterations = 0;
        self.gradient.copy_from_slice(vectors.gradient);
        self.factor.set_gradient(&self.gradient);
        let mut status = self.descend(vectors, &mut iterations);
        while status == QuadraticStatus::Solved
            && let Some(proximal) = self.factor.proximal()
        {
            // What the last proximal step leaves: H x + g - Aᵀλ = P (x_before - x).
            let scale = 1.0 + vectors.gradient.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
            let mut change = 0.0_f64;
            for (((shifted, x), weight), g) in self.gradient.iter_mut().zip(&self.x).zip(proximal).zip(vectors.gradient)
            {
                let next = g - weight * x;
                change = change.max((next - *shifted).abs());
                *shifted = next;
            }
            if change <= self.params.stationarity_tolerance * scale {
                break;
            }
            if iterations >= self.params.max_iterations {
                status = QuadraticStatus::IterationLimit;
                break;
            }
            iterations += 1;
            self.factor.set_gradient(&self.gradient);
            status = self.descend(vectors, &mut iterations);
        }
        Ok(self.outcome(vectors, status, iterations))
    }

    /// The unknowns of the last solution.
    pub fn solution(&self) -> &[f64] {
        &self.x
    }

    /// Multipliers `μ` of the unknowns' limits: what the cost loses when a lower limit falls, and negative what it loses
    /// when an upper one rises, each by one unit. At the minimum `H x + g = μ + Aᵀλ`.
    pub fn multipliers(&self) -> &[f64] {
        &self.multipliers[..self.n]
    }

    /// Multipliers `λ` of the rows' limits, with the signs of [`multipliers`](Self::multipliers).
    pub fn row_multipliers(&self) -> &[f64] {
        &self.multipliers[self.n..]
    }

    /// Which limits the last solution holds with equality: those of the unknowns, then those of the rows.
    pub fn working_set(&self) -> &[Bound] {
        &self.held
    }

    /// Sets where the next solution starts, the unknowns first and then the rows: the last working set moved on by a
    /// stage, say. Limits that are absent or depend on others are left out when it does.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`].
    pub fn warm_start(&mut self, working_set: &[Bound]) -> Result<(), Error> {
        check::length("working set", working_set.len(), self.n + self.m)?;
        self.held.copy_from_slice(working_set);
        Ok(())
    }

    /// Forgets the working set: the next solution starts at the unconstrained minimum.
    pub fn cold_start(&mut self) {
        self.held.fill(Bound::Free);
    }

    /// Builds the factor of the equations, then of the last working set as far as it still makes sense.
    fn restore(&mut self, vectors: &QuadraticVectors<'_>) {
        self.factor.clear();
        self.working.clear();
        self.bounds.clear();
        for equations in [true, false] {
            for index in 0..self.n + self.m {
                let (lower, upper) = vectors.limits(index);
                if (lower == upper) == equations {
                    let sign = match self.held[index] {
                        _ if equations => 1.0,
                        Bound::Lower if lower.is_finite() => 1.0,
                        Bound::Upper if upper.is_finite() => -1.0,
                        _ => continue,
                    };
                    if self.factor.active() < self.n && self.project(index, sign) {
                        self.hold(vectors, index, sign);
                    }
                }
            }
        }
        self.held.fill(Bound::Free);
        self.lambda.fill(0.0);
    }

    /// Projects `sign · normal` on the factor's basis; whether it is independent of the working set.
    fn project(&mut self, index: usize, sign: f64) -> bool {
        match index.checked_sub(self.n) {
            None => self.factor.project_axis(index, sign),
            Some(row) => self.factor.project(&self.rows[row * self.n..(row + 1) * self.n], sign),
        }
    }

    /// Adds the limit that was projected last.
    fn hold(&mut self, vectors: &QuadraticVectors<'_>, index: usize, sign: f64) {
        let (lower, upper) = vectors.limits(index);
        self.factor.add();
        self.bounds.push(if sign > 0.0 { lower } else { -upper });
        self.working.push(Held { index, sign, equation: lower == upper });
    }

    fn release(&mut self, position: usize) {
        self.factor.remove(position);
        self.working.remove(position);
        self.bounds.remove(position);
        self.lambda.copy_within(position + 1.., position);
    }

    /// Walks up the dual from the present working set, whose multipliers may be anything that is feasible.
    fn descend(&mut self, vectors: &QuadraticVectors<'_>, iterations: &mut usize) -> QuadraticStatus {
        // The newest limit: its multiplier rises from zero, whatever rounding says.
        let mut newest = None;
        let status = loop {
            let q = self.working.len();
            self.factor.multipliers_into(&self.bounds, &mut self.target);
            if let Some((position, step)) = self.blocking(newest) {
                if *iterations >= self.params.max_iterations {
                    break QuadraticStatus::IterationLimit;
                }
                *iterations += 1;
                for (lambda, target) in self.lambda.iter_mut().zip(&self.target).take(q) {
                    *lambda += step * (target - *lambda);
                }
                self.release(position);
                newest = newest.map(|newest| newest - usize::from(position < newest));
                continue;
            }
            for ((lambda, target), held) in self.lambda.iter_mut().zip(&self.target).zip(&self.working) {
                *lambda = if held.equation { *target } else { target.max(0.0) };
            }
            self.factor.minimum_into(&mut self.x);
            let Some((index, sign)) = self.most_violated(vectors) else { break QuadraticStatus::Solved };
            if *iterations >= self.params.max_iterations {
                break QuadraticStatus::IterationLimit;
            }
            *iterations += 1;
            let mut multiplier = 0.0;
            if !self.project(index, sign) {
                // It can only come in for one of those that span it.
                self.factor.combination_into(&mut self.target);
                let Some((position, step)) = self.replaceable(index) else {
                    break QuadraticStatus::Infeasible { constraint: self.constraint(index) };
                };
                for (lambda, part) in self.lambda.iter_mut().zip(&self.target).take(q) {
                    *lambda -= step * part;
                }
                multiplier = step;
                self.release(position);
                if !self.project(index, sign) {
                    break QuadraticStatus::Infeasible { constraint: self.constraint(index) };
                }
            }
            self.hold(vectors, index, sign);
            let last = self.working.len() - 1;
            self.lambda[last] = multiplier;
            newest = Some(last);
        };
        if status == QuadraticStatus::IterationLimit {
            self.factor.multipliers_into(&self.bounds, &mut self.target);
            self.lambda.copy_from_slice(&self.target);
            self.factor.minimum_into(&mut self.x);
        }
        status
    }

    /// The limit whose multiplier is the first to become negative on the way to the target, and how far that is; of
    /// several at once the worst.
    fn blocking(&self, newest: Option<usize>) -> Option<(usize, f64)> {
        let mut found: Option<(usize, f64)> = None;
        for (position, held) in self.working.iter().enumerate() {
            let (lambda, target) = (self.lambda[position], self.target[position]);
            if held.equation || target >= 0.0 || newest == Some(position) {
                continue;
            }
            let step = lambda / (lambda - target);
            if found.is_none_or(|(best, least)| step < least || (step == least && target < self.target[best])) {
                found = Some((position, step));
            }
        }
        found
    }

    /// The limit that a spanned one pushes out first, and the multiplier that this takes; none if the multipliers of
    /// all others grow, which proves that the limits contradict each other.
    fn replaceable(&self, index: usize) -> Option<(usize, f64)> {
        let mut found: Option<(usize, f64)> = None;
        for (position, held) in self.working.iter().enumerate() {
            let part = self.target[position];
            if held.equation || part * self.norms[held.index] <= NO_PART * self.norms[index] {
                continue;
            }
            let step = self.lambda[position] / part;
            if found.is_none_or(|(_, least)| step < least) {
                found = Some((position, step));
            }
        }
        found
    }

    /// The limit that `x` violates most, relative to its size, and the side.
    fn most_violated(&self, vectors: &QuadraticVectors<'_>) -> Option<(usize, f64)> {
        let (mut worst, mut found) = (self.params.feasibility_tolerance, None);
        let mut judge = |index: usize, value: f64, lower: f64, upper: f64, norm: f64| {
            let (gap, limit, sign) =
                if value < lower { (lower - value, lower, 1.0) } else { (value - upper, upper, -1.0) };
            // A limit that is kept needs no division.
            if gap > 0.0 {
                let violation = gap / norm.max(limit.abs());
                if violation > worst && !self.working.iter().any(|held| held.index == index) {
                    (worst, found) = (violation, Some((index, sign)));
                }
            }
        };
        for (index, &value) in self.x.iter().enumerate() {
            judge(index, value, vectors.lower[index], vectors.upper[index], 1.0);
        }
        for (index, row) in self.rows.chunks_exact(self.n).enumerate() {
            let value = dot(row, &self.x);
            judge(
                self.n + index,
                value,
                vectors.row_lower[index],
                vectors.row_upper[index],
                self.norms[self.n + index],
            );
        }
        found
    }

    const fn constraint(&self, index: usize) -> Constraint {
        match index.checked_sub(self.n) {
            None => Constraint::Variable(index),
            Some(row) => Constraint::Row(row),
        }
    }
}
