//! Matrix exponential of small matrices.
//!
//! Scaling and squaring with the diagonal Padé approximant of degree 6 (Golub and Van Loan, *Matrix Computations*,
//! 4th ed., algorithm 9.3.1): `exp(M) = (N(M / 2^s) / N(-M / 2^s))^(2^s)` with `‖M‖∞ / 2^s <= 1/2`, for which the
//! approximant's relative error is below 4e-16.

use nalgebra::SMatrix;

/// Side of the matrices that plants need: eight states and two inputs. Smaller ones are padded with zeros, whose
/// exponential is the identity beside them.
pub(crate) const SIDE: usize = 10;

pub(crate) type Square = SMatrix<f64, SIDE, SIDE>;

/// Degree `q` of numerator and denominator.
const DEGREE: i32 = 6;

/// `exp(matrix)`; none if it is not finite.
pub(crate) fn expm(matrix: &Square) -> Option<Square> {
    let norm = (0..SIDE).map(|i| matrix.row(i).iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    // Beyond this the exponential overflows or is zero, or a state turns a million times in one sample.
    if !matrix.iter().all(|v| v.is_finite()) || norm > 1e6 {
        return None;
    }
    let halvings = if norm > 0.5 { (norm / 0.5).log2().ceil() as i32 } else { 0 };
    let scaled = matrix * 0.5_f64.powi(halvings);

    // N(M) = Σ c_k M^k with c_k = c_{k-1} (q - k + 1) / (k (2 q - k + 1)); the odd powers change sign for N(-M).
    let (mut power, mut coefficient) = (Square::identity(), 1.0);
    let (mut even, mut odd) = (Square::identity(), Square::zeros());
    for k in 1..=DEGREE {
        power *= scaled;
        coefficient *= f64::from(DEGREE - k + 1) / f64::from(k * (2 * DEGREE - k + 1));
        if k % 2 == 0 {
            even += power * coefficient;
        } else {
            odd += power * coefficient;
        }
    }
    let mut result = (even - odd).lu().solve(&(even + odd))?;
    for _ in 0..halvings {
        result *= result;
    }
    result.iter().all(|v| v.is_finite()).then_some(result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// nalgebra's exponential is an independent implementation (degree 3 to 13, another scaling).
        #[test]
        fn agrees_with_nalgebra(entries in prop::collection::vec(-3.0..3.0_f64, 25), scale in 1e-6..3.0_f64) {
            let small = SMatrix::<f64, 5, 5>::from_column_slice(&entries) * scale;
            let mut padded = Square::zeros();
            padded.fixed_view_mut::<5, 5>(0, 0).copy_from(&small);
            let ours = expm(&padded).unwrap();
            let theirs = small.exp();
            let difference = (ours.fixed_view::<5, 5>(0, 0) - theirs).amax();
            prop_assert!(difference <= 1e-11 * theirs.amax().max(1.0), "{difference}");
            prop_assert_eq!(ours[(9, 9)], 1.0);
        }
    }

    #[test]
    fn known_exponentials() {
        let (mut turn, mut shift) = (Square::zeros(), Square::zeros());
        (turn[(0, 1)], turn[(1, 0)]) = (-20.0, 20.0);
        let rotation = expm(&turn).unwrap();
        assert!((rotation[(0, 0)] - 20.0_f64.cos()).abs() < 1e-13);
        assert!((rotation[(1, 0)] - 20.0_f64.sin()).abs() < 1e-13);
        // A chain of integrators: 1, t, t²/2, t³/6.
        (0..3).for_each(|i| shift[(i, i + 1)] = 2.0);
        let chain = expm(&shift).unwrap();
        for (j, expected) in [1.0, 2.0, 2.0, 4.0 / 3.0].into_iter().enumerate() {
            assert!((chain[(0, j)] - expected).abs() < 1e-14);
        }
    }

    #[test]
    fn what_is_beyond_numbers_is_none() {
        for value in [f64::NAN, f64::INFINITY, 1e5, 1e300] {
            let mut matrix = Square::zeros();
            matrix[(0, 0)] = value;
            assert_eq!(expm(&matrix), None, "{value}");
        }
    }
}
