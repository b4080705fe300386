//! Outlines in the plane: what footprints and obstacles share.

use nalgebra::Vector2;

pub(crate) fn cross(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

/// Consecutive pairs of a closed polygon.
pub(crate) fn edges(vertices: &[Vector2<f64>]) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + Clone + '_ {
    vertices.iter().zip(vertices.iter().cycle().skip(1)).map(|(a, b)| (*a, *b))
}

/// The point of the segment from `a` to `b`, whose ends may be one, that is nearest to `point`.
///
/// ```
/// use agv_core::{geometry::nearest_on_segment, nalgebra::Vector2};
///
/// let (a, b) = (Vector2::new(0.0, 0.0), Vector2::new(4.0, 0.0));
/// assert_eq!(nearest_on_segment(Vector2::new(1.0, 2.0), a, b), Vector2::new(1.0, 0.0));
/// assert_eq!(nearest_on_segment(Vector2::new(9.0, 2.0), a, b), b);
/// ```
pub fn nearest_on_segment(point: Vector2<f64>, a: Vector2<f64>, b: Vector2<f64>) -> Vector2<f64> {
    let square = (b - a).norm_squared();
    let along = if square > 0.0 { ((point - a).dot(&(b - a)) / square).clamp(0.0, 1.0) } else { 0.0 };
    a + (b - a) * along
}

/// Distance of a point to a segment, whose ends may be one.
pub(crate) fn distance_to_segment(point: Vector2<f64>, a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    (nearest_on_segment(point, a, b) - point).norm()
}

/// Whether two segments have a point in common.
pub(crate) fn segments_meet(a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>, d: Vector2<f64>) -> bool {
    let side = |p: Vector2<f64>, q: Vector2<f64>, r: Vector2<f64>| cross(q - p, r - p);
    let within = |p: Vector2<f64>, q: Vector2<f64>, r: Vector2<f64>| (r - p).dot(&(r - q)) <= 0.0;
    let (s, t, u, v) = (side(a, b, c), side(a, b, d), side(c, d, a), side(c, d, b));
    (s * t < 0.0 && u * v < 0.0)
        || (s == 0.0 && within(a, b, c))
        || (t == 0.0 && within(a, b, d))
        || (u == 0.0 && within(c, d, a))
        || (v == 0.0 && within(c, d, b))
}
