//! Where was this scan taken, given other scans or a map, and a guess.

use super::{Alignment, AlignmentError};
use crate::{geometry::Se2, sensors::LaserScan};

/// A scan whose pose is known: a part of what others are matched against.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetScan<'a> {
    /// Pose of the vehicle, when the scan was taken, in the frame that poses are sought in.
    pub target_from_base: Se2,
    /// The scan.
    pub scan: &'a LaserScan,
}

/// Matches scans against a target that it holds: the previous scan, a sub-map of several, or a map that it was built with.
///
/// The source of the [`Alignment`] is the base frame: scans know where their laser sits. A scan without usable readings
/// gives [`Alignment::unknown`] at the guess with [`Termination::TooFewPoints`](super::Termination::TooFewPoints), not an
/// error.
///
/// ```
/// use agv_core::{
///     geometry::Se2,
///     roles::{AlignmentError, ScanMatcher, TargetScan},
///     sensors::LaserScan,
/// };
///
/// /// The vehicle's motion between two scans, by any matcher; none if they do not match.
/// fn motion(
///     matcher: &mut dyn ScanMatcher, first: &LaserScan, second: &LaserScan, guess: &Se2,
/// ) -> Result<Option<Se2>, AlignmentError> {
///     matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: first }])?;
///     let found = matcher.match_scan(second, guess)?;
///     Ok(found.converged().then_some(found.target_from_source))
/// }
/// ```
pub trait ScanMatcher {
    /// Replaces the target by scans at known poses.
    ///
    /// # Errors
    /// [`Error::Empty`](crate::Error::Empty) or [`Error::TooFew`](crate::Error::TooFew) for scans without enough usable
    /// readings, or a pose that is not finite; the last target is then still there.
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError>;

    /// Best pose of the base near `guess` (target from base).
    ///
    /// # Errors
    /// [`AlignmentError::NoTarget`], or a guess that is not finite.
    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError>;
}
