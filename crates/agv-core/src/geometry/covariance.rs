//! Poses with covariance, and how covariances travel through the group operations, to first order.
//!
//! A covariance belongs to the right increment: `pose = mean ⊕ τ` with `τ ~ N(0, Σ)`, so `Σ` of `a_from_b` is written
//! in frame b, translation first. With the Jacobians of [`LieGroup`] (Solà Eqs. 62, 64, 65; `Ad` is the adjoint):
//!
//! ```text
//! compose   a_from_c = a_from_b ∘ b_from_c     Σ_c = J Σ_b Jᵀ + Σ_bc + J C + (J C)ᵀ,   J = Ad(c_from_b)
//! inverse   b_from_a                           Σ_a = Ad Σ_b Adᵀ,                       Ad = Ad(a_from_b)
//! between   b_from_c = b_from_a ∘ a_from_c     Σ_c = J Σ_b Jᵀ + Σ_ac + J C + (J C)ᵀ,   J = -Ad(c_from_b)
//! ```
//!
//! where `C = E[τ_first τ_secondᵀ]` is the cross-covariance of the two poses, zero if they are independent.

use super::LieGroup;
use crate::Error;

/// `J Σ Jᵀ`, symmetric to the last bit.
#[inline]
pub fn propagate_covariance<G: LieGroup>(jacobian: &G::Matrix, covariance: &G::Matrix) -> G::Matrix {
    symmetric::<G>(&(*jacobian * *covariance * G::transpose(jacobian)))
}

/// Mean of a matrix and its transpose: products round to slightly asymmetric ones.
fn symmetric<G: LieGroup>(matrix: &G::Matrix) -> G::Matrix {
    (*matrix + G::transpose(matrix)) * 0.5
}

/// A pose `target_from_source` with the covariance of its right increment.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, UncertainPose};
/// use agv_core::nalgebra::{Matrix3, Vector3};
///
/// // A vehicle known to 1 cm and 0.01 rad, and a fork tip exactly 2 m behind its centre.
/// let base = UncertainPose::new(Se2::new(5.0, 1.0, 0.3), Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-4)))?;
/// let fork = base.transport_source(&Se2::new(-2.0, 0.0, 0.0));
/// // The heading's uncertainty swings the tip sideways: 1e-4 + (2 m)² 1e-4 rad².
/// assert!((fork.covariance()[(1, 1)] - 5e-4).abs() < 1e-15);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "RawUncertainPose<G>",
        bound(
            serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
            deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
        )
    )
)]
pub struct UncertainPose<G: LieGroup> {
    mean: G,
    covariance: G::Matrix,
}

/// An [`UncertainPose`] as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"))]
struct RawUncertainPose<G: LieGroup> {
    mean: G,
    covariance: G::Matrix,
}

#[cfg(feature = "serde")]
impl<G: LieGroup> TryFrom<RawUncertainPose<G>> for UncertainPose<G> {
    type Error = Error;

    fn try_from(raw: RawUncertainPose<G>) -> Result<Self, Error> {
        Self::new(raw.mean, raw.covariance)
    }
}

impl<G: LieGroup> UncertainPose<G> {
    /// A pose with the covariance of its right increment, in the source frame, translation first.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; [`Error::NotCovariance`] unless symmetric and positive semi-definite.
    pub fn new(mean: G, covariance: G::Matrix) -> Result<Self, Error> {
        if !mean.is_finite() {
            return Err(Error::NotFinite { name: "pose", value: f64::NAN });
        }
        G::check_covariance("covariance", &covariance)?;
        Ok(Self { mean, covariance: symmetric::<G>(&covariance) })
    }

    /// A pose that is known exactly, as a calibrated mount.
    pub fn exact(mean: G) -> Self {
        Self { mean, covariance: G::identity_matrix() * 0.0 }
    }

    /// The pose.
    pub const fn mean(&self) -> &G {
        &self.mean
    }

    /// Covariance of the right increment, in the source frame, translation first (m², m rad, rad²).
    pub const fn covariance(&self) -> &G::Matrix {
        &self.covariance
    }

    /// Root of the summed variances of the translation, in metres: how far off the position is, as a root mean square.
    pub fn position_deviation(&self) -> f64 {
        self.variances().take(G::TRANSLATION_DOF).sum::<f64>().sqrt()
    }

    /// Root of the summed variances of the rotation, in radians; of a planar pose that of the heading.
    pub fn rotation_deviation(&self) -> f64 {
        self.variances().skip(G::TRANSLATION_DOF).sum::<f64>().sqrt()
    }

    fn variances(&self) -> impl Iterator<Item = f64> {
        G::matrix_slice(&self.covariance).iter().step_by(G::DOF + 1).copied()
    }

