//! Normal equations of least squares: what residuals are summed in, and what a damped step is solved from.

use super::RobustKernel;
use crate::{Error, check};
use nalgebra::{SMatrix, SVector};

/// In place of an unknown's index: it is given, and the columns of its Jacobian are left out.
pub const FIXED: usize = usize::MAX;

/// Normal equations of any structure, as [`LevenbergMarquardt`](super::LevenbergMarquardt) needs them.
///
/// [`NormalEquations`] is dense, of a size that the compiler knows: poses, calibrations. [`BandedNormalEquations`] serves
/// chains: elastic bands, splines, smoothing. A graph brings a sparse one of its own.
///
/// [`BandedNormalEquations`]: super::BandedNormalEquations
pub trait NormalSystem {
    /// Number of unknowns.
    fn dimension(&self) -> usize;

    /// Empties all sums.
    fn clear(&mut self);

    /// Adds `w JᵀJ` and `w Jᵀr` of a residual that depends on these unknowns, which differ from each other or are
    /// [`FIXED`]. A place that the structure does not have is remembered, and refused by [`check`](Self::check).
    fn accumulate<const M: usize, const K: usize>(
        &mut self,
        unknowns: &[usize; K],
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, K>,
        weight: f64,
    );

    /// Adds to the cost.
    fn add_cost(&mut self, cost: f64);

    /// Adds a residual and its cost `½ w |r|²`.
    #[inline]
    fn add_at<const M: usize, const K: usize>(
        &mut self,
        unknowns: &[usize; K],
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, K>,
        weight: f64,
    ) {
        self.accumulate(unknowns, residual, jacobian, weight);
        self.add_cost(0.5 * weight * residual.norm_squared());
    }

    /// Adds a residual under a robust kernel, and its cost `½ ϱ(w |r|²)`.
    #[inline]
    fn add_robust_at<const M: usize, const K: usize>(
        &mut self,
        unknowns: &[usize; K],
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, K>,
        weight: f64,
        kernel: RobustKernel,
    ) {
        let squared = weight * residual.norm_squared();
        self.accumulate(unknowns, residual, jacobian, weight * kernel.weight(squared));
        self.add_cost(0.5 * kernel.loss(squared));
    }

    /// The cost summed so far.
    fn cost(&self) -> f64;

    /// The gradient, one entry per unknown.
    fn gradient(&self) -> &[f64];

    /// The Hessian's diagonal entry of an unknown.
    fn diagonal(&self, unknown: usize) -> f64;

    /// Accepts sums that are finite and had a place.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::OutOfRange`] for a residual that depends on unknowns too far apart or absent.
    fn check(&self) -> Result<(), Error>;

    /// Solves `(H + damping S) step = -g` with the diagonal `S`; an unknown whose entry of `S` is zero has met no residual
    /// and stays. False if the matrix is not positive definite. The sums stay as they are.
    fn solve_damped(&mut self, damping: f64, scale: &[f64], step: &mut [f64]) -> bool;
}

/// What damping adds to the diagonal entry of an unknown whose scale is `scale`, by the rule of
/// [`NormalSystem::solve_damped`]; for those who write a system of their own.
#[inline]
pub fn diagonal_damping(damping: f64, scale: f64) -> f64 {
    if scale > 0.0 { damping * scale } else { 1.0 }
}

/// Dense sums that residuals are accumulated in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations<const N: usize> {
    /// `Σ w JᵀJ`.
    pub hessian: SMatrix<f64, N, N>,
    /// `Σ w Jᵀr`.
    pub gradient: SVector<f64, N>,
    /// `½ Σ w rᵀr`.
    pub cost: f64,
}

impl<const N: usize> NormalEquations<N> {
    /// Empty sums.
    pub fn zeros() -> Self {
        Self { hessian: SMatrix::zeros(), gradient: SVector::zeros(), cost: 0.0 }
    }

    /// Adds a residual with `M` entries, its Jacobian and its weight.
    #[inline]
    pub fn add<const M: usize>(&mut self, residual: &SVector<f64, M>, jacobian: &SMatrix<f64, M, N>, weight: f64) {
        let weighted = jacobian.transpose() * weight;
        self.hessian += weighted * jacobian;
        self.gradient += weighted * residual;
        self.cost += 0.5 * weight * residual.norm_squared();
    }

    /// Adds a residual under a robust kernel, whose cost is `½ ϱ(w |r|²)`.
    #[inline]
    pub fn add_robust<const M: usize>(
        &mut self,
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, N>,
        weight: f64,
        kernel: RobustKernel,
    ) {
        let squared = weight * residual.norm_squared();
        let cost = self.cost + 0.5 * kernel.loss(squared);
        self.add(residual, jacobian, weight * kernel.weight(squared));
        self.cost = cost;
    }
}

impl<const N: usize> NormalSystem for NormalEquations<N> {
    fn dimension(&self) -> usize {
        N
    }

    fn clear(&mut self) {
        *self = Self::zeros();
    }

    fn accumulate<const M: usize, const K: usize>(
        &mut self,
        unknowns: &[usize; K],
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, K>,
        weight: f64,
    ) {
        let mut spread = SMatrix::<f64, M, N>::zeros();
        for (column, &unknown) in unknowns.iter().enumerate() {
            if unknown < N {
                spread.set_column(unknown, &jacobian.column(column));
            } else if unknown != FIXED {
                self.cost = f64::NAN; // refused by `check`
            }
        }
        let cost = self.cost;
        self.add(residual, &spread, weight);
        self.cost = cost;
    }

    #[inline]
    fn add_cost(&mut self, cost: f64) {
        self.cost += cost;
    }

    #[inline]
    fn cost(&self) -> f64 {
        self.cost
    }

    #[inline]
    fn gradient(&self) -> &[f64] {
        self.gradient.as_slice()
    }

    #[inline]
    fn diagonal(&self, unknown: usize) -> f64 {
        self.hessian[(unknown, unknown)]
    }

    fn check(&self) -> Result<(), Error> {
        check::finite("cost", self.cost)?;
        check::all_finite("gradient", self.gradient.iter())?;
        check::all_finite("hessian", self.hessian.iter())
    }

    #[inline]
    fn solve_damped(&mut self, damping: f64, scale: &[f64], step: &mut [f64]) -> bool {
        let mut matrix = self.hessian;
        for i in 0..N {
            matrix[(i, i)] += diagonal_damping(damping, scale[i]);
        }
        let Some(factor) = matrix.cholesky() else { return false };
        step.copy_from_slice(factor.solve(&-self.gradient).as_slice());
        true
    }
}
