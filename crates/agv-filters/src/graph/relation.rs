//! What is known of poses: how two lie to each other, or where one is.

use super::PoseId;
use agv_core::{Error, geometry::LieGroup, solve::RobustKernel};

/// A measurement of where one pose is, seen from another.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
pub struct Relation<G: LieGroup> {
    /// The pose that was looked from.
    pub from: PoseId,
    /// The pose that was looked at.
    pub to: PoseId,
    /// `to` in the frame of `from`, as it was measured.
    pub from_from_to: G,
    /// Information of the measurement, in the frame of `to`: the inverse of its covariance (1/m², 1/rad²). Directions that were
    /// not observed have none.
    pub information: G::Matrix,
    /// How its residual counts, in standard deviations: a robust kernel for relations that may be false.
    pub kernel: RobustKernel,
}

impl<G: LieGroup> Relation<G> {
    /// A relation that is no outlier.
    pub const fn new(from: PoseId, to: PoseId, from_from_to: G, information: G::Matrix) -> Self {
        Self { from, to, from_from_to, information, kernel: RobustKernel::Square }
    }

    /// The same relation under a robust kernel.
    #[must_use]
    pub const fn with_kernel(self, kernel: RobustKernel) -> Self {
        Self { kernel, ..self }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        check_measured::<G>(&self.from_from_to, &self.information, self.kernel)
    }
}

/// A measurement of where one pose is in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
pub struct Prior<G: LieGroup> {
    /// Which pose.
    pub pose: PoseId,
    /// Where it is, as it was measured.
    pub map_from_pose: G,
    /// Information of the measurement, in the frame of the pose (1/m², 1/rad²).
    pub information: G::Matrix,
    /// How its residual counts, in standard deviations.
    pub kernel: RobustKernel,
}

impl<G: LieGroup> Prior<G> {
    /// A prior that is no outlier.
    pub const fn new(pose: PoseId, map_from_pose: G, information: G::Matrix) -> Self {
        Self { pose, map_from_pose, information, kernel: RobustKernel::Square }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        check_measured::<G>(&self.map_from_pose, &self.information, self.kernel)
    }
}

fn check_measured<G: LieGroup>(pose: &G, information: &G::Matrix, kernel: RobustKernel) -> Result<(), Error> {
    if !pose.is_finite() {
        return Err(Error::NotFinite { name: "measured pose", value: f64::NAN });
    }
    // A semi-definite matrix in its own right: what is not observed has no information.
    G::check_covariance("information", information)?;
    kernel.checked().map(|_| ())
}

/// `log(measured⁻¹ ∘ predicted)`.
#[inline]
pub(super) fn residual<G: LieGroup>(measured: &G, predicted: &G) -> G::Tangent {
    measured.between(predicted).log()
}

/// `rᵀ Ω r`.
#[inline]
pub(super) fn squared<G: LieGroup>(residual: &G::Tangent, information: &G::Matrix) -> f64 {
    let weighted = *information * *residual;
    G::tangent_slice(residual).iter().zip(G::tangent_slice(&weighted)).map(|(a, b)| a * b).sum()
}
