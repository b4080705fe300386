//! Loop closures: where to look for a key scan among older ones, and which finds to believe.

use super::{
    GraphSlamParams,
    key_scan::{KeyScan, gather},
};
use crate::matching::{CorrelativeMatcher, SearchWindow};
use agv_core::{
    compute::Par,
    geometry::{LieGroup, PoseSigma, Se2, angle_difference, observed_information},
    roles::{Alignment, AlignmentError},
};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Where a key scan was found among older ones.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Closure {
    pub(super) from: u32,
    pub(super) to: u32,
    pub(super) from_from_to: Se2,
    pub(super) information: Matrix3<f64>,
}

/// Distance that half a turn of heading counts as, in metres, when the nearest key scan of a group is chosen: those that looked the
/// same way have seen the same walls.
const HEADING_WORTH: f64 = 2.0;

/// Key scans that a group may lack in between.
const GAP: usize = 4;

/// How far apart two places may be that see the same walls, in metres, beyond the window.
const OVERLAP: f64 = 3.0;

/// Groups of older key scans near the last one: of each the nearest, nearest group first.
pub(super) fn candidates(
    keys: &[KeyScan],
    poses: &[Se2],
    window: &SearchWindow,
    params: &GraphSlamParams,
) -> Vec<usize> {
    let (Some(last), Some(here)) = (keys.last(), poses.last()) else { return Vec::new() };
    let mut nearest: Vec<(f64, usize)> = Vec::new();
    let mut previous = None;
    for (index, (key, pose)) in keys.iter().zip(poses).enumerate() {
        let off = (pose.translation() - here.translation()).norm();
        let is_old = key.drive != last.drive || last.path - key.path >= params.closure.min_path;
        if !is_old || off > window.distance + OVERLAP {
            continue;
        }
        let turned = angle_difference(pose.yaw(), here.yaw()).abs() / std::f64::consts::PI;
        let off = off + HEADING_WORTH * turned;
        let is_new_group = previous.is_none_or(|previous| index - previous > GAP);
        match nearest.last_mut() {
            Some(best) if !is_new_group => {
                if off < best.0 {
                    *best = (off, index);
                }
            }
            _ => nearest.push((off, index)),
        }
        previous = Some(index);
    }
    nearest.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    nearest.truncate(params.closure.candidates);
    nearest.into_iter().map(|(_, index)| index).collect()
}

/// Looks for `points` around a key scan; the pose in its frame.
pub(super) fn look_around(
    keys: &[KeyScan],
    poses: &[Se2],
    anchor: usize,
    points: &[Vector2<f64>],
    map_from_base: &Se2,
    window: SearchWindow,
    params: &GraphSlamParams,
) -> Result<Option<Alignment<Se2>>, AlignmentError> {
    let reach = params.closure.neighbours;
    let drive = keys[anchor].drive;
    let around = anchor.saturating_sub(reach)..(anchor + reach + 1).min(keys.len());
    let group = keys[around.clone()].iter().zip(&poses[around]).filter(|(key, _)| key.drive == drive);
    let mut target = Vec::new();
    gather(group, &poses[anchor], &mut target);
    let mut matcher = CorrelativeMatcher::new(params.matcher)?;
    if matcher.set_points(&target).is_err() {
        return Ok(None);
    }
    let found = matcher.match_points(points, &poses[anchor].between(map_from_base), window, 0.0)?;
    let believed = found.converged()
        && found.inlier_ratio >= params.closure.min_inlier_ratio
        && found.score >= params.closure.min_score
        && found.unobserved.trace() < 1.5;
    Ok(believed.then_some(found))
}

/// All closures of the last key scan.
pub(super) fn find(
    keys: &[KeyScan],
    poses: &[Se2],
    window: SearchWindow,
    params: &GraphSlamParams,
    par: Par,
) -> Result<Vec<Closure>, AlignmentError> {
    let anchors = candidates(keys, poses, &window, params);
    let (Some(last), Some(here)) = (keys.last(), poses.last()) else { return Ok(Vec::new()) };
    let look = |i: usize| -> Result<Vec<Closure>, AlignmentError> {
        let found = look_around(keys, poses, anchors[i], &last.points, here, window, params)?;
        Ok(found
            .and_then(|found| {
                Some(Closure {
                    from: anchors[i] as u32,
                    to: keys.len() as u32 - 1,
                    from_from_to: found.target_from_source,
                    information: seen_information(&found, params)?,
                })
            })
            .into_iter()
            .collect())
    };
    let both = |a: Result<Vec<Closure>, AlignmentError>, b: Result<Vec<Closure>, AlignmentError>| {
        let (mut a, b) = (a?, b?);
        a.extend(b);
        Ok(a)
    };
    par.map_reduce(anchors.len(), look, both).unwrap_or_else(|| Ok(Vec::new()))
}

/// What a match is worth to the graph where nothing else ties its poses: the information of its points is that of independent beams and
/// a perfect target, and what they do not see is bounded.
pub(super) fn matched_information(found: &Alignment<Se2>, params: &GraphSlamParams) -> Option<Matrix3<f64>> {
    let covariance = found.covariance(params.matcher.observable).ok()?;
    let floor = params.match_floor;
    let variances = Vector3::new(floor.translation, floor.translation, floor.rotation).map(|sigma| sigma * sigma);
    let inverse = (covariance + Matrix3::from_diagonal(&variances)).cholesky()?.inverse();
    Some((inverse + inverse.transpose()) * 0.5)
}

/// Information along a direction that was not observed: none to speak of (a hundred metres), so that rounding leaves no negative one.
const NEXT_TO_NONE: f64 = 1e-4;

/// As [`matched_information`], without the directions that the match does not see: along these it is held where it was guessed, and a
/// guess that is told as a measurement again and again would become certain.
pub(super) fn seen_information(found: &Alignment<Se2>, params: &GraphSlamParams) -> Option<Matrix3<f64>> {
    let information = matched_information(found, params)?;
    Some(observed_information::<Se2>(&information, &found.unobserved) + found.unobserved * NEXT_TO_NONE)
}

/// Where the last key scan would be if a closure were right.
pub(super) fn claimed(closure: &Closure, poses: &[Se2]) -> Option<Se2> {
    let (from, to) = (poses.get(closure.from as usize)?, poses.get(closure.to as usize)?);
    Some(from.compose(&closure.from_from_to).compose(&to.between(poses.last()?)))
}

/// Whether two poses are as near as that.
pub(super) fn agree(a: &Se2, b: &Se2, limit: PoseSigma) -> bool {
    let off = a.between(b);
    off.translation().norm() <= limit.translation && off.yaw().abs() <= limit.rotation
}
