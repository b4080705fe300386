//! Small convex outlines that are copied, not allocated.

use crate::{
    Error, check,
    geometry::outline::{cross, distance_to_segment, edges},
};
use nalgebra::Vector2;

/// A convex outline around its own origin: a point, a segment, or a convex polygon, counter-clockwise; at most eight vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "Vec<Vector2<f64>>", into = "Vec<Vector2<f64>>")
)]
pub struct Hull {
    vertices: [Vector2<f64>; Self::MAX_VERTICES],
    len: usize,
}

impl Default for Hull {
    /// A point at the origin.
    fn default() -> Self {
        Self::POINT
    }
}

impl Hull {
    /// Most vertices: enough for what scans tell of a pallet truck, a shelf or a group of people.
    pub const MAX_VERTICES: usize = 8;

    /// A point at the origin.
    pub const POINT: Self = Self { vertices: [Vector2::new(0.0, 0.0); Self::MAX_VERTICES], len: 1 };

    /// The outline of these vertices, in metres, in either sense: one point, the two ends of a segment, or a convex polygon.
    ///
    /// # Errors
    /// No vertex or too many, one that is not finite, one that its neighbour repeats, or a polygon that is not convex.
    pub fn new(vertices: &[Vector2<f64>]) -> Result<Self, Error> {
        let len = check::at_least("vertices", vertices.len(), 1)?;
        if len > Self::MAX_VERTICES {
            return Err(Error::TooMany { name: "vertices", len, max: Self::MAX_VERTICES });
        }
        check::all_finite("vertices", vertices.iter().flatten())?;
        let mut hull = Self { len, ..Self::POINT };
        for (slot, vertex) in hull.vertices.iter_mut().zip(vertices) {
            *slot = *vertex;
        }
        if len > 1 {
            edges(vertices).try_for_each(|(a, b)| check::positive("length of an edge", (b - a).norm()).map(|_| ()))?;
        }
        if len > 2 {
            let area = check::finite("area", 0.5 * edges(vertices).map(|(a, b)| cross(a, b)).sum::<f64>())?;
            check::positive("area", area.abs())?;
            if area < 0.0 {
                hull.vertices.iter_mut().take(len).rev().zip(vertices).for_each(|(slot, vertex)| *slot = *vertex);
            }
            // All to the left of every edge: convex, and going round once.
            let own = hull.vertices();
            for (a, b) in edges(own) {
                for vertex in own {
                    let side = cross(b - a, vertex - a);
                    check::in_range("side of a vertex", side, -1e-9 * (b - a).norm_squared(), f64::MAX)?;
                }
            }
        }
        Ok(hull)
    }

    /// The vertices, counter-clockwise, in metres; one for a point, two for a segment.
    pub fn vertices(&self) -> &[Vector2<f64>] {
        self.vertices.get(..self.len).unwrap_or_default()
    }

    /// Greatest distance of a vertex from the origin, in metres.
    pub fn circumscribed_radius(&self) -> f64 {
        self.vertices().iter().map(Vector2::norm).fold(0.0, f64::max)
    }

    /// Distance of a point from the outline, in metres; negative inside of a polygon.
    pub fn distance(&self, point: &Vector2<f64>) -> f64 {
        if self.len == 1 {
            return (point - self.vertices[0]).norm();
        }
        let (mut nearest, mut inside) = (f64::INFINITY, self.len > 2);
        for (a, b) in edges(self.vertices()) {
            nearest = nearest.min(distance_to_segment(*point, a, b));
            inside &= cross(b - a, point - a) >= 0.0;
        }
        if inside { -nearest } else { nearest }
    }
}

impl TryFrom<Vec<Vector2<f64>>> for Hull {
    type Error = Error;

    fn try_from(vertices: Vec<Vector2<f64>>) -> Result<Self, Error> {
        Self::new(&vertices)
    }
}

impl From<Hull> for Vec<Vector2<f64>> {
    fn from(hull: Hull) -> Self {
        hull.vertices().to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn hull(points: &[(f64, f64)]) -> Result<Hull, Error> {
        Hull::new(&points.iter().map(|&(x, y)| Vector2::new(x, y)).collect::<Vec<_>>())
    }

    proptest! {
        /// Against many points of the outline, and against the sense in which it was given.
        #[test]
        fn distance_is_to_the_nearest_point(x in -3.0..3.0_f64, y in -3.0..3.0_f64) {
            let corners = [(-1.0, -0.5), (1.0, -1.0), (1.5, 0.5), (0.0, 1.0)];
            let mut turned = corners;
            turned.reverse();
            let (shape, point) = (hull(&corners).unwrap(), Vector2::new(x, y));
            let outline = edges(shape.vertices()).flat_map(|(a, b)| (0..=500).map(move |i| a + (b - a) * (f64::from(i) / 500.0)));
            let nearest = outline.map(|p| (p - point).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!((shape.distance(&point).abs() - nearest).abs() < 3e-3);
            prop_assert!((shape.distance(&point) - hull(&turned).unwrap().distance(&point)).abs() < 1e-12);
        }
    }

    #[test]
    fn inside_is_negative() {
        let square = hull(&[(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]).unwrap();
        assert!((square.distance(&Vector2::new(0.5, 0.0)) + 0.5).abs() < 1e-12);
        assert!((square.circumscribed_radius() - 2.0_f64.sqrt()).abs() < 1e-12);
        let segment = hull(&[(-1.0, 0.0), (1.0, 0.0)]).unwrap();
        assert_eq!((segment.distance(&Vector2::zeros()), segment.distance(&Vector2::new(2.0, 0.0))), (0.0, 1.0));
        assert_eq!(Hull::POINT.distance(&Vector2::new(3.0, 4.0)), 5.0);
    }

    #[test]
    fn bad_outlines_are_named() {
        for (name, result) in [
            ("vertices", hull(&[])),
            ("vertices", hull(&[(0.0, 0.0); 9])),
            ("vertices", hull(&[(f64::NAN, 0.0)])),
            ("length of an edge", hull(&[(1.0, 0.0), (1.0, 0.0)])),
            ("area", hull(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)])),
            ("side of a vertex", hull(&[(0.0, 0.0), (2.0, 0.0), (0.5, 0.5), (0.0, 2.0)])),
        ] {
            assert!(result.unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
