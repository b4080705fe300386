//! The Kalman correction of a whole state by constraints, in the group's errors or in each coordinate by itself.

use super::{
    SlamErrors,
    reading::SCALES,
    state::{Constraint, POINTS, SCALE, SlamState, YAW, row_of, turned},
};
use agv_core::geometry::{LieGroup, Se2};
use nalgebra::{Vector2, Vector3};

/// Memory of corrections.
#[derive(Debug, Clone, Default)]
pub(super) struct CorrectionScratch {
    /// `P Hᵀ`, one column after the other; then divided by the factor of the innovation's covariance.
    columns: Vec<f64>,
    /// Differences of columns.
    parts: [Vec<f64>; 3],
    /// Lower factor of the innovation's covariance, square by rows.
    factor: Vec<f64>,
    innovation: Vec<f64>,
    pub(super) step: Vec<f64>,
}

impl CorrectionScratch {
    /// Square of the innovations that were taken in last, normalised.
    pub(super) fn square(&self) -> f64 {
        self.innovation.iter().map(|y| y * y).sum()
    }

    /// Logarithm of their likelihood, but for its constant.
    pub(super) fn log_likelihood(&self) -> f64 {
        let k = self.innovation.len();
        -0.5 * self.square() - (0..k).map(|i| self.factor[i * k + i].ln()).sum::<f64>()
    }
}

impl SlamState {
    /// Takes constraints in, all at once: `P -= P Hᵀ (H P Hᵀ + R)⁻¹ H P`, as the square of one matrix, so that it stays symmetric, and
    /// no variance becomes negative but by rounding. False if the innovation's covariance is not positive definite, the step not
    /// finite, or the scale of ranges absurd after it; nothing changes then. O(rows points²).
    pub(super) fn correct(
        &mut self,
        constraints: &[Constraint],
        errors: SlamErrors,
        scratch: &mut CorrectionScratch,
    ) -> bool {
        let n = self.covariance.size();
        let k: usize = constraints.iter().map(|c| c.rows).sum();
        if !self.factor(constraints, k, scratch) {
            return false;
        }
        let CorrectionScratch { columns, factor, innovation, step, .. } = scratch;
        // Columns W with W Wᵀ = P Hᵀ S⁻¹ H P, and S^(-1/2) times the residuals.
        for i in 0..k {
            let (done, rest) = columns.split_at_mut(i * n);
            let column = &mut rest[..n];
            for j in 0..i {
                let f = factor[i * k + j];
                column.iter_mut().zip(&done[j * n..]).for_each(|(c, d)| *c -= f * d);
                innovation[i] -= f * innovation[j];
            }
            let scale = 1.0 / factor[i * k + i];
            for c in &mut *column {
                *c *= scale;
            }
            innovation[i] *= scale;
        }
        step.clear();
        step.resize(n, 0.0);
        for (column, y) in columns.chunks_exact(n).zip(innovation.iter()) {
            step.iter_mut().zip(column).for_each(|(s, c)| *s += c * y);
        }
        if !(step.iter().all(|v| v.is_finite()) && SCALES.contains(&(self.scale + step[SCALE]))) {
            return false;
        }
        self.covariance.add_products(columns, columns, -1.0);
        for i in 0..n {
            // Rounding, where next to nothing is left.
            self.covariance.set(i, i, self.covariance.get(i, i).max(0.0));
        }
        match errors {
            SlamErrors::Invariant => self.move_by(step),
            SlamErrors::Additive => self.move_each_by(scratch),
        }
        true
    }

