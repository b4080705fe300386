//! Scans that are kept, and targets made of several of them.

use super::GraphSlamParams;
use crate::matching::{Squares, thin_into};
use agv_core::{
    geometry::{LieGroup, Se2, angle_difference},
    sensors::{Beam, LaserScan},
};
use nalgebra::Vector2;

/// A scan that is a pose of the graph.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct KeyScan {
    pub(super) scan: LaserScan,
    /// End points in the base frame, thinned; they follow from the scan.
    pub(super) points: Vec<Vector2<f64>>,
    /// Way until here, in metres.
    pub(super) path: f64,
    /// Which of the drives that the map was made in it belongs to.
    pub(super) drive: u32,
}

impl KeyScan {
    pub(super) fn new(scan: LaserScan, path: f64, drive: u32, params: &GraphSlamParams) -> Self {
        let mut points = Vec::new();
        usable_points_into(&scan, params, &mut Squares::new(), &mut points);
        Self::with_points(scan, &points, path, drive)
    }

    /// A scan whose usable points are known.
    pub(super) fn with_points(scan: LaserScan, points: &[Vector2<f64>], path: f64, drive: u32) -> Self {
        Self { scan, points: points.to_vec(), path, drive }
    }
}

/// End points of a scan in the base frame, near enough, and thinned to the matcher's resolution.
pub(super) fn usable_points_into(
    scan: &LaserScan,
    params: &GraphSlamParams,
    squares: &mut Squares,
    points: &mut Vec<Vector2<f64>>,
) {
    let origin = scan.geometry().base_from_sensor.translation();
    let near = scan.points_in_base().filter(|point| (point - origin).norm_squared() <= params.max_range.powi(2));
    thin_into(near, params.matcher.resolution, squares, points);
}

/// Standard deviation of the ranges of a scan, in metres, by the bends between neighbouring beams: most of them are on one surface.
pub(super) fn noise(scan: &LaserScan) -> f64 {
    let hit = |beam: Beam| match beam {
        Beam::Hit(range) => Some(range),
        _ => None,
    };
    let ranges: Vec<Option<f64>> = scan.beams().map(|(_, beam)| hit(beam)).collect();
    let bend = |three: &[Option<f64>]| match three {
        [Some(a), Some(b), Some(c)] => Some((a - 2.0 * b + c).abs()),
        _ => None,
    };
    let mut bends: Vec<f64> = ranges.windows(3).filter_map(bend).collect();
    let middle = bends.len() / 2;
    if middle < 10 {
        return 0.0;
    }
    // Of a normal deviate: the variance of a bend is six times that of a range, and its median 0.6745 deviations.
    *bends.select_nth_unstable_by(middle, f64::total_cmp).1 / (6.0_f64.sqrt() * 0.6745)
}

/// The points of some key scans in the frame of one of them.
pub(super) fn gather<'a>(
    keys: impl Iterator<Item = (&'a KeyScan, &'a Se2)>,
    map_from_anchor: &Se2,
    points: &mut Vec<Vector2<f64>>,
) {
    points.clear();
    for (key, map_from_key) in keys {
        let anchor_from_key = map_from_anchor.between(map_from_key);
        points.extend(key.points.iter().map(|point| anchor_from_key.act(point)));
    }
}

/// Distance that half a turn counts as, in metres, where key scans are chosen that see what is seen from a pose: those that looked the
/// same way have seen the same walls.
const HEADING_WORTH: f64 = 2.0;

/// How far apart two poses are, by what is seen from them, in metres.
pub(super) fn apart(a: &Se2, b: &Se2) -> f64 {
    let turned = angle_difference(a.yaw(), b.yaw()).abs() / std::f64::consts::PI;
    (a.translation() - b.translation()).norm() + HEADING_WORTH * turned
}
