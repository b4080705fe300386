//! How a source (a scan, a cloud) fits a target: what matchers of scans and of clouds have in common.

use crate::{
    Error,
    geometry::{LieGroup, PoseSigma, bounded_covariance, observed_information},
};

/// Why a search for a pose ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Termination {
    /// It found what it was looking for: the last step was below the tolerance, or every candidate was tried.
    Converged,
    /// The iteration limit was reached.
    IterationLimit,
    /// No step improved the score any more, though the gradient has not vanished.
    Stalled,
    /// Too few points met the target to say anything.
    TooFewPoints,
    /// The points leave directions free, and nothing was there to hold them.
    Degenerate,
    /// The search came to rest, but the target explains too little of the source: most likely a false optimum.
    PoorFit,
}

/// How a source fits a target, in the plane ([`Se2`](crate::geometry::Se2)) or in space ([`Se3`](crate::geometry::Se3)).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
#[non_exhaustive]
pub struct Alignment<G: LieGroup> {
    /// Pose of the source in the target frame.
    pub target_from_source: G,
    /// Information (inverse covariance) of the right increment, that is in the source frame, translation first; singular
    /// where the pose is not observed.
    pub information: G::Matrix,
    /// Projector onto the tangents along which the source does not fix the pose, as a long corridor does not; zero if it
    /// fixes all ([`unobserved_directions`](crate::geometry::unobserved_directions)).
    pub unobserved: G::Matrix,
    /// The method's own score of the result; larger is better.
    pub score: f64,
    /// Share of the usable points of the source that the target explains, from 0 to 1.
    pub inlier_ratio: f64,
    /// Iterations or candidates that were evaluated.
    pub iterations: usize,
    /// Why it ended; anything but [`Termination::Converged`] is a result not to rely on.
    pub termination: Termination,
}

impl<G: LieGroup> Alignment<G> {
    /// What a search amounts to that has learnt nothing: the guess, without information. The start for every player's
    /// result, and all of it for a source without usable points.
    pub fn unknown(guess: G, termination: Termination) -> Self {
        Self {
            target_from_source: guess,
            information: G::identity_matrix() * 0.0,
            unobserved: G::identity_matrix(),
            score: 0.0,
            inlier_ratio: 0.0,
            iterations: 0,
            termination,
        }
    }

    /// Whether the search ended by itself.
    pub const fn converged(&self) -> bool {
        matches!(self.termination, Termination::Converged)
    }

    /// The information without what it says along unobserved directions: what a pose graph should weigh this with.
    pub fn observed_information(&self) -> G::Matrix {
        observed_information::<G>(&self.information, &self.unobserved)
    }

    /// Covariance of the right increment, with `sigma` along the unobserved directions, where it is the caller's word and
    /// not a measurement's: see [`bounded_covariance`].
    ///
    /// ```
    /// use agv_core::geometry::{PoseSigma, Se2};
    /// use agv_core::roles::{Alignment, Termination};
    ///
    /// let lost = Alignment::unknown(Se2::default(), Termination::TooFewPoints);
    /// let covariance = lost.covariance(PoseSigma { translation: 5.0, rotation: 1.0 })?;
    /// assert!((covariance[(0, 0)] - 25.0).abs() < 1e-12);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::NotPositive`] for `sigma`; [`Error::NotFinite`] or [`Error::NotCovariance`] for a player's information that
    /// is none.
    pub fn covariance(&self, sigma: PoseSigma) -> Result<G::Matrix, Error> {
        bounded_covariance::<G>(&self.observed_information(), sigma)
    }
}

/// Why a matcher of scans or clouds refused a call.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AlignmentError {
    /// There is nothing to align with yet.
    #[error("there is no target yet: call `set_target` first")]
    NoTarget,
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}