    /// `P Hᵀ`, the residuals, and the factor of `H P Hᵀ + R`; false if that has none.
    fn factor(&self, constraints: &[Constraint], k: usize, scratch: &mut CorrectionScratch) -> bool {
        let n = self.covariance.size();
        let CorrectionScratch { columns, parts: [x, y, s], factor, innovation, .. } = scratch;
        for part in [&mut *x, &mut *y, &mut *s] {
            part.resize(n, 0.0);
        }
        columns.clear();
        columns.resize(k * n, 0.0);
        innovation.clear();
        factor.clear();
        factor.resize(k * k, 0.0);
        let scaled = self.covariance.get(SCALE, SCALE) > 0.0;
        if scaled {
            self.covariance.column_into(SCALE, s);
        }
        let mut column = columns.chunks_exact_mut(n.max(1));
        for c in constraints {
            self.covariance.difference_into(c.point, c.base, x);
            self.covariance.difference_into(c.point + 1, c.base + 1, y);
            for r in 0..c.rows {
                let (a, b) = (c.a[(r, 0)], c.a[(r, 1)]);
                let Some(column) = column.next() else { return false };
                for ((out, x), y) in column.iter_mut().zip(x.iter()).zip(y.iter()) {
                    *out = a * x + b * y;
                }
                if scaled {
                    let f = c.by_scale[r];
                    column.iter_mut().zip(s.iter()).for_each(|(out, s)| *out += f * s);
                }
                innovation.push(c.residual[r]);
            }
        }
        let mut row = 0;
        for c in constraints {
            for r in 0..c.rows {
                for j in 0..=row {
                    let column = &columns[j * n..(j + 1) * n];
                    factor[row * k + j] = c.a[(r, 0)] * (column[c.point] - column[c.base])
                        + c.a[(r, 1)] * (column[c.point + 1] - column[c.base + 1])
                        + c.by_scale[r] * column[SCALE];
                }
                for q in 0..=r {
                    factor[row * k + row - (r - q)] += c.noise[(r, q)];
                }
                row += 1;
            }
        }
        cholesky(factor, k)
    }

    /// Moves all by an error in the group.
    fn move_by(&mut self, step: &[f64]) {
        let yaw = step[YAW];
        self.map_from_base = Se2::exp(&Vector3::new(step[0], step[1], yaw)).compose(&self.map_from_base);
        self.scale += step[SCALE];
        // V(φ) = [a, -b; b, a]
        let unit = Se2::exp(&Vector3::new(1.0, 0.0, yaw));
        let (a, b, turn) = (unit.x(), unit.y(), unit.rotation());
        for (point, by) in self.points.iter_mut().zip(step[POINTS..].chunks_exact(2)) {
            point.place = turn.act(&point.place) + Vector2::new(a * by[0] - b * by[1], b * by[0] + a * by[1]);
        }
    }

    /// Moves each coordinate by itself, and takes the covariance to what was moved to.
    fn move_each_by(&mut self, scratch: &mut CorrectionScratch) {
        let CorrectionScratch { step, columns, .. } = scratch;
        let n = self.covariance.size();
        let yaw = step[YAW];
        // u, then P e_φ + u P_φφ / 2.
        columns.clear();
        columns.resize(2 * n, 0.0);
        let (u, v) = columns.split_at_mut(n);
        let place = self.map_from_base.translation();
        let moved = place + Vector2::new(step[0], step[1]) + turned(&place) * yaw;
        let shift = turned(&(place - moved));
        (u[0], u[1]) = (shift.x, shift.y);
        self.map_from_base = Se2::new(moved.x, moved.y, self.map_from_base.yaw() + yaw);
        self.scale += step[SCALE];
        for (k, point) in self.points.iter_mut().enumerate() {
            let row = row_of(k);
            let moved = point.place + Vector2::new(step[row], step[row + 1]) + turned(&point.place) * yaw;
            let shift = turned(&(point.place - moved));
            (u[row], u[row + 1]) = (shift.x, shift.y);
            point.place = moved;
        }
        let variance = self.covariance.get(YAW, YAW);
        self.covariance.column_into(YAW, v);
        v.iter_mut().zip(u.iter()).for_each(|(v, u)| *v += 0.5 * variance * u);
        // u vᵀ + v uᵀ, as pairs of columns.
        let swapped = &mut scratch.parts[0];
        swapped.clear();
        swapped.extend_from_slice(v);
        swapped.extend_from_slice(u);
        self.covariance.add_products(&scratch.columns, swapped, 1.0);
    }
}

/// Lower factor in place of the lower triangle of a square matrix by rows; false if it is not positive definite.
pub(super) fn cholesky(matrix: &mut [f64], k: usize) -> bool {
    for i in 0..k {
        for j in 0..=i {
            let mut sum = matrix[i * k + j];
            for l in 0..j {
                sum -= matrix[i * k + l] * matrix[j * k + l];
            }
            if i == j {
                if !(sum > 0.0 && sum.is_finite()) {
                    return false;
                }
                matrix[i * k + i] = sum.sqrt();
            } else {
                matrix[i * k + j] = sum / matrix[j * k + j];
            }
        }
    }
    true
}
