//! The factor of a Hessian and of a working set in its metric, kept up to date as limits come and go.

use crate::{Error, check};

/// Sum of products in eight lanes, of which the compiler makes vectors; the same order on every machine.
#[inline]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a_chunks, a_rest), (b_chunks, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut lanes = [0.0; 8];
    for (a, b) in a_chunks.iter().zip(b_chunks) {
        for i in 0..8 {
            lanes[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7])) + rest
}

/// `y += factor x`.
#[inline]
pub(super) fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += factor * x);
}

/// Part of its diagonal entry below which a pivot is rounding, and the Hessian no more than semi-definite.
const SEMIDEFINITE: f64 = 1e-11;

/// Proximal weight, relative to the Hessian's diagonal.
const PROXIMAL: f64 = 1e-6;

/// Sine of the angle to the span of the working set (in the Hessian's metric) below which a normal lies in it.
const DEPENDENT: f64 = 1e-10;

#[derive(Debug, Clone)]
pub(super) struct ActiveFactor {
    n: usize,
    /// `L⁻¹` of `H + P = L Lᵀ`, row by row.
    inverse_root: Vec<f64>,
    /// `P`; zero for a definite Hessian.
    proximal: Vec<f64>,
    semidefinite: bool,
    /// `Jᵀ = Qᵀ L⁻¹`, row by row: the first `active` rows span the working set's normals.
    basis: Vec<f64>,
    /// `Jᵀ g`.
    gradient: Vec<f64>,
    /// `R`, column by column, each `n` long.
    triangle: Vec<f64>,
    active: usize,
    /// `Jᵀ a` of the normal that was projected last.
    projected: Vec<f64>,
    /// `y`, the minimum on the working set in the basis.
    minimum: Vec<f64>,
    scratch: Vec<f64>,
}

impl ActiveFactor {
    pub(super) fn new(n: usize) -> Self {
        let [square, line] = [|n: usize| vec![0.0; n * n], |n: usize| vec![0.0; n]];
        Self {
            n,
            inverse_root: square(n),
            proximal: line(n),
            semidefinite: false,
            basis: square(n),
            gradient: line(n),
            triangle: square(n),
            active: 0,
            projected: line(n),
            minimum: line(n),
            scratch: line(n),
        }
    }

    /// Limits in the working set.
    pub(super) const fn active(&self) -> usize {
        self.active
    }

    /// `P`, if the Hessian is not definite.
    pub(super) fn proximal(&self) -> Option<&[f64]> {
        self.semidefinite.then_some(&self.proximal[..])
    }

    /// Factors a Hessian, of which the lower half counts.
    pub(super) fn factor(&mut self, hessian: &[f64]) -> Result<(), Error> {
        let n = self.n;
        let diagonal = || (0..n).map(|i| hessian[i * n + i]);
        let greatest = diagonal().fold(0.0, f64::max);
        let fallback = if greatest > 0.0 { greatest } else { 1.0 };
        self.proximal.fill(0.0);
        self.semidefinite = self.cholesky(hessian, |_, pivot, entry| pivot > SEMIDEFINITE * entry).is_err();
        if self.semidefinite {
            for (weight, entry) in self.proximal.iter_mut().zip(diagonal()) {
                *weight = PROXIMAL * if entry > 1e-3 * fallback { entry } else { fallback };
            }
            self.cholesky(hessian, |weight, pivot, _| pivot >= 0.5 * weight)
                .map_err(|(row, pivot)| Error::Singular { name: "hessian", row, pivot })?;
        }
        check::all_finite("inverse root of the hessian", &self.inverse_root)
    }

    /// `L⁻¹` in place of `H + P`; `accept(weight, pivot, diagonal entry)` judges each pivot.
    fn cholesky(&mut self, hessian: &[f64], accept: impl Fn(f64, f64, f64) -> bool) -> Result<(), (usize, f64)> {
        let n = self.n;
        let root = &mut self.inverse_root;
        root.copy_from_slice(hessian);
        for i in 0..n {
            let (before, row) = root.split_at_mut(i * n);
            for j in 0..i {
                let above = &before[j * n..=j * n + j];
                row[j] = (row[j] - dot(&row[..j], &above[..j])) / above[j];
            }
            let pivot = hessian[i * n + i] + self.proximal[i] - dot(&row[..i], &row[..i]);
            if !accept(self.proximal[i], pivot, hessian[i * n + i]) {
                return Err((i, pivot));
            }
            row[i] = pivot.sqrt();
            row[i + 1..n].fill(0.0);
        }
        // Row i of the inverse: (eᵢ - Σ L_ij row_j) / L_ii.
        for i in 0..n {
            let (before, row) = root.split_at_mut(i * n);
            self.scratch[..i].copy_from_slice(&row[..i]);
            let diagonal = row[i];
            row[..i].fill(0.0);
            for j in 0..i {
                add_scaled(&mut row[..=j], -self.scratch[j], &before[j * n..=j * n + j]);
            }
            row[..i].iter_mut().for_each(|v| *v /= diagonal);
            row[i] = 1.0 / diagonal;
        }
        Ok(())
    }

    /// Empties the working set.
    pub(super) fn clear(&mut self) {
        self.active = 0;
        self.basis.copy_from_slice(&self.inverse_root);
    }

