//! What a solution amounts to: its cost, and how far it is from optimal, computed afresh from the programme.

use super::{
    Bound, QuadraticOutcome, QuadraticSolver, QuadraticStatus, QuadraticVectors,
    factor::{add_scaled, dot},
};

impl QuadraticSolver {
    pub(super) fn outcome(
        &mut self,
        vectors: &QuadraticVectors<'_>,
        status: QuadraticStatus,
        iterations: usize,
    ) -> QuadraticOutcome {
        let n = self.n;
        self.multipliers.fill(0.0);
        for (held, lambda) in self.working.iter().zip(&self.lambda) {
            self.multipliers[held.index] = held.sign * lambda;
            self.held[held.index] = if held.sign > 0.0 { Bound::Lower } else { Bound::Upper };
        }
        // H x by the lower half.
        let slope = &mut self.gradient;
        slope.fill(0.0);
        for (i, row) in self.hessian.chunks_exact(n).enumerate() {
            slope[i] += dot(&row[..=i], &self.x[..=i]);
            add_scaled(&mut slope[..i], self.x[i], &row[..i]);
        }
        let cost = 0.5 * dot(slope, &self.x) + dot(vectors.gradient, &self.x);
        add_scaled(slope, 1.0, vectors.gradient);
        add_scaled(slope, -1.0, &self.multipliers[..n]);
        let mut primal_residual = 0.0_f64;
        for ((x, lower), upper) in self.x.iter().zip(vectors.lower).zip(vectors.upper) {
            primal_residual = primal_residual.max(lower - x).max(x - upper);
        }
        let limits = vectors.row_lower.iter().zip(vectors.row_upper);
        for ((row, (lower, upper)), lambda) in self.rows.chunks_exact(n).zip(limits).zip(&self.multipliers[n..]) {
            let value = dot(row, &self.x);
            primal_residual = primal_residual.max(lower - value).max(value - upper);
            if *lambda != 0.0 {
                add_scaled(slope, -lambda, row);
            }
        }
        let dual_residual = slope.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
        QuadraticOutcome { status, iterations, cost, primal_residual, dual_residual }
    }
}
