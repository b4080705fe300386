//! Whether the straight lines of a path at any angle are free.

use super::planners::Algorithm;
use agv_nav::{
    core::{
        grid::{Cell, Costmap},
        path::Path,
    },
    nalgebra::Vector2,
    plan::smooth::LineOfSight,
};

/// By how much a line may enter a cell that it passes along an edge or a corner, in cells.
const ROUNDING: f64 = 1e-6;

/// Whether no line of the path enters what is blocked. Anya's lines may touch edges and corners, Theta*'s may not.
pub(crate) fn are_free(algorithm: Algorithm, costmap: &Costmap, path: &Path) -> bool {
    let sight = LineOfSight::default();
    path.points().windows(2).all(|pair| {
        let [from, to] = [0, 1].map(|end: usize| pair[end].pose.translation());
        match algorithm {
            Algorithm::AnyAngle => !enters(costmap, &from, &to),
            _ => sight.is_clear(costmap, &from, &to),
        }
    })
}

/// Whether a line goes through the inside of a blocked cell, or leaves the map.
fn enters(costmap: &Costmap, from: &Vector2<f64>, to: &Vector2<f64>) -> bool {
    let layout = costmap.layout();
    let (from, to) = (layout.to_grid(from), layout.to_grid(to));
    let (low, high) = (from.inf(&to), from.sup(&to));
    let rows = low.y.floor() as i32..=high.y.floor() as i32;
    let is_blocked =
        |x: i32, y: i32| layout.index(Cell::new(x, y)).is_none() || !costmap.is_traversable(Cell::new(x, y));
    rows.into_iter().any(|y| {
        // Part of the line within the row, and the columns that it is inside there.
        let Some((left, right)) = within(&from, &to, f64::from(y) + ROUNDING, f64::from(y) + 1.0 - ROUNDING) else {
            return false;
        };
        let columns = (left + ROUNDING).floor() as i32..=(right - ROUNDING).floor() as i32;
        // A line along a column of edges is inside neither of them.
        let is_edge = right - left < ROUNDING && (left - left.round()).abs() < ROUNDING;
        !is_edge && columns.into_iter().any(|x| is_blocked(x, y))
    })
}

/// Least and greatest x of a line between two heights; none if it does not come there.
fn within(from: &Vector2<f64>, to: &Vector2<f64>, bottom: f64, top: f64) -> Option<(f64, f64)> {
    let ahead = to - from;
    if from.y.max(to.y) < bottom || from.y.min(to.y) > top {
        return None;
    }
    let at = |y: f64| {
        let part = if ahead.y == 0.0 { 0.0 } else { ((y - from.y) / ahead.y).clamp(0.0, 1.0) };
        from.x + ahead.x * part
    };
    let (a, b) = if ahead.y == 0.0 { (from.x, to.x) } else { (at(bottom), at(top)) };
    Some((a.min(b), a.max(b)))
}
