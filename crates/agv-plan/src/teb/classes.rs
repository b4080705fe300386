//! Ways around obstacles: which there are beside the path, and whether two are the same.
//!
//! Two ways are the same if one can be bent into the other along straight lines between points that are as far along on both, none
//! of which crosses an obstacle: visibility deformation (Jaillet and Siméon 2008), asked with the same parameter on both as in
//! Zhou et al. 2020. It is stricter than homotopy, and the lines are at most a cell apart on either way, so that no obstacle fits
//! between them: no two ways of different classes are taken for one (up to a thousand cells of length, beyond which the lines are
//! farther apart). Unlike an H-signature it needs no representative point for every obstacle: the field of distances knows them all.

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

/// Most lines between two bands that are looked along.
const MOST_LINES: f64 = 1000.0;

/// Whether one band can be bent into the other without crossing an obstacle.
pub(super) fn same_way(map: &LocalMap, a: &Band, b: &Band) -> bool {
    let (mut a, mut b) = (Walk::new(a), Walk::new(b));
    let lines = (a.length.max(b.length) / map.layout().resolution()).ceil().clamp(2.0, MOST_LINES);
    (1..lines as usize).all(|i| {
        let share = i as f64 / lines;
        a.to(share).zip(b.to(share)).is_none_or(|(a, b)| is_clear(map, a, b))
    })
}

/// A walk along a band, forward only.
struct Walk<'a> {
    nodes: &'a [[f64; 4]],
    length: f64,
    /// Arc length at the first node that is left.
    passed: f64,
}

impl<'a> Walk<'a> {
    fn new(band: &'a Band) -> Self {
        Self { nodes: band.nodes(), length: band.length(), passed: 0.0 }
    }

    /// The point at a share of the length, no smaller than the one before.
    fn to(&mut self, share: f64) -> Option<Vector2<f64>> {
        let place = share * self.length;
        loop {
            let [a, rest @ ..] = self.nodes else { return None };
            let (a, Some(b)) = (Vector2::new(a[0], a[1]), rest.first().map(|b| Vector2::new(b[0], b[1]))) else {
                return Some(Vector2::new(a[0], a[1]));
            };
            let length = (b - a).norm();
            if self.passed + length < place {
                (self.nodes, self.passed) = (rest, self.passed + length);
                continue;
            }
            let share = if length > 0.0 { (place - self.passed) / length } else { 0.0 };
            return Some(a + (b - a) * share);
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        geometry::Se2,
        grid::{Cell, CellState, Costmap, Grid, GridLayout, LocalMapParams, cost},
    };

    /// A way of 4 m with a bow to a side, with poses a step apart.
    fn bow(side: f64, step: f64) -> Band {
        let mut band = Band::new();
        for i in 0..=(4.0 / step).round() as usize {
            let x = step * i as f64;
            band.push(Vector2::new(0.5 + x, 1.5 + side * (x * std::f64::consts::FRAC_PI_4).sin()), 0.0, 0.1);
        }
        band
    }

    /// Wherever the post is along the way, which is one cell thick.
    #[test]
    fn a_post_of_one_cell_keeps_ways_apart() {
        let layout = GridLayout::new(100, 60, 0.05, Se2::default()).unwrap();
        let clear = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        let map = LocalMap::new(&clear, LocalMapParams::default()).unwrap();
        assert!(same_way(&map, &bow(0.6, 0.1), &bow(-0.6, 0.16)));
        for column in 20..80 {
            let mut costmap = clear.clone();
            costmap.set(Cell::new(column, 30), cost::LETHAL);
            let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
            assert!(!same_way(&map, &bow(0.6, 0.1), &bow(-0.6, 0.16)), "{column}");
            assert!(same_way(&map, &bow(0.6, 0.1), &bow(0.8, 0.16)), "{column}");
        }
    }
}
