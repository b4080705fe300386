//! What a planar world is made of.

use crate::Error;
use crate::bvh::Bounds;
use agv_core::{check, geometry::Se2};
use nalgebra::Vector2;

/// A shape in the map frame, all lengths in metres. Rays see every outline from both sides, so that a room is a ring of
/// segments and a pillar a circle.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A thin wall between two points.
    Segment {
        /// One end.
        a: Vector2<f64>,
        /// The other end.
        b: Vector2<f64>,
    },
    /// A solid disc.
    Circle {
        /// Its centre.
        center: Vector2<f64>,
        /// Its radius, in metres.
        radius: f64,
    },
    /// A solid simple polygon, convex or not, its corners in either order.
    Polygon(Vec<Vector2<f64>>),
}

impl Shape {
    /// Thin walls from each point to the next.
    pub fn walls(points: &[Vector2<f64>]) -> impl Iterator<Item = Self> + '_ {
        points.iter().zip(points.iter().skip(1)).map(|(&a, &b)| Self::Segment { a, b })
    }

    /// The four walls of an empty room between two opposite corners, in metres.
    pub fn room(min: Vector2<f64>, max: Vector2<f64>) -> [Self; 4] {
        let corners = [min, Vector2::new(max.x, min.y), max, Vector2::new(min.x, max.y)];
        std::array::from_fn(|i| Self::Segment { a: corners[i], b: corners[(i + 1) % 4] })
    }

    /// A solid rectangle of `length` along and `width` across the x axis of its frame, centred there, in metres.
    pub fn rectangle(map_from_center: Se2, length: f64, width: f64) -> Self {
        Self::Polygon(rectangle_corners(&map_from_center, length, width).to_vec())
    }

    /// The least axis-aligned box around the shape.
    pub(crate) fn bounds(&self) -> Bounds<2> {
        match self {
            Self::Segment { a, b } => bounds_of([a, b]),
            Self::Circle { center, radius } => bounds_of([center]).grown(*radius),
            Self::Polygon(corners) => bounds_of(corners),
        }
    }

    /// Checks the shape, the `index`-th of its list.
    pub(crate) fn validate(&self, index: usize) -> Result<(), Error> {
        match self {
            Self::Segment { a, b } => {
                check::all_finite("segment", a.iter().chain(b.iter()))?;
                if a == b {
                    return Err(Error::Degenerate { index, what: "both ends coincide" });
                }
            }
            Self::Circle { center, radius } => {
                check::all_finite("circle centre", center.iter())?;
                check::positive("circle radius", *radius)?;
            }
            Self::Polygon(corners) => {
                check::at_least("polygon corners", corners.len(), 3)?;
                check::all_finite("polygon corner", corners.iter().flat_map(|c| c.iter()))?;
                // A polygon of no area is a wall, not a solid.
                if doubled_area(corners).abs() <= 0.0 {
                    return Err(Error::Degenerate { index, what: "no area" });
                }
            }
        }
        Ok(())
    }
}

/// Corners of a rectangle centred in its frame, counter-clockwise.
pub(crate) fn rectangle_corners(map_from_center: &Se2, length: f64, width: f64) -> [Vector2<f64>; 4] {
    let (x, y) = (0.5 * length, 0.5 * width);
    [(x, y), (-x, y), (-x, -y), (x, -y)].map(|(x, y)| *map_from_center * Vector2::new(x, y))
}

/// Twice the signed area, positive for counter-clockwise corners.
fn doubled_area(corners: &[Vector2<f64>]) -> f64 {
    corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| a.perp(b)).sum()
}

/// The bounds of some points.
pub(crate) fn bounds_of<'a>(points: impl IntoIterator<Item = &'a Vector2<f64>>) -> Bounds<2> {
    Bounds::around(points.into_iter().map(|p| [p.x, p.y]))
}
