//! The discrete algebraic Riccati equation: the cost to go of the best feedback, and that feedback.
//!
//! ```text
//! x⁺ = A x + B u        minimise Σ xᵀQ x + uᵀR u
//! P = Q + Aᵀ P (I + G P)⁻¹ A        G = B R⁻¹ Bᵀ        u = -K x,  K = (R + BᵀP B)⁻¹ BᵀP A
//! ```
//!
//! Solved by the structure-preserving doubling algorithm (Chu, Fan, Lin and Wang, *Structure-preserving algorithms for periodic
//! discrete-time algebraic Riccati equations*, 2004): after `k` doublings `H` is the cost over `2ᵏ` steps and `A` their closed
//! loop, so convergence is quadratic and a loop that does not vanish is a model that no feedback stabilises.

use crate::Error;
use agv_core::check;
use nalgebra::{Const, DimMin, SMatrix, ToTypenum};

/// The best feedback of a linear model, and what it costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regulator<const N: usize, const M: usize> {
    /// Feedback `K`, with `u = -K x`.
    pub gain: SMatrix<f64, M, N>,
    /// Cost to go `P`: from `x` on, `xᵀP x`.
    pub cost: SMatrix<f64, N, N>,
}

/// Horizon of `2^60` steps: what has not converged then, never will.
const DOUBLINGS: usize = 60;

/// Change of the cost, relative to it, at which it has converged.
const CONVERGED: f64 = 1e-14;

/// The feedback that minimises `Σ xᵀQ x + uᵀR u` for `x⁺ = A x + B u`. `O(N³)` for each of about ten doublings.
///
/// # Errors
/// [`Error::NotStabilisable`]; a matrix that is not finite, a `Q` that is not positive semi-definite or an `R` that is not
/// positive definite.
///
/// ```
/// use agv_control::track::riccati;
/// use agv_core::nalgebra::Matrix1;
///
/// // P = 1 + P - P²/(1 + P): the golden ratio.
/// let one = Matrix1::new(1.0);
/// let regulator = riccati(&one, &one, &one, &one)?;
/// assert!((regulator.cost[0] - 1.618_033_988_749_895).abs() < 1e-12);
/// # Ok::<(), agv_control::Error>(())
/// ```
pub fn riccati<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SMatrix<f64, N, N>,
    r: &SMatrix<f64, M, M>,
) -> Result<Regulator<N, M>, Error>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>> + ToTypenum,
{
    check::all_finite("A", a.iter())?;
    check::all_finite("B", b.iter())?;
    check::covariance("Q", q)?;
    check::positive_definite("R", r)?;
    let weight = r.cholesky().ok_or(agv_core::Error::NotCovariance { name: "R", pivot: 0.0 })?;
    let (mut loop_, mut reach, mut cost) = (*a, b * weight.solve(&b.transpose()), *q);
    let failed = |doublings: usize, norm: f64| Error::NotStabilisable { doublings, norm };
    for doubling in 1..=DOUBLINGS {
        // W = (I + G H)⁻¹ exists: G and H are positive semi-definite.
        let solve = (SMatrix::identity() + reach * cost).lu();
        let (Some(wa), Some(wg)) = (solve.solve(&loop_), solve.solve(&reach)) else {
            return Err(failed(doubling, loop_.norm()));
        };
        let gain = loop_.transpose() * cost * wa;
        reach += loop_ * wg * loop_.transpose();
        loop_ *= wa;
        cost += gain;
        cost = 0.5 * (cost + cost.transpose());
        let norm = loop_.norm();
        if !(norm.is_finite() && cost.norm().is_finite()) {
            return Err(failed(doubling, norm));
        }
        if gain.norm() <= CONVERGED * cost.norm() && norm < 1e-6 {
            let pressed = b.transpose() * cost;
            let gain = (r + pressed * b).cholesky().ok_or(failed(doubling, norm))?.solve(&(pressed * a));
            return Ok(Regulator { gain, cost });
        }
    }
    Err(failed(DOUBLINGS, loop_.norm()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, Matrix3, Vector2, Vector3};
    use proptest::prelude::*;

    proptest! {
        /// The cost solves the equation, and is that of the closed loop, summed step by step.
        #[test]
        fn the_cost_is_that_of_the_loop(
            entries in prop::array::uniform9(-1.2..1.2_f64), b in prop::array::uniform3(-1.0..1.0_f64), r in 0.01..10.0_f64,
            x in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let (a, b) = (Matrix3::from_column_slice(&entries), Vector3::from_column_slice(&b));
            let (q, r) = (Matrix3::identity(), Matrix1::new(r));
            let Ok(Regulator { gain, cost }) = riccati(&a, &b, &q, &r) else { return Ok(()) };
            // A mode that is nearly out of reach costs beyond measure.
            prop_assume!(cost.norm() < 1e6);
            let mut x = Vector3::from_column_slice(&x);
            let (promised, mut sum) = ((x.transpose() * cost * x)[0], 0.0);
            for _ in 0..200_000 {
                let u = -gain * x;
                sum += (x.transpose() * q * x)[0] + (u.transpose() * r * u)[0];
                x = a * x + b * u;
                if x.norm() < 1e-12 {
                    break;
                }
            }
            prop_assert!((sum - promised).abs() <= 1e-6 * (1.0 + promised), "{} {}", sum, promised);
        }
    }

    #[test]
    fn a_double_integrator_has_the_gains_of_the_books() {
        // x'' = u with Q = diag(1, 0), R = 1 has K = (1, √2) in continuous time: the limit of short steps.
        let dt = 1e-4;
        let (a, b) = (Matrix2::new(1.0, dt, 0.0, 1.0), Vector2::new(0.5 * dt * dt, dt));
        let regulator = riccati(&a, &b, &Matrix2::from_diagonal(&Vector2::new(dt, 0.0)), &Matrix1::new(dt)).unwrap();
        assert!((regulator.gain[0] - 1.0).abs() < 1e-3 && (regulator.gain[1] - 2.0_f64.sqrt()).abs() < 1e-3);
    }

    #[test]
    fn what_cannot_be_stabilised_is_told() {
        let (one, zero) = (Matrix1::new(1.0), Matrix1::new(0.0));
        for (a, b, q) in [(2.0, 0.0, 1.0), (1.0, 0.0, 1.0), (1.0, 0.0, 0.0)] {
            let solved = riccati(&Matrix1::new(a), &Matrix1::new(b), &Matrix1::new(q), &one);
            assert!(matches!(solved, Err(Error::NotStabilisable { .. })), "{a} {b} {q}: {solved:?}");
        }
        assert!(riccati(&one, &one, &one, &zero).is_err(), "inputs that cost nothing");
        assert!(riccati(&one, &one, &-one, &one).is_err(), "errors that pay");
        assert!(riccati(&Matrix1::new(f64::NAN), &one, &one, &one).is_err());
        // Stable by itself: nothing to do.
        assert_eq!(riccati(&Matrix1::new(0.5), &zero, &zero, &one).unwrap().gain[0], 0.0);
    }
}
