//! Where was this scan taken, given a map and a guess.

use crate::{Error, geometry::Se2, sensors::LaserScan};
use nalgebra::{Matrix3, Vector3};

/// Where a scan fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanMatch {
    /// Best pose of the vehicle in the reference frame of the matcher.
    pub map_from_base: Se2,
    /// Covariance of the right increment, in the base frame; large along directions that the scan does not see.
    pub covariance: Matrix3<f64>,
    /// Quality from 0 (no reading explained) to 1 (all explained).
    pub score: f64,
    /// Iterations or candidates that were evaluated.
    pub iterations: usize,
    /// Whether the result can be trusted: the search ended by itself, with enough readings explained.
    pub converged: bool,
    /// Unit tangent, in the base frame, along which the scan does not fix the pose (a long corridor); none if it is
    /// fixed in all directions.
    pub unobserved: Option<Vector3<f64>>,
}

/// Why a matcher refused a call.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScanMatchError {
    /// There is nothing to match against yet.
    #[error("the scan matcher has no reference yet")]
    NoReference,
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Matches scans against a reference that it holds: a map, a sub-map, or the previous scan.
///
/// A scan without usable readings gives `converged: false` at the guess, not an error.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::roles::{ScanMatch, ScanMatchError, ScanMatcher};
/// use agv_core::sensors::LaserScan;
///
/// /// Trusts the guess: what a matcher is measured against.
/// struct NoMatcher;
///
/// impl ScanMatcher for NoMatcher {
///     fn match_scan(&mut self, _: &LaserScan, guess: &Se2) -> Result<ScanMatch, ScanMatchError> {
///         let (covariance, score) = (Matrix3::identity(), 0.0);
///         Ok(ScanMatch { map_from_base: *guess, covariance, score, iterations: 0, converged: false, unobserved: None })
///     }
/// }
/// ```
pub trait ScanMatcher {
    /// Best pose near `guess`.
    ///
    /// # Errors
    /// [`ScanMatchError::NoReference`], or a guess that is not finite.
    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<ScanMatch, ScanMatchError>;
}
