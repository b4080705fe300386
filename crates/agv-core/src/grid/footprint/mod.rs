//! The vehicle's outline on the floor.

mod cover;
mod runs;

use crate::{
    Error, check,
    geometry::outline::{cross, distance_to_segment, edges, segments_meet},
};
use cover::Cover;
use nalgebra::Vector2;
use runs::holds;

/// The area that a vehicle covers, in its base frame: a point or circle at the origin, two circles, a segment, or a simple polygon.
///
/// ```
/// use agv_core::grid::Footprint;
///
/// let fork_lift = Footprint::rectangle(-1.0, 0.5, 0.8)?;
/// assert_eq!(fork_lift.inscribed_radius(), 0.4);
/// assert!((fork_lift.circumscribed_radius() - 1.0_f64.hypot(0.4)).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "Shape", into = "Shape"))]
pub struct Footprint {
    shape: Shape,
    convex: bool,
    inscribed: f64,
    circumscribed: f64,
    cover: Cover,
}

/// As it is stored.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
enum Shape {
    Point,
    Circle(f64),
    /// Circles on the x axis, in front and behind: where, and how large.
    TwoCircles([(f64, f64); 2]),
    Segment([Vector2<f64>; 2]),
    Polygon(Vec<Vector2<f64>>),
}

impl TryFrom<Shape> for Footprint {
    type Error = Error;

    fn try_from(shape: Shape) -> Result<Self, Error> {
        match shape {
            Shape::Point => Ok(Self::point()),
            Shape::Circle(radius) => Self::circle(radius),
            Shape::TwoCircles([front, rear]) => Self::two_circles(front.0, front.1, rear.0, rear.1),
            Shape::Segment([a, b]) => Self::segment(a, b),
            Shape::Polygon(vertices) => Self::polygon(vertices),
        }
    }
}

impl From<Footprint> for Shape {
    fn from(footprint: Footprint) -> Self {
        footprint.shape
    }
}

impl Footprint {
    /// Most vertices of a polygon.
    pub const MAX_VERTICES: usize = 256;

    /// A circle of `radius` metres around the origin of the base frame.
    ///
    /// # Errors
    /// A radius that is not finite and positive.
    pub fn circle(radius: f64) -> Result<Self, Error> {
        check::positive("radius", radius)?;
        Ok(Self {
            shape: Shape::Circle(radius),
            convex: true,
            inscribed: radius,
            circumscribed: radius,
            cover: Cover::NONE,
        })
    }

    /// A point at the origin of the base frame, for costmaps that are inflated for the vehicle already.
    pub const fn point() -> Self {
        Self { shape: Shape::Point, convex: true, inscribed: 0.0, circumscribed: 0.0, cover: Cover::NONE }
    }

    /// Two circles on the x axis, `front` metres ahead of the origin and `rear` metres ahead of it (negative behind), as
    /// `teb_local_planner` has them: a long vehicle in two look-ups.
    ///
    /// Its inscribed radius is that of a circle in one of the two.
    ///
    /// # Errors
    /// A radius that is not positive, or a number that is not finite.
    pub fn two_circles(front: f64, front_radius: f64, rear: f64, rear_radius: f64) -> Result<Self, Error> {
        check::all_finite("front and rear", &[front, rear])?;
        check::positive("front_radius", front_radius)?;
        check::positive("rear_radius", rear_radius)?;
        let circles = [(front, front_radius), (rear, rear_radius)];
        let inscribed = circles.iter().map(|(x, r)| r - x.abs()).fold(0.0, f64::max);
        let circumscribed = circles.iter().map(|(x, r)| r + x.abs()).fold(0.0, f64::max);
        let cover = Cover::of_two_circles(circles);
        Ok(Self { shape: Shape::TwoCircles(circles), convex: false, inscribed, circumscribed, cover })
    }

    /// A segment between two points of the base frame, in metres: a vehicle without width, for maps that are inflated by half of
    /// it.
    ///
    /// # Errors
    /// A number that is not finite, or two ends in one place.
    pub fn segment(from: Vector2<f64>, to: Vector2<f64>) -> Result<Self, Error> {
        check::all_finite("ends", from.iter().chain(&to))?;
        check::positive("length", (to - from).norm())?;
        let circumscribed = from.norm().max(to.norm());
        let cover = Cover::of_segment([from, to]);
        Ok(Self { shape: Shape::Segment([from, to]), convex: true, inscribed: 0.0, circumscribed, cover })
    }

    /// A rectangle from `rear` to `front` along x and of `width`, in metres; `rear` is negative behind the origin.
    ///
    /// # Errors
    /// A front that is not before the rear, a width that is not positive, or a number that is not finite.
    pub fn rectangle(rear: f64, front: f64, width: f64) -> Result<Self, Error> {
        check::all_finite("rear and front", &[rear, front])?;
        check::positive("length", front - rear)?;
        let half = 0.5 * check::positive("width", width)?;
        Self::polygon(
            [(rear, -half), (front, -half), (front, half), (rear, half)].map(|(x, y)| Vector2::new(x, y)).into(),
        )
    }

