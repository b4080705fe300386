//! What surfaces some points are on: a line through the neighbours of each.

use super::{
    line::LineSums,
    params::CorrelativeParams,
    squares::{Square, Squares},
};
use nalgebra::Vector2;

/// The points, moved onto the lines through their neighbours, which hold less noise than they do; the normals of these lines, and the
/// variances of their directions.
pub(super) fn surfaces(
    points: &[Vector2<f64>],
    params: &CorrelativeParams,
) -> (Vec<Vector2<f64>>, Vec<Vector2<f64>>, Vec<f64>) {
    let radius = params.normal_radius;
    let mut buckets: Squares =
        (0..).zip(points).map(|(i, point)| (Square::holding(&point.yx(), radius).key(), i)).collect();
    buckets.sort_unstable();
    // Side by side as they are read.
    let ordered: Vec<Vector2<f64>> = buckets.iter().map(|bucket| points[bucket.1 as usize]).collect();
    let mut found = vec![(Vector2::zeros(), Vector2::zeros(), 0.0); points.len()];
    for same in buckets.chunk_by(|a, b| a.0 == b.0) {
        // Three rows of three buckets each are the neighbours of all points of one; rows come first.
        let Square(row, column) = Square::holding(&points[same[0].1 as usize].yx(), radius);
        let rows = [row.saturating_sub(1), row, row.saturating_add(1)].map(|row| {
            let first = Square(row, column.saturating_sub(1)).key();
            let last = Square(row, column.saturating_add(1)).key();
            let start = buckets.partition_point(|b| b.0 < first);
            let length = buckets[start..].partition_point(|b| b.0 <= last);
            &ordered[start..start + length]
        });
        for &(_, index) in same {
            found[index as usize] = surface(&points[index as usize], rows, params);
        }
    }
    let (mut moved, mut normals, mut doubts) = (Vec::new(), Vec::new(), Vec::new());
    for (point, normal, doubt) in found {
        moved.push(point);
        normals.push(normal);
        doubts.push(doubt);
    }
    (moved, normals, doubts)
}

/// The surface at a point: of its neighbours among these.
fn surface(
    point: &Vector2<f64>,
    rows: [&[Vector2<f64>]; 3],
    params: &CorrelativeParams,
) -> (Vector2<f64>, Vector2<f64>, f64) {
    let radius = params.normal_radius;
    let mut sums = LineSums::default();
    for offset in rows.into_iter().flatten().map(|other| other - point) {
        sums.add_if(offset.norm_squared() <= radius * radius, &offset);
    }
    let Some(line) = sums.line() else { return (*point, Vector2::zeros(), 0.0) };
    // Of a line through points that are that far across it, and spread that far along it.
    let across = line.across.max(params.range_sigma * params.range_sigma);
    (point + line.normal * line.normal.dot(&line.mean), line.normal, across / (line.count * line.along))
}
