//! A predicted pose and a measured one, brought together.
//!
//! With the prediction's covariance `P`, the measurement's information `Λ` and their difference `δ = z ⊖ x` the most likely pose and
//! its covariance are, to first order,
//!
//! ```text
//! Λ' = J(δ)ᵀ Λ J(δ)        P' = (I + P Λ')⁻¹ P        ε = P' Λ' δ
//! x⁺ = x ⊕ ε               P⁺ = J(ε) P' J(ε)ᵀ         NIS = δᵀ (Λ' - Λ' P' Λ') δ
//! ```
//!
//! `J`, the right Jacobian, takes information and covariance from one pose's frame to the other's: where headings differ, what is not
//! seen along a corridor would else be taken for seen.
//!
//! Neither matrix is inverted: directions that the measurement does not see have no information, and keep the prediction's.

use agv_core::{
    Error,
    geometry::{LieGroup, PoseSigma, Se3, UncertainPose},
};
use nalgebra::{Matrix6, Vector6};

/// What a prediction and a measurement amount to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fused {
    pub(super) pose: UncertainPose<Se3>,
    /// Normalised innovation squared.
    pub(super) nis: f64,
}

/// The prediction corrected by a measurement of this information.
pub(super) fn fuse(predicted: &UncertainPose<Se3>, measured: &Se3, information: &Matrix6<f64>) -> Result<Fused, Error> {
    let (mean, prior) = (predicted.mean(), predicted.covariance());
    let singular = Error::Singular { name: "fusion", row: 0, pivot: 0.0 };
    let difference = measured.minus(mean);
    let jacobian = Se3::right_jacobian(&difference);
    let information = symmetric(&(jacobian.transpose() * information * jacobian));
    let posterior = symmetric(&(Matrix6::identity() + prior * information).lu().solve(prior).ok_or(singular)?);
    let pull = information * difference;
    let step = posterior * pull;
    let nis = difference.dot(&pull) - pull.dot(&step);
    let jacobian = Se3::right_jacobian(&step);
    let covariance = symmetric(&(jacobian * posterior * jacobian.transpose()));
    Ok(Fused { pose: UncertainPose::new(mean.plus(&step), covariance)?, nis: nis.max(0.0) })
}

/// The information of a match of which only a share of the points is independent, and which is never better than `floor`:
/// `(I + s Λ F)⁻¹ s Λ`, the inverse of `(s Λ)⁻¹ + F` where that exists.
pub(super) fn tempered(information: &Matrix6<f64>, share: f64, floor: PoseSigma) -> Matrix6<f64> {
    let shared = information * share;
    let (t, r) = (floor.translation.powi(2), floor.rotation.powi(2));
    let floor = Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r));
    (Matrix6::identity() + shared * floor).lu().solve(&shared).map_or(Matrix6::zeros(), |tempered| symmetric(&tempered))
}

fn symmetric(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn spread(scale: f64) -> Matrix6<f64> {
        let mixed = Matrix6::from_fn(|i, j| if i == j { 1.0 } else { 0.3 * ((i * 7 + j * 3) as f64).sin() });
        mixed * mixed.transpose() * scale
    }

    /// Against the inverses of the textbook, where there are some.
    #[test]
    fn the_fusion_is_that_of_two_gaussians() {
        let (prior, noise) = (spread(0.01), spread(0.002));
        let start = Se3::exp(&Vector6::new(1.0, 2.0, 0.3, 0.1, -0.2, 0.7));
        let predicted = UncertainPose::new(start, prior).unwrap();
        let difference = Vector6::new(0.02, -0.01, 0.03, 0.004, -0.005, 0.006);
        let fused = fuse(&predicted, &start.plus(&difference), &noise.try_inverse().unwrap()).unwrap();
        // The measurement's noise about the prediction, and the result's about the new pose.
        let back = Se3::right_jacobian_inverse(&difference);
        let noise = back * noise * back.transpose();
        let gain = prior * (prior + noise).try_inverse().unwrap();
        assert_relative_eq!(fused.pose.mean().minus(&start), gain * difference, epsilon = 1e-9);
        let there = Se3::right_jacobian(&(gain * difference));
        let covariance = there * (Matrix6::identity() - gain) * prior * there.transpose();
        assert_relative_eq!(*fused.pose.covariance(), covariance, epsilon = 1e-12);
        let nis = difference.dot(&((prior + noise).try_inverse().unwrap() * difference));
        assert_relative_eq!(fused.nis, nis, max_relative = 1e-9);
    }

    #[test]
    fn what_is_not_seen_stays_predicted_and_what_is_known_stays_known() {
        let start = Se3::identity();
        let mut seen = Matrix6::from_diagonal_element(1e6);
        seen[(0, 0)] = 0.0;
        let known = UncertainPose::new(start, Matrix6::identity() * 0.04).unwrap();
        let fused = fuse(&known, &start.plus(&Vector6::repeat(0.01)), &seen).unwrap();
        let moved = fused.pose.mean().minus(&start);
        assert!(moved.x.abs() < 2e-4 && (moved.y - 0.01).abs() < 2e-4, "{moved}");
        assert!((fused.pose.covariance()[(0, 0)] - 0.04).abs() < 1e-5 && fused.pose.covariance()[(1, 1)] < 1e-5);
        let exact = fuse(&UncertainPose::exact(start), &start.plus(&Vector6::repeat(0.01)), &seen).unwrap();
        assert_eq!((*exact.pose.mean(), *exact.pose.covariance()), (start, Matrix6::zeros()));
    }

    #[test]
    fn tempering_bounds_what_is_seen_and_invents_nothing() {
        let mut information = Matrix6::from_diagonal_element(1e8);
        information[(0, 0)] = 0.0;
        let tempered = tempered(&information, 0.1, PoseSigma { translation: 0.01, rotation: 0.001 });
        let expected = |sigma: f64| 1.0 / (1e-7 + sigma * sigma);
        assert_eq!(tempered[(0, 0)], 0.0);
        assert_relative_eq!(tempered[(1, 1)], expected(0.01), max_relative = 1e-9);
        assert_relative_eq!(tempered[(5, 5)], expected(0.001), max_relative = 1e-9);
    }
}
