//! Can the vehicle drive this? Found out by means that the planner does not have.

use crate::site::{LENGTH, WIDTH};
use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{Cell, CellState, Footprint, Grid},
    nalgebra::Vector2,
    path::{Gear, Path},
};

/// What was found along a path.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Verdict {
    /// Stretches between two points on which the outline meets an obstacle.
    pub(crate) collisions: usize,
    /// Tightest turn, in 1/m.
    pub(crate) curvature: f64,
    /// Stretches that are driven against their gear, or longer than `gap` metres.
    pub(crate) faults: usize,
    pub(crate) cusps: usize,
}

/// Looks at ten poses between any two points.
pub(crate) fn check(map: &Grid<CellState>, footprint: &Footprint, path: &Path, gap: f64) -> Verdict {
    let rear = footprint.vertices().unwrap_or_default().iter().map(|v| v.x).fold(0.0, f64::min);
    let mut verdict = Verdict::default();
    let mut before: Option<Gear> = None;
    for pair in path.points().windows(2) {
        let step = pair[1].pose.minus(&pair[0].pose);
        let length = step.x.hypot(step.y);
        let poses = (0..=10).map(|i| pair[0].pose.plus(&(step * (f64::from(i) / 10.0))));
        verdict.collisions += usize::from(poses.into_iter().any(|pose| touches(map, &pose, rear)));
        if length < 1e-6 {
            continue;
        }
        verdict.curvature = verdict.curvature.max(step.z.abs() / length);
        let forward = if step.x > 0.0 { Gear::Forward } else { Gear::Reverse };
        verdict.faults += usize::from(forward != pair[1].gear || length > gap * (1.0 + 1e-6));
        verdict.cusps += usize::from(before.is_some_and(|gear| gear != pair[1].gear));
        before = Some(pair[1].gear);
    }
    verdict
}

/// Whether the rectangle and a cell that is not free have a point in common, by separating axes.
fn touches(map: &Grid<CellState>, pose: &Se2, rear: f64) -> bool {
    let layout = map.layout();
    let edge = layout.resolution();
    let grid_from_base = layout.map_from_grid().inverse() * *pose;
    let middle = grid_from_base * Vector2::new(rear + 0.5 * LENGTH, 0.0);
    let (cos, sin) = (grid_from_base.rotation().cos(), grid_from_base.rotation().sin());
    let (half_length, half_width) = (0.5 * LENGTH - 1e-9, 0.5 * WIDTH - 1e-9);
    let reach = half_length.hypot(half_width);
    let rows = |c: f64| ((c - reach) / edge).floor() as i32..=((c + reach) / edge).floor() as i32;
    rows(middle.y).any(|y| {
        rows(middle.x).any(|x| {
            if map.get(Cell::new(x, y)) == Some(&CellState::Free) {
                return false;
            }
            let d = Vector2::new((f64::from(x) + 0.5) * edge, (f64::from(y) + 0.5) * edge) - middle;
            let spread = 0.5 * edge * (cos.abs() + sin.abs());
            d.x.abs() <= 0.5 * edge + half_length * cos.abs() + half_width * sin.abs()
                && d.y.abs() <= 0.5 * edge + half_length * sin.abs() + half_width * cos.abs()
                && (d.x * cos + d.y * sin).abs() <= half_length + spread
                && (d.y * cos - d.x * sin).abs() <= half_width + spread
        })
    })
}
