//! Exact planar geometry: rays against segments and circles, distances, containment. All lengths in metres.

use nalgebra::Vector2;

/// Play at the ends of a segment, as a fraction of its length: a ray through the corner of two walls must not slip
/// between them by rounding.
const END_PLAY: f64 = 1e-12;

/// Distance along the ray to the segment `ab`, from either side; none for a ray parallel to it (an edge has no width).
#[inline]
pub(crate) fn ray_segment(
    origin: &Vector2<f64>,
    direction: &Vector2<f64>,
    a: &Vector2<f64>,
    b: &Vector2<f64>,
) -> Option<f64> {
    let (edge, to_start) = (b - a, a - origin);
    // origin + t d = a + s e, crossed with e and with d.
    let determinant = direction.perp(&edge);
    let t = to_start.perp(&edge) / determinant;
    let s = to_start.perp(direction) / determinant;
    // A zero determinant makes infinities or NaN, which fail here.
    ((0.0..f64::INFINITY).contains(&t) && (-END_PLAY..=1.0 + END_PLAY).contains(&s)).then_some(t)
}

/// Distance along the ray to the circle, from outside or from inside.
#[inline]
pub(crate) fn ray_circle(
    origin: &Vector2<f64>,
    direction: &Vector2<f64>,
    center: &Vector2<f64>,
    radius: f64,
) -> Option<f64> {
    let to_center = center - origin;
    let along = to_center.dot(direction);
    // The offset from the ray, not |to_center|² - along²: that cancels far away.
    let offset = to_center.perp(direction);
    let half_chord_squared = (radius - offset) * (radius + offset);
    if half_chord_squared < 0.0 {
        return None;
    }
    let half_chord = half_chord_squared.sqrt();
    let (enter, leave) = (along - half_chord, along + half_chord);
    let t = if enter >= 0.0 { enter } else { leave };
    (t >= 0.0).then_some(t)
}

/// Distance between a point and the segment `ab`.
pub(crate) fn segment_point_distance(a: &Vector2<f64>, b: &Vector2<f64>, point: &Vector2<f64>) -> f64 {
    let (edge, to_point) = (b - a, point - a);
    let length_squared = edge.norm_squared();
    let s = if length_squared > 0.0 { (to_point.dot(&edge) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
    (to_point - edge * s).norm()
}

/// Distance between the segments `ab` and `cd`; zero if they cross or touch.
pub(crate) fn segment_distance(a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>, d: &Vector2<f64>) -> f64 {
    let sides = |p: &Vector2<f64>, q: &Vector2<f64>, r: &Vector2<f64>| (q - p).perp(&(r - p));
    let crossing = sides(a, b, c) * sides(a, b, d) < 0.0 && sides(c, d, a) * sides(c, d, b) < 0.0;
    if crossing {
        return 0.0;
    }
    // Apart, the nearest pair of points has an end in it.
    [
        segment_point_distance(a, b, c),
        segment_point_distance(a, b, d),
        segment_point_distance(c, d, a),
        segment_point_distance(c, d, b),
    ]
    .into_iter()
    .fold(f64::INFINITY, f64::min)
}

/// Whether the point lies inside the simple polygon, by counting crossings to its right; points on the border may
/// come out either way.
pub(crate) fn point_in_polygon(vertices: &[Vector2<f64>], point: &Vector2<f64>) -> bool {
    let mut inside = false;
    let mut previous = vertices.last();
    for b in vertices {
        if let Some(a) = previous
            && (a.y > point.y) != (b.y > point.y)
            && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
        {
            inside = !inside;
        }
        previous = Some(b);
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn v(x: f64, y: f64) -> Vector2<f64> {
        Vector2::new(x, y)
    }

    proptest! {
        /// No sampled pair of points of the two segments is nearer than the distance says, and some pair is about so near.
        #[test]
        fn segment_distance_is_the_least_of_all_pairs(c in prop::array::uniform8(-3.0..3.0_f64)) {
            let (a, b, p, q) = (v(c[0], c[1]), v(c[2], c[3]), v(c[4], c[5]), v(c[6], c[7]));
            let distance = segment_distance(&a, &b, &p, &q);
            let sampled = (0..=60)
                .map(|i| a + (b - a) * (f64::from(i) / 60.0))
                .map(|on_ab| segment_point_distance(&p, &q, &on_ab))
                .fold(f64::INFINITY, f64::min);
            prop_assert!(distance <= sampled + 1e-12);
            prop_assert!(sampled <= distance + (b - a).norm() / 60.0);
        }
    }

    #[test]
    fn rays_meet_circles_from_both_sides() {
        let (center, radius) = (v(3.0, 0.0), 1.0);
        assert_eq!(ray_circle(&v(0.0, 0.0), &v(1.0, 0.0), &center, radius), Some(2.0));
        assert_eq!(ray_circle(&v(3.0, 0.0), &v(1.0, 0.0), &center, radius), Some(1.0));
        assert_eq!(ray_circle(&v(5.0, 0.0), &v(1.0, 0.0), &center, radius), None);
        assert_eq!(ray_circle(&v(0.0, 1.5), &v(1.0, 0.0), &center, radius), None);
    }

    #[test]
    fn a_ray_along_a_segment_does_not_see_it() {
        assert_eq!(ray_segment(&v(0.0, 0.0), &v(1.0, 0.0), &v(1.0, 0.0), &v(2.0, 0.0)), None);
        assert_eq!(ray_segment(&v(0.0, 0.0), &v(f64::NAN, 0.0), &v(1.0, -1.0), &v(1.0, 1.0)), None);
    }
}
