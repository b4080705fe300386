//! Triangles of codes, told apart by their sides.
//!
//! Codes are printed and laid out to scale, so lengths count and not ratios alone (paper 001, Eqs. 11 and 15–17, whose "similar
//! triangles" would take one of twice the size as well). Lengths are the same for a mirror image; the sign of the area is not.

use nalgebra::Vector2;

/// Three points by their place in a list, with the lengths that tell them from others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Triangle {
    /// Which points they are, counter-clockwise.
    pub(super) corners: [u16; 3],
    /// Lengths of the sides opposite the corners, in metres.
    pub(super) sides: [f64; 3],
}

impl Triangle {
    /// The triangle of three points; none if they lie on one line as far as a length of `tolerance` tells.
    pub(super) fn new(corners: [u16; 3], points: [Vector2<f64>; 3], tolerance: f64) -> Option<Self> {
        let area = super::reader::doubled_area(&points);
        let (corners, [a, b, c]) = if area > 0.0 {
            (corners, points)
        } else {
            ([corners[0], corners[2], corners[1]], [points[0], points[2], points[1]])
        };
        let sides = [(b - c).norm(), (c - a).norm(), (a - b).norm()];
        let triangle = Self { corners, sides };
        // The height over the longest side.
        (area.abs() > tolerance * triangle.longest()).then_some(triangle)
    }

    pub(super) fn longest(&self) -> f64 {
        self.sides.iter().copied().fold(0.0, f64::max)
    }

    /// Greatest difference of the sides if this triangle's first corner is the other's corner `shift`, and so on
    /// counter-clockwise. Only these three ways are no reflections.
    pub(super) fn mismatch(&self, other: &Self, shift: usize) -> f64 {
        (0..3).map(|i| (self.sides[i] - other.sides[(i + shift) % 3]).abs()).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::Se2;
    use proptest::prelude::*;

    proptest! {
        /// Moved and listed in any order a triangle is itself in one of three ways; reflected it is not.
        #[test]
        fn a_triangle_is_known_again_and_its_reflection_is_not(
            points in prop::array::uniform3((-1.0..1.0_f64, -1.0..1.0_f64)),
            (x, y, yaw) in (-5.0..5.0_f64, -5.0..5.0_f64, -3.0..3.0_f64),
            order in Just([0_usize, 1, 2]).prop_shuffle(),
        ) {
            let points = points.map(|(x, y)| Vector2::new(x, y));
            let known = Triangle::new([0, 1, 2], points, 0.01);
            prop_assume!(known.is_some());
            let known = known.unwrap();
            let moved = points.map(|p| Se2::new(x, y, yaw) * p);
            let again = Triangle::new(order.map(|i| i as u16), order.map(|i| moved[i]), 0.01).unwrap();
            let best = |a: &Triangle, b: &Triangle| (0..3).map(|shift| (a.mismatch(b, shift), shift)).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            let (mismatch, shift) = best(&again, &known);
            prop_assert!(mismatch < 1e-9);
            prop_assert_eq!(again.corners, std::array::from_fn(|i| known.corners[(i + shift) % 3]));
            // A reflection has the same lengths in the other sense: a match only if it is nearly isosceles.
            let reflected = points.map(|p| Vector2::new(p.x, -p.y));
            let reflected = Triangle::new([0, 1, 2], reflected, 0.01).unwrap();
            let mut sides = known.sides;
            sides.sort_by(f64::total_cmp);
            let isosceles = (sides[1] - sides[0]).min(sides[2] - sides[1]);
            prop_assert!(best(&reflected, &known).0 >= isosceles - 1e-9);
        }
    }

    #[test]
    fn points_on_a_line_are_no_triangle() {
        let on_line = [0.0, 1.0, 3.0].map(|x| Vector2::new(x, 2.0 * x));
        assert!(Triangle::new([0, 1, 2], on_line, 1e-6).is_none());
        assert!(Triangle::new([0, 1, 2], [Vector2::zeros(); 3], 1e-6).is_none());
        assert!(Triangle::new([0, 1, 2], [Vector2::repeat(f64::NAN); 3], 1e-6).is_none());
    }
}