    /// Takes the linear part of the cost.
    pub(super) fn set_gradient(&mut self, gradient: &[f64]) {
        for (entry, row) in self.gradient.iter_mut().zip(self.basis.chunks_exact(self.n)) {
            *entry = dot(row, gradient);
        }
    }

    /// Projects `sign · normal` on the basis; false if the working set's normals span it.
    pub(super) fn project(&mut self, normal: &[f64], sign: f64) -> bool {
        for (entry, row) in self.projected.iter_mut().zip(self.basis.chunks_exact(self.n)) {
            *entry = sign * dot(row, normal);
        }
        self.is_independent()
    }

    /// Projects a normal along the axis of an unknown.
    pub(super) fn project_axis(&mut self, axis: usize, sign: f64) -> bool {
        for (entry, row) in self.projected.iter_mut().zip(self.basis.chunks_exact(self.n)) {
            *entry = sign * row[axis];
        }
        self.is_independent()
    }

    fn is_independent(&self) -> bool {
        let (within, beyond) = self.projected.split_at(self.active);
        let beyond = dot(beyond, beyond);
        beyond > DEPENDENT * DEPENDENT * (beyond + dot(within, within))
    }

    /// Adds the normal that was projected last, which must be independent: a Householder reflection turns what lies
    /// beyond the working set into the next axis.
    pub(super) fn add(&mut self) {
        let (n, q) = (self.n, self.active);
        let beyond = &mut self.projected[q..];
        let norm = dot(beyond, beyond).sqrt();
        let corner = if beyond[0] > 0.0 { -norm } else { norm };
        // v = d - corner e₁, and 2 / vᵀv = 1 / (norm (norm + |d₁|)).
        let weight = 1.0 / (norm * (norm + beyond[0].abs()));
        beyond[0] -= corner;
        let rows = &mut self.basis[q * n..];
        self.scratch.fill(0.0);
        for (v, row) in beyond.iter().zip(rows.chunks_exact(n)) {
            add_scaled(&mut self.scratch, *v, row);
        }
        for (v, row) in beyond.iter().zip(rows.chunks_exact_mut(n)) {
            add_scaled(row, -weight * v, &self.scratch);
        }
        let along = dot(beyond, &self.gradient[q..]);
        add_scaled(&mut self.gradient[q..], -weight * along, beyond);
        beyond[0] = corner;
        self.triangle[q * n..=q * n + q].copy_from_slice(&self.projected[..=q]);
        self.active += 1;
    }

    /// Takes the normal of a position in the working set out; those behind it move up.
    pub(super) fn remove(&mut self, position: usize) {
        let n = self.n;
        self.active -= 1;
        self.triangle.copy_within((position + 1) * n..(self.active + 1) * n, position * n);
        for k in position..self.active {
            // Row k + 1 of column k is left over: rotate it into row k.
            let (a, b) = (self.triangle[k * n + k], self.triangle[k * n + k + 1]);
            let size = a.hypot(b);
            let (cos, sin) = (a / size, b / size);
            let turn = |upper: &mut f64, lower: &mut f64| {
                (*upper, *lower) = (cos * *upper + sin * *lower, cos * *lower - sin * *upper);
            };
            for column in self.triangle[k * n..self.active * n].chunks_exact_mut(n) {
                let [upper, lower, ..] = &mut column[k..] else { break };
                turn(upper, lower);
            }
            let (upper, lower) = self.basis[k * n..(k + 2) * n].split_at_mut(n);
            upper.iter_mut().zip(lower).for_each(|(upper, lower)| turn(upper, lower));
            if let [upper, lower, ..] = &mut self.gradient[k..] {
                turn(upper, lower);
            }
        }
    }

    /// The multipliers of the minimum on the working set, whose limits are `bounds`.
    pub(super) fn multipliers_into(&mut self, bounds: &[f64], multipliers: &mut [f64]) {
        let (n, q) = (self.n, self.active);
        for k in 0..q {
            let column = &self.triangle[k * n..=k * n + k];
            self.minimum[k] = (bounds[k] - dot(&column[..k], &self.minimum[..k])) / column[k];
            multipliers[k] = self.minimum[k] + self.gradient[k];
        }
        self.back_substitute(&mut multipliers[..q]);
    }

    /// What the working set's normals, times these factors, add up to: the normal that was projected last.
    pub(super) fn combination_into(&self, factors: &mut [f64]) {
        let q = self.active;
        factors[..q].copy_from_slice(&self.projected[..q]);
        self.back_substitute(&mut factors[..q]);
    }

    /// `R⁻¹ v` in place.
    fn back_substitute(&self, v: &mut [f64]) {
        for k in (0..v.len()).rev() {
            let column = &self.triangle[k * self.n..=k * self.n + k];
            v[k] /= column[k];
            let value = v[k];
            add_scaled(&mut v[..k], -value, &column[..k]);
        }
    }

    /// The minimum on the working set, after [`multipliers_into`](Self::multipliers_into).
    pub(super) fn minimum_into(&mut self, x: &mut [f64]) {
        for (y, c) in self.minimum.iter_mut().zip(&self.gradient).skip(self.active) {
            *y = -c;
        }
        x.fill(0.0);
        for (y, row) in self.minimum.iter().zip(self.basis.chunks_exact(self.n)) {
            add_scaled(x, *y, row);
        }
    }
}
