//! Ways around obstacles: which there are beside the path, and whether two are the same.
//!
//! Two ways are the same if one can be bent into the other along straight lines between points that are as far along on both, none
//! of which crosses an obstacle: visibility deformation (Jaillet and Siméon 2008), asked with the same parameter on both as in
//! Zhou et al. 2020. It is stricter than homotopy, so no two ways of different classes are ever taken for one; and unlike an
//! H-signature it needs no representative point for every obstacle: the field of distances knows them all.

use super::{band::Band, line::Ground};
use agv_core::grid::LocalMap;
use nalgebra::Vector2;

/// A point of the path ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    pub(super) position: Vector2<f64>,
    /// Heading of the base.
    pub(super) yaw: f64,
    /// Direction of travel.
    pub(super) direction: f64,
}

/// Steps of the search to the side, in metres.
const STEP: f64 = 0.1;
/// How fast a detour leaves the path: metres to the side per metre ahead.
const SLOPE: f64 = 1.0;

/// How far to a side each sample must be moved so that nothing blocks the way; false if there is no room within the reach, or
/// nothing blocks it.
pub(super) fn detour(samples: &[Sample], ground: &Ground<'_>, side: f64, spacing: f64, offsets: &mut Vec<f64>) -> bool {
    offsets.clear();
    offsets.resize(samples.len(), 0.0);
    let wanted = 0.5 * ground.params.clearance;
    let clearance = |sample: &Sample, offset: f64| {
        let across = Vector2::new(-sample.direction.sin(), sample.direction.cos()) * (side * offset);
        let at = sample.position + across;
        ground.clearance([at.x, at.y, sample.yaw]).unwrap_or(f64::NEG_INFINITY)
    };
    let mut blocked = false;
    for (offset, sample) in offsets.iter_mut().zip(samples).skip(1) {
        if clearance(sample, 0.0) > 0.0 {
            continue;
        }
        blocked = true;
        let steps = (ground.params.max_detour / STEP) as usize;
        let Some(free) = (1..=steps).map(|i| STEP * i as f64).find(|&o| clearance(sample, o) > wanted) else {
            return false;
        };
        *offset = free;
    }
    if !blocked {
        return false;
    }
    // Not all at once: forward and backward, so that the greatest has its ramps.
    let ramp = SLOPE * spacing;
    for i in 1..offsets.len() {
        offsets[i] = offsets[i].max(offsets[i - 1] - ramp);
    }
    for i in (1..offsets.len()).rev() {
        offsets[i - 1] = offsets[i - 1].max(offsets[i] - ramp);
    }
    if let Some(first) = offsets.first_mut() {
        *first = 0.0;
    }
    true
}

/// Lines between two bands that are looked along.
const LINES: usize = 20;

/// Whether one band can be bent into the other without crossing an obstacle.
pub(super) fn same_way(map: &LocalMap, a: &Band, b: &Band) -> bool {
    (1..LINES).all(|i| {
        let share = i as f64 / LINES as f64;
        point_at(a, share).zip(point_at(b, share)).is_none_or(|(a, b)| is_clear(map, a, b))
    })
}

/// The point at a share of a band's poses.
fn point_at(band: &Band, share: f64) -> Option<Vector2<f64>> {
    let nodes = band.nodes();
    let place = share * nodes.len().checked_sub(1)? as f64;
    let i = place as usize;
    let (a, b) = (nodes.get(i)?, nodes.get(i + 1).or(nodes.get(i))?);
    let share = place - i as f64;
    Some(Vector2::new(a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])))
}

/// Whether a straight line crosses no blocked cell, by steps as long as the distance to the nearest.
fn is_clear(map: &LocalMap, a: Vector2<f64>, b: Vector2<f64>) -> bool {
    let resolution = map.layout().resolution();
    let line = b - a;
    let length = line.norm();
    let mut along = 0.0;
    while along <= length {
        let point = a + line * if length > 0.0 { along / length } else { 0.0 };
        let Some((distance, _)) = map.distance_at(&point) else { return true };
        if distance < 0.75 * resolution {
            return false;
        }
        along += (distance - 0.75 * resolution).max(0.5 * resolution);
    }
    true
}
