//! What the end of a search is worth: its score, what it fixes, and whether it is a match at all.

use super::{CorrelativeParams, refine::Sums};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, unobserved_directions},
    roles::{Alignment, Termination},
};
use nalgebra::{Matrix3, Vector2};

/// Where a search ended.
pub(super) struct End {
    pub(super) pose: Se2,
    pub(super) termination: Termination,
    pub(super) iterations: usize,
    /// Sum over the points of how well each fits, from 0 to 1.
    pub(super) score: f64,
    pub(super) inliers: usize,
}

/// The result of a search that began at `guess`: too few inliers, or too small a share of them, are no match; `lines` are the sums over
/// the points at its end, of which the information is made.
pub(super) fn verdict(
    end: &End,
    lines: &Sums,
    points: &[Vector2<f64>],
    guess: &Se2,
    params: &CorrelativeParams,
) -> Result<Alignment<Se2>, Error> {
    let mut result = Alignment::unknown(*guess, Termination::TooFewPoints);
    result.iterations = end.iterations;
    result.score = end.score / points.len() as f64;
    result.inlier_ratio = end.inliers as f64 / points.len() as f64;
    if end.inliers < params.min_points || result.inlier_ratio < params.min_inlier_ratio || !end.pose.is_finite() {
        return Ok(result);
    }
    result.termination = end.termination;
    result.information = lines.information(points, params);
    result.unobserved = unobserved_directions::<Se2>(&result.information, params.observable)?;
    result.target_from_source = held(&end.pose, guess, &result.unobserved);
    Ok(result)
}

/// A pose that stays where it was guessed along the directions that are not observed.
pub(super) fn held(found: &Se2, guess: &Se2, unobserved: &Matrix3<f64>) -> Se2 {
    found.plus(&(unobserved * found.between(guess).log()))
}
