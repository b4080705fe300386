//! What all that change paths have in common: pieces without cusp or turn, and headings along new lines.

use agv_core::{
    Error,
    geometry::{Se2, So2},
    path::{Gear, Path, PathPoint},
};
use nalgebra::Vector2;

/// Index of the last point of the first piece that is driven in one gear and without a turn on the spot; none if no points are
/// left.
pub(super) fn piece_end(points: &[PathPoint]) -> Option<usize> {
    let gear = points.get(1).map(|point| point.gear);
    let is_turn = |pair: &[PathPoint]| pair[0].pose.translation() == pair[1].pose.translation();
    if points.windows(2).next().is_some_and(is_turn) {
        return Some(1);
    }
    let steps = points.windows(2).take_while(|pair| Some(pair[1].gear) == gear && !is_turn(pair));
    (!points.is_empty()).then(|| steps.count())
}

/// Appends a piece through new positions, of which the first and the last are those of the piece: its first point is in the path
/// already unless the path is empty, and its last pose stays as it is.
pub(super) fn write_piece(piece: &[PathPoint], positions: &[Vector2<f64>], path: &mut Path) -> Result<(), Error> {
    let (Some(first), Some(last)) = (piece.first(), piece.last()) else { return Ok(()) };
    if path.is_empty() {
        path.push(*first)?;
    }
    if piece.len() < 2 {
        return Ok(());
    }
    for pair in positions.get(1..).unwrap_or_default().windows(2) {
        // A repeated position says nothing, and has no heading.
        if let Some(heading) = heading(pair[0], pair[1], last.gear) {
            path.push(PathPoint { pose: Se2::from_parts(pair[0], heading), gear: last.gear })?;
        }
    }
    path.push(*last)
}

/// Heading of a vehicle on a straight line: along it, against it in reverse; none if the line has no length.
pub(super) fn heading(from: Vector2<f64>, to: Vector2<f64>, gear: Gear) -> Option<So2> {
    let sign = if gear == Gear::Reverse { -1.0 } else { 1.0 };
    let ahead = (to - from) * sign;
    (ahead != Vector2::zeros()).then(|| So2::from_direction(ahead.x, ahead.y))
}
