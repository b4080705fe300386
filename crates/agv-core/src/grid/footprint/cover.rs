//! Circles that cover an outline: a long vehicle is known to be clear by a few looks at a distance field.
//!
//! The outline's bounding box is cut across its longer side into strips, and the part of the outline in each strip is put
//! into the circle around its own box. A rectangle of `l` by `w` takes `2 l / w` circles, which stand out by 0.06 `w` at its
//! sides, where the one circle around the whole stands out by half the difference of its sides or more.

use super::runs::clip;
use crate::geometry::outline::edges;
use nalgebra::Vector2;

/// Circles at most.
const MOST: usize = 8;

/// Centres in the base frame and radii.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Cover {
    circles: [(Vector2<f64>, f64); MOST],
    len: usize,
}

impl Cover {
    /// No circles: for outlines that are circles themselves.
    pub(super) const NONE: Self = Self { circles: [(Vector2::new(0.0, 0.0), 0.0); MOST], len: 0 };

    pub(super) fn circles(&self) -> &[(Vector2<f64>, f64)] {
        self.circles.get(..self.len).unwrap_or_default()
    }

    /// Two circles on the x axis: themselves.
    pub(super) fn of_two_circles(circles: [(f64, f64); 2]) -> Self {
        let mut cover = Self { len: 2, ..Self::NONE };
        for (slot, (x, radius)) in cover.circles.iter_mut().zip(circles) {
            *slot = (Vector2::new(x, 0.0), radius);
        }
        cover
    }

    /// Circles around the parts of a segment.
    pub(super) fn of_segment([from, to]: [Vector2<f64>; 2]) -> Self {
        let step = (to - from) / MOST as f64;
        let mut cover = Self { len: MOST, ..Self::NONE };
        for (i, circle) in cover.circles.iter_mut().enumerate() {
            *circle = (from + step * (i as f64 + 0.5), 0.5 * step.norm() * GROWTH);
        }
        cover
    }

    /// Circles around the strips of a polygon.
    pub(super) fn of_polygon(vertices: &[Vector2<f64>]) -> Self {
        let none = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        let (low, high) = vertices.iter().fold(none, |(low, high), v| (low.inf(v), high.sup(v)));
        let size = high - low;
        let along_x = size.x >= size.y;
        // Strips of y, as `clip` has them: an outline that is longer along x is looked at with its axes swapped.
        let swapped = |v: Vector2<f64>| if along_x { Vector2::new(v.y, v.x) } else { v };
        let (low, size) = (swapped(low), swapped(size));
        let len = ((2.0 * size.y / size.x).ceil() as usize).clamp(1, MOST);
        let height = size.y / len as f64;
        let mut cover = Self { len, ..Self::NONE };
        for (i, circle) in cover.circles.iter_mut().take(len).enumerate() {
            let from = low.y + height * i as f64;
            let strip = (from - height * 1e-9, from + height * (1.0 + 1e-9));
            let spans = edges(vertices).filter_map(|(a, b)| clip(swapped(a), swapped(b), strip));
            let (left, right) = spans.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, r), (a, b)| (l.min(a), r.max(b)));
            let center = Vector2::new(0.5 * (left + right), from + 0.5 * height);
            *circle = (swapped(center), 0.5 * (right - left).hypot(height) * GROWTH);
        }
        cover
    }
}

/// Against rounding.
const GROWTH: f64 = 1.0 + 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Footprint;
    use proptest::prelude::*;

    fn polygons() -> Vec<Vec<Vector2<f64>>> {
        let of = |corners: &[(f64, f64)]| corners.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
        vec![
            of(&[(-0.4, -0.4), (1.6, -0.4), (1.6, 0.4), (-0.4, 0.4)]),
            of(&[(-0.1, -2.0), (0.1, -2.0), (0.1, 3.0), (-0.1, 3.0)]),
            of(&[(-0.3, -0.2), (0.4, -0.2), (0.4, 0.0), (0.0, 0.05), (-0.05, 0.3), (-0.3, 0.3)]),
            of(&[(-0.1, 0.0), (5.0, -0.03), (5.0, 0.03)]),
            of(&[(0.0, 0.0), (1.0, 0.0), (0.9, 1.0), (0.5, 0.2), (0.1, 1.1)]),
        ]
    }

    proptest! {
        #[test]
        fn every_point_is_in_a_circle(which in 0..5_usize, u in 0.0..1.0_f64, v in 0.0..1.0_f64) {
            let vertices = polygons().swap_remove(which);
            let cover = Cover::of_polygon(&vertices);
            let footprint = Footprint::polygon(vertices).unwrap();
            let point = Vector2::new(-1.0 + 7.0 * u, -2.5 + 6.0 * v);
            if footprint.contains(&point) {
                prop_assert!(cover.circles().iter().any(|(center, radius)| (point - center).norm() <= *radius));
            }
        }
    }

    #[test]
    fn circles_hug_the_outline() {
        let cover = Cover::of_polygon(&polygons()[0]);
        assert_eq!(cover.circles().len(), 5);
        assert!(cover.circles().iter().all(|&(center, radius)| center.y == 0.0 && radius < 0.45));
        let segment = Cover::of_segment([Vector2::zeros(), Vector2::new(0.8, 0.0)]);
        assert!((segment.circles()[7].0.x - 0.75).abs() < 1e-12 && segment.circles()[7].1 < 0.051);
    }
}
