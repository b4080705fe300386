//! The cells that an outline touches, row by row.

use super::{Footprint, Shape};
use crate::{
    geometry::{Se2, outline::edges},
    grid::GridLayout,
};
use nalgebra::Vector2;

impl Footprint {
    /// Calls `hit(row, first, last)` for runs of cells that the footprint, grown by `margin` cells, touches, until
    /// it says true; says whether it did. Runs may overlap, and lie outside the grid.
    ///
    /// Every cell with a point of the grown footprint is visited; the margin reaches as far along the diagonals as a
    /// square of that half width.
    pub(in crate::grid) fn any_run(
        &self,
        layout: &GridLayout,
        map_from_base: &Se2,
        margin: f64,
        mut hit: impl FnMut(i32, i32, i32) -> bool,
    ) -> bool {
        // A hair against rounding: a point on a line between cells touches both.
        let margin = margin + 1e-9;
        match &self.shape {
            Shape::Point | Shape::Circle(_) | Shape::TwoCircles(_) => self.circles().any(|(x, radius)| {
                let center = layout.to_grid(&(*map_from_base * Vector2::new(x, 0.0)));
                any_run_of_circle(&center, radius / layout.resolution(), margin, &mut hit)
            }),
            Shape::Segment(ends) => {
                let ends = ends.map(|end| layout.to_grid(&(*map_from_base * end)));
                any_run_of_polygon(&ends, true, margin, hit)
            }
            Shape::Polygon(own) => {
                let to_cells = |v: &Vector2<f64>| layout.to_grid(&(*map_from_base * *v));
                // On the stack, and little of it for the outlines that vehicles have.
                if own.len() <= FEW_VERTICES {
                    let mut room = [Vector2::zeros(); FEW_VERTICES];
                    any_run_of_polygon(place(own, to_cells, &mut room), self.convex, margin, hit)
                } else {
                    let mut room = [Vector2::zeros(); Self::MAX_VERTICES];
                    any_run_of_polygon(place(own, to_cells, &mut room), self.convex, margin, hit)
                }
            }
        }
    }
}

/// Vertices of an outline that is not out of the ordinary.
const FEW_VERTICES: usize = 16;

/// The vertices, counted in cells, in the `room` that is given; it holds at least as many.
#[inline]
fn place<'a>(
    own: &[Vector2<f64>],
    to_cells: impl Fn(&Vector2<f64>) -> Vector2<f64>,
    room: &'a mut [Vector2<f64>],
) -> &'a [Vector2<f64>] {
    for (slot, vertex) in room.iter_mut().zip(own) {
        *slot = to_cells(vertex);
    }
    room.get(..own.len()).unwrap_or_default()
}

/// As [`Footprint::any_run`], of a circle whose centre and radius are counted in cells.
#[inline]
fn any_run_of_circle(center: &Vector2<f64>, r: f64, margin: f64, mut hit: impl FnMut(i32, i32, i32) -> bool) -> bool {
    let mut rows = (center.y - r - margin).floor() as i32..=(center.y + r + margin).floor() as i32;
    rows.any(|row| {
        // Widest chord of the strip that belongs to the row.
        let (low, high) = (f64::from(row) - margin - center.y, f64::from(row) + 1.0 + margin - center.y);
        let dy = if low > 0.0 { low } else { (-high).max(0.0) };
        let half = (r * r - dy * dy).max(0.0).sqrt() + margin;
        hit(row, (center.x - half).floor() as i32, (center.x + half).floor() as i32)
    })
}

/// As [`Footprint::any_run`], of a polygon whose vertices are counted in cells.
#[inline]
fn any_run_of_polygon(
    vertices: &[Vector2<f64>],
    convex: bool,
    margin: f64,
    mut hit: impl FnMut(i32, i32, i32) -> bool,
) -> bool {
    let (low, high) = vertices.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v.y), h.max(v.y)));
    let mut rows = (low - margin).floor() as i32..=(high + margin).floor() as i32;
    rows.any(|row| {
        let strip = (f64::from(row) - margin, f64::from(row) + 1.0 + margin);
        let mut spans = edges(vertices).filter_map(|(a, b)| clip(a, b, strip));
        if convex {
            let (first, last) = spans.fold((f64::INFINITY, f64::NEG_INFINITY), |(f, l), (a, b)| (f.min(a), l.max(b)));
            return first <= last && hit(row, (first - margin).floor() as i32, (last + margin).floor() as i32);
        }
        spans.any(|(first, last)| hit(row, (first - margin).floor() as i32, (last + margin).floor() as i32))
            || interior(vertices, f64::from(row) + 0.5, |first, last| {
                hit(row, first.floor() as i32, last.floor() as i32)
            })
    })
}

/// Extent along x of the part of an edge in a strip of y; none if it has none.
#[inline]
pub(super) fn clip(a: Vector2<f64>, b: Vector2<f64>, (low, high): (f64, f64)) -> Option<(f64, f64)> {
    let (below, above) = if a.y <= b.y { (a, b) } else { (b, a) };
    if above.y < low || below.y > high {
        return None;
    }
    let slope = if above.y > below.y { (above.x - below.x) / (above.y - below.y) } else { 0.0 };
    let x_at = |y: f64| below.x + (y - below.y) * slope;
    let from = if below.y < low { x_at(low) } else { below.x };
    let to = if above.y > high { x_at(high) } else { above.x };
    Some((from.min(to), from.max(to)))
}

/// Where edges cross a level; an edge owns its lower end.
fn crossings(vertices: &[Vector2<f64>], level: f64) -> impl Iterator<Item = f64> + '_ {
    edges(vertices)
        .filter(move |(a, b)| (a.y <= level) != (b.y <= level))
        .map(move |(a, b)| a.x + (level - a.y) * (b.x - a.x) / (b.y - a.y))
}

/// Calls `hit(first, last)` for the intervals of a level inside the polygon, until it says true (even-odd rule).
fn interior(vertices: &[Vector2<f64>], level: f64, mut hit: impl FnMut(f64, f64) -> bool) -> bool {
    // The next crossing is searched for each time: there are few, and no list needs to be kept.
    let (mut from, mut inside) = (f64::NEG_INFINITY, false);
    loop {
        let next = crossings(vertices, level).filter(|&x| x > from).fold(f64::INFINITY, f64::min);
        if next == f64::INFINITY {
            return false;
        }
        if inside && hit(from, next) {
            return true;
        }
        inside ^= crossings(vertices, level).filter(|&x| x == next).count() % 2 == 1;
        from = next;
    }
}

/// Whether a polygon holds a point; of its outline, whichever side rounding takes.
pub(super) fn holds(vertices: &[Vector2<f64>], point: Vector2<f64>) -> bool {
    crossings(vertices, point.y).filter(|&x| x >= point.x).count() % 2 == 1
}
