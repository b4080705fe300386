//! Two measurements of one pose made into one, weighted by their information.
//!
//! With `δ = b ⊖ a` and `b`'s covariance carried to `a`'s tangent space, `Σ_b' = Jr⁻¹(δ) Σ_b Jr⁻ᵀ(δ)`,
//!
//! ```text
//! K = Σ_a (Σ_a + Σ_b')⁻¹      a ← a ⊕ K δ      Σ ← Jr(K δ) ((I - K) Σ_a (I - K)ᵀ + K Σ_b' Kᵀ) Jrᵀ(K δ)
//! ```
//!
//! For errors of equal size in all directions that is the bound of paper 001's Table 5: `1/σ² = 1/σ_a² + 1/σ_b²`.

use agv_core::{
    Error,
    geometry::{LieGroup, UncertainPose, propagate_covariance},
};

/// A pose that was made of two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusedPose<G: LieGroup> {
    /// The pose that both together say.
    pub pose: UncertainPose<G>,
    /// Squared distance of the two by their covariances: chi-square of as many degrees of freedom as the pose has, if the
    /// covariances are right.
    pub nis: f64,
}

/// The difference of two poses, in the first one's tangent space.
struct Innovation<G: LieGroup> {
    difference: G::Tangent,
    /// Covariance of the second pose, carried there.
    carried: G::Matrix,
    /// Of the sum of both covariances.
    inverse: G::Matrix,
    nis: f64,
}

fn innovation<G: LieGroup>(a: &UncertainPose<G>, b: &UncertainPose<G>) -> Result<Innovation<G>, Error> {
    let difference = b.mean().minus(a.mean());
    let carried = propagate_covariance::<G>(&G::right_jacobian_inverse(&difference), b.covariance());
    let singular = Error::Singular { name: "sum of the covariances", row: 0, pivot: 0.0 };
    let inverse = G::inverse_of(&(*a.covariance() + carried)).ok_or(singular)?;
    let weighed = inverse * difference;
    let nis = G::tangent_slice(&difference).iter().zip(G::tangent_slice(&weighed)).map(|(d, w)| d * w).sum();
    Ok(Innovation { difference, carried, inverse, nis })
}

/// Squared distance of two independent measurements of one pose, by their covariances.
///
/// # Errors
/// [`Error::Singular`] if both are exact in one direction.
pub fn pose_distance<G: LieGroup>(a: &UncertainPose<G>, b: &UncertainPose<G>) -> Result<f64, Error> {
    innovation(a, b).map(|innovation| innovation.nis)
}

/// The pose that two independent measurements of it say together.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::nalgebra::Matrix3;
/// use agv_filters::marker::fuse_poses;
///
/// let wide = UncertainPose::new(Se2::new(1.0, 2.0, 0.1), Matrix3::identity() * 0.04)?;
/// let narrow = UncertainPose::new(Se2::new(1.1, 2.0, 0.1), Matrix3::identity() * 0.01)?;
/// let fused = fuse_poses(&wide, &narrow)?;
/// assert!((fused.pose.mean().x() - 1.08).abs() < 1e-12 && (fused.pose.covariance()[(0, 0)] - 0.008).abs() < 1e-12);
/// assert!((fused.nis - 0.2).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Singular`] if both are exact in one direction.
pub fn fuse_poses<G: LieGroup>(a: &UncertainPose<G>, b: &UncertainPose<G>) -> Result<FusedPose<G>, Error> {
    let Innovation { difference, carried, inverse, nis } = innovation(a, b)?;
    let gain = *a.covariance() * inverse;
    let step = gain * difference;
    let keep = G::identity_matrix() - gain;
    let joseph = propagate_covariance::<G>(&keep, a.covariance()) + propagate_covariance::<G>(&gain, &carried);
    let covariance = propagate_covariance::<G>(&G::right_jacobian(&step), &joseph);
    Ok(FusedPose { pose: UncertainPose::new(a.mean().plus(&step), covariance)?, nis })
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::Se2;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    fn pose(x: f64, y: f64, yaw: f64, sigmas: [f64; 3]) -> UncertainPose<Se2> {
        let sigmas = Vector3::from(sigmas);
        UncertainPose::new(Se2::new(x, y, yaw), Matrix3::from_diagonal(&sigmas.component_mul(&sigmas))).unwrap()
    }

    proptest! {
        /// To first order it does not matter which comes first, and both inputs lose variance.
        #[test]
        fn the_order_does_not_matter(d in prop::array::uniform3(-0.01..0.01_f64), s in prop::array::uniform3(0.01..0.05_f64)) {
            let a = pose(3.0, -2.0, 3.1, s);
            let b = UncertainPose::new(a.mean().plus(&Vector3::from(d)), Matrix3::identity() * 4e-4).unwrap();
            let (ab, ba) = (fuse_poses(&a, &b).unwrap(), fuse_poses(&b, &a).unwrap());
            prop_assert!(ab.pose.mean().minus(ba.pose.mean()).norm() < 1e-4 * (1e-9 + Vector3::from(d).norm()).max(1e-3));
            prop_assert!((ab.nis - ba.nis).abs() < 0.02 * (1.0 + ab.nis));
            for i in 0..3 {
                let least = a.covariance()[(i, i)].min(b.covariance()[(i, i)]);
                prop_assert!(ab.pose.covariance()[(i, i)] < least);
            }
        }
    }

    #[test]
    fn an_exact_pose_wins_and_two_of_them_are_refused() {
        let exact = UncertainPose::exact(Se2::new(1.0, 1.0, 0.0));
        let fused = fuse_poses(&pose(1.1, 0.9, 0.1, [0.1; 3]), &exact).unwrap();
        assert!(fused.pose.mean().minus(exact.mean()).norm() < 1e-12 && fused.pose.covariance().amax() < 1e-12);
        assert!(matches!(fuse_poses(&exact, &exact), Err(Error::Singular { .. })));
        assert!(pose_distance(&exact, &exact).is_err());
    }
}