    /// Covariance of the left increment `exp(τ) ∘ mean`, in the target frame: `Ad Σ Adᵀ`. Mind that it is the
    /// covariance of a body point that lies in the *target's* origin, so it grows with the distance from there.
    pub fn left_covariance(&self) -> G::Matrix {
        propagate_covariance::<G>(&self.mean.adjoint(), &self.covariance)
    }

    /// `self ∘ rhs` of two independent poses.
    pub fn compose(&self, rhs: &Self) -> Self {
        let (jacobian, _) = self.mean.compose_jacobians(&rhs.mean);
        Self {
            mean: self.mean.compose(&rhs.mean),
            covariance: propagate_covariance::<G>(&jacobian, &self.covariance) + rhs.covariance,
        }
    }

    /// `self ∘ rhs` of two poses with cross-covariance `E[τ_self τ_rhsᵀ]`.
    ///
    /// # Errors
    /// [`Error::NotCovariance`] or [`Error::NotFinite`] if the cross-covariance contradicts the two covariances.
    pub fn compose_correlated(&self, rhs: &Self, cross: &G::Matrix) -> Result<Self, Error> {
        let (jacobian, _) = self.mean.compose_jacobians(&rhs.mean);
        let sum = self.compose(rhs);
        Self::new(sum.mean, sum.covariance + symmetric::<G>(&(jacobian * *cross)) * 2.0)
    }

    /// The inverse pose.
    pub fn inverse(&self) -> Self {
        let jacobian = self.mean.inverse_jacobian();
        Self { mean: self.mean.inverse(), covariance: propagate_covariance::<G>(&jacobian, &self.covariance) }
    }

    /// `self⁻¹ ∘ other` of two independent poses.
    pub fn between(&self, other: &Self) -> Self {
        let (jacobian, _) = self.mean.between_jacobians(&other.mean);
        Self {
            mean: self.mean.between(&other.mean),
            covariance: propagate_covariance::<G>(&jacobian, &self.covariance) + other.covariance,
        }
    }

    /// `self⁻¹ ∘ other` of two poses with cross-covariance `E[τ_self τ_otherᵀ]`, as two poses of one trajectory have.
    ///
    /// # Errors
    /// [`Error::NotCovariance`] or [`Error::NotFinite`] if the cross-covariance contradicts the two covariances.
    pub fn between_correlated(&self, other: &Self, cross: &G::Matrix) -> Result<Self, Error> {
        let (jacobian, _) = self.mean.between_jacobians(&other.mean);
        let sum = self.between(other);
        Self::new(sum.mean, sum.covariance + symmetric::<G>(&(jacobian * *cross)) * 2.0)
    }

    /// The pose of another frame on the same body, at the exactly known `source_from_new`: `Σ' = Ad⁻¹ Σ Ad⁻ᵀ`.
    pub fn transport_source(&self, source_from_new: &G) -> Self {
        self.compose(&Self::exact(*source_from_new))
    }