    /// A simple polygon, convex or not, by its vertices in metres; kept counter-clockwise, however it is given.
    ///
    /// # Errors
    /// Fewer than three vertices or too many, one that is not finite, one that its neighbour repeats, an area that is
    /// not positive, or edges that meet where they are no neighbours.
    pub fn polygon(mut vertices: Vec<Vector2<f64>>) -> Result<Self, Error> {
        let len = check::at_least("vertices", vertices.len(), 3)?;
        if len > Self::MAX_VERTICES {
            return Err(Error::TooMany { name: "vertices", len, max: Self::MAX_VERTICES });
        }
        check::all_finite("vertices", vertices.iter().flatten())?;
        for (a, b) in edges(&vertices) {
            check::positive("length of an edge", (b - a).norm())?;
        }
        let area = 0.5 * edges(&vertices).map(|(a, b)| cross(a, b)).sum::<f64>();
        check::positive("area", area.abs())?;
        if area < 0.0 {
            vertices.reverse();
        }
        for (i, (a, b)) in edges(&vertices).enumerate() {
            for (j, (c, d)) in edges(&vertices).enumerate().skip(i + 1) {
                let neighbours = j == i + 1 || (i == 0 && j == len - 1);
                if !neighbours && segments_meet(a, b, c, d) {
                    return Err(Error::OutOfRange { name: "edges that meet", value: j as f64, min: 0.0, max: 0.0 });
                }
            }
        }
        let turns = edges(&vertices).zip(edges(&vertices).cycle().skip(1));
        let convex = turns.map(|((a, b), (_, c))| cross(b - a, c - b)).all(|turn| turn >= 0.0);
        let circumscribed = vertices.iter().map(Vector2::norm).fold(0.0, f64::max);
        let to_edge = edges(&vertices).map(|(a, b)| distance_to_segment(Vector2::zeros(), a, b));
        let nearest = to_edge.fold(f64::INFINITY, f64::min);
        let inscribed = if holds(&vertices, Vector2::zeros()) { nearest } else { 0.0 };
        let cover = Cover::of_polygon(&vertices);
        Ok(Self { shape: Shape::Polygon(vertices), convex, inscribed, circumscribed, cover })
    }

    /// Radius of the greatest circle around the base frame's origin that lies inside, in metres; zero if the origin
    /// lies outside.
    pub const fn inscribed_radius(&self) -> f64 {
        self.inscribed
    }

    /// Radius of the least circle around the base frame's origin that holds the footprint, in metres.
    pub const fn circumscribed_radius(&self) -> f64 {
        self.circumscribed
    }

    /// The circles that it is made of, by their place on the x axis and their radius, in metres; none for a segment or polygon.
    pub fn circles(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let circles = match self.shape {
            Shape::Point => [Some((0.0, 0.0)), None],
            Shape::Circle(radius) => [Some((0.0, radius)), None],
            Shape::TwoCircles([front, rear]) => [Some(front), Some(rear)],
            Shape::Segment(_) | Shape::Polygon(_) => [None, None],
        };
        circles.into_iter().flatten()
    }

    /// Circles that cover it: centres in the base frame and radii, in metres. None for a circle around the origin.
    pub fn cover(&self) -> &[(Vector2<f64>, f64)] {
        self.cover.circles()
    }

