//! Loop closures: where to look for a key scan among older ones, and which finds to believe.

use super::{
    GraphSlamParams,
    key_scan::{KeyScan, apart, gather},
};
use crate::matching::{CorrelativeMatcher, CorrelativeParams, SearchWindow, Squares, room_of, thin_into};
use agv_core::{
    Error,
    compute::Par,
    geometry::{LieGroup, PoseSigma, Se2, observed_information},
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
        let off = apart(pose, here);
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

/// Cells of closures beside those of the front end: the search goes by cells, but what it finds is refined on points and lines.
const COARSER: f64 = 2.0;

/// Least score of a search, cell by cell, beside that of the refined pose that is asked for: a cell off, and turned by as much as a cell at
/// the farthest point, a perfect fit still scores seven tenths of what it does in place.
const CELL_BY_CELL: f64 = 0.6;

/// How closures are matched: on wider cells, as far as `sigma` covers them.
fn coarse(params: &GraphSlamParams) -> CorrelativeParams {
    let CorrelativeParams { resolution, sigma, .. } = params.matcher;
    CorrelativeParams { resolution: resolution.max(sigma.min(COARSER * resolution)), ..params.matcher }
}

/// What looks for a scan, and its memory.
#[derive(Debug)]
pub(super) struct Seeker {
    matcher: CorrelativeMatcher,
    target: Vec<Vector2<f64>>,
    squares: Squares,
    points: Vec<Vector2<f64>>,
}

impl Seeker {
    pub(super) fn new(params: &GraphSlamParams) -> Result<Self, Error> {
        let matcher = CorrelativeMatcher::new(coarse(params))?;
        Ok(Self { matcher, target: Vec::new(), squares: Squares::new(), points: Vec::new() })
    }

    /// Bytes of its memory.
    pub(super) fn memory(&self) -> usize {
        self.matcher.memory() + room_of(&self.target) + room_of(&self.points) + room_of(&self.squares)
    }
}

/// Key scans, and where they are.
#[derive(Clone, Copy)]
pub(super) struct Keys<'a> {
    pub(super) scans: &'a [KeyScan],
    pub(super) poses: &'a [Se2],
}

/// Looks for `points` around a key scan, from where the base is taken to be; the pose in the key scan's frame.
pub(super) fn look_around(
    Keys { scans: keys, poses }: Keys<'_>,
    anchor: usize,
    points: &[Vector2<f64>],
    map_from_base: &Se2,
    window: SearchWindow,
    params: &GraphSlamParams,
    seeker: &mut Seeker,
) -> Result<Option<Alignment<Se2>>, AlignmentError> {
    let reach = params.closure.neighbours;
    let drive = keys[anchor].drive;
    let around = anchor.saturating_sub(reach)..(anchor + reach + 1).min(keys.len());
    let group = keys[around.clone()].iter().zip(&poses[around]).filter(|(key, _)| key.drive == drive);
    let Seeker { matcher, target, squares, points: sparse } = seeker;
    gather(group, &poses[anchor], target);
    if matcher.set_points(target).is_err() {
        return Ok(None);
    }
    thin_into(points.iter().copied(), matcher.params().resolution, squares, sparse);
    let floor = CELL_BY_CELL * params.closure.min_score;
    let found = matcher.match_points(sparse, &poses[anchor].between(map_from_base), window, floor)?;
    let believed = found.converged()
        && found.inlier_ratio >= params.closure.min_inlier_ratio
        && found.score >= params.closure.min_score
        && found.unobserved.trace() < 1.5;
    Ok(believed.then_some(found))
}

/// All closures of the last key scan.
pub(super) fn find(
    keys: Keys<'_>,
    window: SearchWindow,
    params: &GraphSlamParams,
    seekers: &mut Vec<Seeker>,
    par: Par,
) -> Result<Vec<Closure>, AlignmentError> {
    let anchors = candidates(keys.scans, keys.poses, &window, params);
    let (Some(last), Some(here)) = (keys.scans.last(), keys.poses.last()) else { return Ok(Vec::new()) };
    while seekers.len() < anchors.len() {
        seekers.push(Seeker::new(params)?);
    }
    let look = |i: usize, seekers: &mut [Seeker]| -> Result<Vec<Closure>, AlignmentError> {
        let Some(seeker) = seekers.first_mut() else { return Ok(Vec::new()) };
        let found = look_around(keys, anchors[i], &last.points, here, window, params, seeker)?;
        Ok(found
            .and_then(|found| {
                Some(Closure {
                    from: anchors[i] as u32,
                    to: keys.scans.len() as u32 - 1,
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
    let seekers = &mut seekers[..anchors.len()];
    par.map_reduce_chunks(seekers, 1, look, both).unwrap_or_else(|| Ok(Vec::new()))
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