    /// The same body seen from another, exactly known frame: the covariance stays, since it lives in the source frame.
    pub fn transport_target(&self, new_from_target: &G) -> Self {
        Self { mean: new_from_target.compose(&self.mean), covariance: self.covariance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::Seed;
    use crate::geometry::{Se2, Se3, So3};
    use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
    use rand_distr::{Distribution, StandardNormal};

    fn vehicle() -> UncertainPose<Se2> {
        let covariance = Matrix3::new(4e-6, 1e-6, 0.0, 1e-6, 2e-6, 5e-7, 0.0, 5e-7, 1e-6);
        UncertainPose::new(Se2::new(3.0, -2.0, 2.5), covariance).unwrap()
    }

    fn motion() -> UncertainPose<Se2> {
        let covariance = Matrix3::new(1e-6, 0.0, 2e-7, 0.0, 3e-6, 0.0, 2e-7, 0.0, 2e-6);
        UncertainPose::new(Se2::new(1.0, 0.5, -0.7), covariance).unwrap()
    }

    #[test]
    fn covariances_match_sampled_ones() {
        // A sample variance has a relative sd of sqrt(2/n); entries are bounded by 6 sd of their own estimate.
        const COUNT: usize = 40_000;
        let (a, b) = (vehicle(), motion());
        let mut stream = Seed(4).stream(0, 0);
        let root = |p: &UncertainPose<Se2>| p.covariance().cholesky().unwrap().l();
        let (root_a, root_b) = (root(&a), root(&b));
        let mut sums = [Matrix3::zeros(); 3];
        let expected = [a.compose(&b), a.between(&b), a.inverse()];
        for _ in 0..COUNT {
            let mut draw = || Vector3::from_fn(|_, _| StandardNormal.sample(&mut stream));
            let (x, y) = (a.mean().plus(&(root_a * draw())), b.mean().plus(&(root_b * draw())));
            for (sum, (value, want)) in sums.iter_mut().zip([x * y, x.between(&y), x.inverse()].iter().zip(&expected)) {
                let error = value.minus(want.mean());
                *sum += error * error.transpose();
            }
        }
        for (sum, want) in sums.iter().zip(&expected) {
            let (sample, covariance) = (sum / COUNT as f64, want.covariance());
            for i in 0..3 {
                for j in 0..3 {
                    let sd =
                        ((covariance[(i, i)] * covariance[(j, j)] + covariance[(i, j)].powi(2)) / COUNT as f64).sqrt();
                    assert!((sample[(i, j)] - covariance[(i, j)]).abs() < 6.0 * sd, "{sample} {covariance}");
                }
            }
        }
    }

    #[test]
    fn deviations_keep_metres_and_radians_apart() {
        let entries = [4.0, 1.0, 2.0, 0.01, 0.04, 0.04];
        let spread = Matrix6::from_diagonal(&Vector6::from_row_slice(&entries));
        let pose = UncertainPose::new(Se3::default(), spread).unwrap();
        assert!((pose.position_deviation() - 7_f64.sqrt()).abs() < 1e-12);
        assert!((pose.rotation_deviation() - 0.3).abs() < 1e-12);
        assert!((vehicle().position_deviation() - 6e-6_f64.sqrt()).abs() < 1e-12);
        assert!((vehicle().rotation_deviation() - 1e-3).abs() < 1e-12);
        assert_eq!(UncertainPose::exact(Se2::default()).position_deviation(), 0.0);
    }

    #[test]
    fn a_correlated_between_undoes_a_composition() {
        // The end of a motion depends on its start: E[τ_start τ_endᵀ] = Σ_start Jᵀ.
        let (start, step) = (vehicle(), motion());
        let end = start.compose(&step);
        let (jacobian, _) = start.mean().compose_jacobians(step.mean());
        let recovered = start.between_correlated(&end, &(start.covariance() * jacobian.transpose())).unwrap();
        assert!((recovered.covariance() - step.covariance()).norm() < 1e-18);
        // And the start from the end and the motion: E[τ_end τ_stepᵀ] = Σ_step, so end ∘ step⁻¹ has the cross-covariance
        // with the inverse's increment -Ad τ_step.
        let cross = -step.covariance() * step.mean().adjoint().transpose();
        let back = end.compose_correlated(&step.inverse(), &cross).unwrap();
        assert!((back.covariance() - start.covariance()).norm() < 1e-18);
    }

    #[test]
    fn transports_go_there_and_back() {
        let covariance = Matrix6::from_diagonal(&Vector6::new(1.0, 2.0, 3.0, 0.1, 0.2, 0.3));
        let mean = Se3::from_parts(Vector3::new(1.0, 2.0, 3.0), So3::from_roll_pitch_yaw(0.1, -0.4, 2.0));
        let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 1.8), So3::from_roll_pitch_yaw(0.0, 0.2, -1.0));
        let base = UncertainPose::new(mean, covariance).unwrap();
        let sensor = base.transport_source(&mount);
        assert!((sensor.transport_source(&mount.inverse()).covariance() - covariance).norm() < 1e-12);
        // Left covariances do not care which frame of the body carries the pose.
        assert!((sensor.left_covariance() - base.left_covariance()).norm() < 1e-10);
        assert_eq!(base.transport_target(&mount).covariance(), base.covariance());
        assert!((base.inverse().inverse().covariance() - covariance).norm() < 1e-12);
    }

    #[cfg(feature = "serde")]
    #[test]
    fn storage_keeps_every_bit_and_is_checked() {
        let text = serde_json::to_string(&vehicle()).unwrap();
        assert_eq!(serde_json::from_str::<UncertainPose<Se2>>(&text).unwrap(), vehicle());
        let negative = text.replace("[4e-6", "[-4e-6");
        assert_ne!(negative, text);
        assert!(serde_json::from_str::<UncertainPose<Se2>>(&negative).is_err());
    }

    #[test]
    fn bad_input_is_named() {
        let unit = Matrix3::identity();
        assert!(matches!(UncertainPose::new(Se2::new(f64::NAN, 0.0, 0.0), unit), Err(Error::NotFinite { .. })));
        assert!(matches!(UncertainPose::new(Se2::default(), -unit), Err(Error::NotCovariance { .. })));
        let nan = unit * f64::NAN;
        assert!(matches!(vehicle().compose_correlated(&motion(), &nan), Err(Error::NotFinite { .. })));
        assert!(matches!(vehicle().between_correlated(&motion(), &unit), Err(Error::NotCovariance { .. })));
    }
}