    /// Circles that hold all of it together, centres in the base frame and radii in metres: at most eight, to be looked up in a
    /// distance field.
    pub fn covering_circles(&self) -> impl Iterator<Item = (Vector2<f64>, f64)> + '_ {
        let own = self.circles().map(|(x, radius)| (Vector2::new(x, 0.0), radius));
        // The cover of two circles is themselves.
        own.take(if self.cover().is_empty() { usize::MAX } else { 0 }).chain(self.cover().iter().copied())
    }

    /// The vertices of a polygon in the base frame, counter-clockwise, or the ends of a segment; none for circles.
    pub fn vertices(&self) -> Option<&[Vector2<f64>]> {
        match &self.shape {
            Shape::Point | Shape::Circle(_) | Shape::TwoCircles(_) => None,
            Shape::Segment(ends) => Some(ends),
            Shape::Polygon(vertices) => Some(vertices),
        }
    }

    /// Whether the footprint holds a point of the base frame; its outline belongs to it, up to rounding.
    pub fn contains(&self, point: &Vector2<f64>) -> bool {
        match &self.shape {
            Shape::Point | Shape::Circle(_) | Shape::TwoCircles(_) => {
                self.circles().any(|(x, radius)| (point - Vector2::new(x, 0.0)).norm() <= radius)
            }
            Shape::Segment([a, b]) => distance_to_segment(*point, *a, *b) <= 1e-12 * self.circumscribed,
            Shape::Polygon(vertices) => holds(vertices, *point),
        }
    }

    /// Distance of a point of the base frame from the outline, in metres; below zero inside. O(vertices).
    ///
    /// ```
    /// use agv_core::{grid::Footprint, nalgebra::Vector2};
    ///
    /// let pallet_truck = Footprint::rectangle(-0.3, 1.5, 0.8)?;
    /// assert!((pallet_truck.signed_distance(&Vector2::new(2.0, 0.0)) - 0.5).abs() < 1e-12);
    /// assert!((pallet_truck.signed_distance(&Vector2::new(0.0, 0.1)) + 0.3).abs() < 1e-12);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn signed_distance(&self, point: &Vector2<f64>) -> f64 {
        let Some(vertices) = self.vertices() else {
            let gaps = self.circles().map(|(x, radius)| (point - Vector2::new(x, 0.0)).norm() - radius);
            return gaps.fold(f64::INFINITY, f64::min);
        };
        let to_edges = edges(vertices).map(|(a, b)| distance_to_segment(*point, a, b));
        let distance = to_edges.fold(f64::INFINITY, f64::min);
        if vertices.len() > 2 && holds(vertices, *point) { -distance } else { distance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(points: &[(f64, f64)]) -> Result<Footprint, Error> {
        Footprint::polygon(points.iter().map(|&(x, y)| Vector2::new(x, y)).collect())
    }

    #[test]
    fn radii_are_those_of_the_shape() {
        let square = polygon(&[(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]).unwrap();
        assert!((square.inscribed_radius() - 1.0).abs() < 1e-12);
        assert!((square.circumscribed_radius() - 2.0_f64.sqrt()).abs() < 1e-12);
        let ahead = polygon(&[(1.0, -1.0), (2.0, -1.0), (2.0, 1.0)]).unwrap();
        assert_eq!(ahead.inscribed_radius(), 0.0, "the origin lies outside");
        let first = square.vertices().unwrap();
        assert!(edges(first).map(|(a, b)| cross(a, b)).sum::<f64>() > 0.0, "kept counter-clockwise");
    }

    #[test]
    fn circles_and_segments_are_what_they_say() {
        let long = Footprint::two_circles(0.6, 0.4, -0.2, 0.5).unwrap();
        assert!((long.inscribed_radius() - 0.3).abs() < 1e-12 && (long.circumscribed_radius() - 1.0).abs() < 1e-12);
        let inside = |x: f64, y: f64| long.contains(&Vector2::new(x, y));
        assert!(
            inside(0.99, 0.0) && inside(-0.69, 0.0) && inside(0.6, 0.39) && !inside(0.6, 0.41) && !inside(1.01, 0.0)
        );
        let line = Footprint::segment(Vector2::new(-1.0, 0.0), Vector2::new(2.0, 0.0)).unwrap();
        assert!(line.contains(&Vector2::new(1.5, 0.0)) && !line.contains(&Vector2::new(1.5, 0.01)));
        assert_eq!((line.inscribed_radius(), line.circumscribed_radius()), (0.0, 2.0));
        assert!(Footprint::point().contains(&Vector2::zeros()) && Footprint::point().circumscribed_radius() == 0.0);
    }

    #[test]
    fn bad_shapes_are_named() {
        for (name, result) in [
            ("radius", Footprint::circle(0.0)),
            ("radius", Footprint::circle(f64::NAN)),
            ("front_radius", Footprint::two_circles(0.5, 0.0, -0.5, 0.3)),
            ("rear_radius", Footprint::two_circles(0.5, 0.3, -0.5, f64::NAN)),
            ("front and rear", Footprint::two_circles(f64::INFINITY, 0.3, -0.5, 0.3)),
            ("length", Footprint::segment(Vector2::x(), Vector2::x())),
            ("ends", Footprint::segment(Vector2::x(), Vector2::new(0.0, f64::NAN))),
            ("length", Footprint::rectangle(1.0, 1.0, 1.0)),
            ("width", Footprint::rectangle(0.0, 1.0, -1.0)),
            ("vertices", polygon(&[(0.0, 0.0), (1.0, 0.0)])),
            ("vertices", polygon(&[(0.0, 0.0), (1.0, 0.0), (f64::NAN, 1.0)])),
            ("length of an edge", polygon(&[(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0)])),
            ("area", polygon(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)])),
            ("edges that meet", polygon(&[(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 1.0)])),
        ] {
            assert!(result.unwrap_err().to_string().starts_with(name), "{name}");
        }
        assert!(matches!(Footprint::polygon(vec![Vector2::zeros(); 300]), Err(Error::TooMany { .. })));
    }
}
