//! Normal equations of chains: every residual depends on unknowns that lie near each other.

use super::{
    BandedCholesky, BandedMatrix,
    normal::{FIXED, NormalSystem, diagonal_damping},
};
use crate::{Error, check};
use nalgebra::{SMatrix, SVector};

/// Sums whose Hessian has a band; keeps its memory when it is [`reset`](Self::reset) to another size.
#[derive(Debug, Clone, Default)]
pub struct BandedNormalEquations {
    hessian: BandedMatrix,
    gradient: Vec<f64>,
    cost: f64,
    factor: BandedCholesky,
    /// The first pair of unknowns that had no place.
    fault: Option<Error>,
}

impl BandedNormalEquations {
    /// Empty sums of `dimension` unknowns, of which no residual ties two that are more than `half_bandwidth` apart.
    pub fn new(dimension: usize, half_bandwidth: usize) -> Self {
        let mut system = Self::default();
        system.reset(dimension, half_bandwidth);
        system
    }

    /// Makes them empty sums of another size.
    pub fn reset(&mut self, dimension: usize, half_bandwidth: usize) {
        self.hessian.reset(dimension, half_bandwidth);
        self.gradient.clear();
        self.gradient.resize(dimension, 0.0);
        (self.cost, self.fault) = (0.0, None);
    }

    /// `Σ w JᵀJ`.
    pub const fn hessian(&self) -> &BandedMatrix {
        &self.hessian
    }
}

impl NormalSystem for BandedNormalEquations {
    fn dimension(&self) -> usize {
        self.hessian.dimension()
    }

    fn clear(&mut self) {
        self.reset(self.hessian.dimension(), self.hessian.half_bandwidth());
    }

    #[inline]
    fn accumulate<const M: usize, const K: usize>(
        &mut self,
        unknowns: &[usize; K],
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, K>,
        weight: f64,
    ) {
        let outer = jacobian.transpose() * jacobian * weight;
        let slope = jacobian.transpose() * residual * weight;
        for (i, &row) in unknowns.iter().enumerate() {
            if row == FIXED {
                continue;
            }
            if let Some(entry) = self.gradient.get_mut(row) {
                *entry += slope[i];
            }
            for (j, &column) in unknowns.iter().enumerate().take(i + 1) {
                if column == FIXED {
                    continue;
                }
                match self.hessian.entry(row.max(column), row.min(column)) {
                    Some(entry) => *entry += outer[(i, j)],
                    None if self.fault.is_none() => {
                        let (value, max) = (row.max(column) as f64, row.min(column) + self.hessian.half_bandwidth());
                        let max = max.min(self.dimension().saturating_sub(1)) as f64;
                        self.fault = Some(Error::OutOfRange { name: "unknown of a residual", value, min: 0.0, max });
                    }
                    None => {}
                }
            }
        }
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
        &self.gradient
    }

    #[inline]
    fn diagonal(&self, unknown: usize) -> f64 {
        self.hessian.diagonal(unknown)
    }

    fn check(&self) -> Result<(), Error> {
        self.fault.map_or(Ok(()), Err)?;
        check::finite("cost", self.cost)?;
        check::all_finite("gradient", &self.gradient)?;
        check::all_finite("hessian", self.hessian.entries())
    }

    fn solve_damped(&mut self, damping: f64, scale: &[f64], step: &mut [f64]) -> bool {
        if self.factor.factor_shifted(&self.hessian, |row| diagonal_damping(damping, scale[row])).is_err() {
            return false;
        }
        step.iter_mut().zip(&self.gradient).for_each(|(step, g)| *step = -g);
        self.factor.solve(step).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::{NormalEquations, RobustKernel};
    use nalgebra::{Matrix2x3, Vector2};

    /// The same residuals of a chain of six unknowns, in any system.
    fn chain(system: &mut impl NormalSystem) {
        for k in 0..5 {
            let residual = Vector2::new(0.3 * k as f64 - 0.5, 1.0 + 0.1 * k as f64);
            let jacobian = Matrix2x3::from_fn(|i, j| (1.3 * k as f64 + 2.1 * i as f64 + 0.7 * j as f64).sin());
            // Not in order, and the last hangs on a place that is given.
            let third = if k < 4 { k + 2 } else { FIXED };
            system.add_at(&[k + 1, third, k], &residual, &jacobian, 1.5);
            system.add_robust_at(&[k, k + 1, third], &residual, &jacobian, 3.0, RobustKernel::Huber { scale: 0.4 });
        }
    }

    #[test]
    fn dense_sums_are_the_same() {
        let (mut banded, mut dense) = (BandedNormalEquations::new(6, 2), NormalEquations::<6>::zeros());
        chain(&mut banded);
        chain(&mut dense);
        assert!(banded.check().is_ok() && dense.check().is_ok());
        assert!((banded.cost() - dense.cost).abs() < 1e-12);
        assert!((SVector::<f64, 6>::from_column_slice(banded.gradient()) - dense.gradient).norm() < 1e-12);
        let (mut ours, mut reference, scale) = ([0.0; 6], [0.0; 6], [1.0, 2.0, 0.0, 1.0, 0.5, 3.0]);
        assert!(banded.solve_damped(0.1, &scale, &mut ours) && dense.solve_damped(0.1, &scale, &mut reference));
        assert!(ours.iter().zip(&reference).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((0..6).all(|i| (banded.diagonal(i) - NormalSystem::diagonal(&dense, i)).abs() < 1e-12));
        banded.clear();
        assert_eq!((banded.cost(), banded.gradient()), (0.0, &[0.0; 6][..]));
    }

    #[test]
    fn residuals_without_a_place_are_refused() {
        let (residual, jacobian) = (Vector2::new(1.0, 2.0), Matrix2x3::from_element(1.0));
        for unknowns in [[0, 1, 5], [4, 5, 6], [3, 0, FIXED]] {
            let mut banded = BandedNormalEquations::new(6, 2);
            banded.add_at(&unknowns, &residual, &jacobian, 1.0);
            assert!(matches!(banded.check(), Err(Error::OutOfRange { .. })), "{unknowns:?}");
            banded.clear();
            assert_eq!(banded.check(), Ok(()));
        }
        let mut dense = NormalEquations::<6>::zeros();
        dense.add_at(&[4, 5, 6], &residual, &jacobian, 1.0);
        assert!(dense.check().is_err());
        let mut banded = BandedNormalEquations::new(6, 2);
        banded.add_at(&[0, 1, 2], &(residual * f64::NAN), &jacobian, 1.0);
        assert!(matches!(banded.check(), Err(Error::NotFinite { .. })));
    }
}
