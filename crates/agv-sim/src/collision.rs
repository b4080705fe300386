//! The vehicle's body, for contact and distance against the world.

use crate::Error;
use crate::bvh::Bounds;
use crate::world2d::{point_in_polygon, segment_distance, segment_point_distance};
use agv_core::{check, geometry::Se2};
use nalgebra::Vector2;

/// The outline of a vehicle on the floor, in its base frame.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::Body;
///
/// let agv = Body::rectangle(0.5, 0.3)?; // the vehicle of paper 001
/// let gap = agv.distance_to_point(&Se2::new(1.0, 0.0, 0.0), &Vector2::new(2.0, 0.0));
/// assert_eq!(gap, 0.75);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    outline: Outline,
    /// Distance from the base to the farthest point, in metres.
    reach: f64,
}

#[derive(Debug, Clone, PartialEq)]
enum Outline {
    /// Radius about the base.
    Circle(f64),
    /// Corners in the base frame.
    Polygon(Vec<Vector2<f64>>),
}

impl Body {
    /// A disc of `radius` metres about the base; zero is a point.
    ///
    /// # Errors
    /// A radius that is negative or not finite.
    pub fn circle(radius: f64) -> Result<Self, Error> {
        check::non_negative("body radius", radius)?;
        Ok(Self { outline: Outline::Circle(radius), reach: radius })
    }

    /// A rectangle centred on the base, `length` metres along x and `width` along y.
    ///
    /// # Errors
    /// A side that is not finite and positive.
    pub fn rectangle(length: f64, width: f64) -> Result<Self, Error> {
        check::positive("body length", length)?;
        check::positive("body width", width)?;
        let (x, y) = (0.5 * length, 0.5 * width);
        Self::polygon([(x, y), (-x, y), (-x, -y), (x, -y)].map(|(x, y)| Vector2::new(x, y)).to_vec())
    }

    /// A simple polygon, convex or not, by its corners in metres in the base frame.
    ///
    /// # Errors
    /// Fewer than three corners, or one that is not finite.
    pub fn polygon(corners: Vec<Vector2<f64>>) -> Result<Self, Error> {
        check::at_least("body corners", corners.len(), 3)?;
        check::all_finite("body corner", corners.iter().flat_map(|c| c.iter()))?;
        let reach = corners.iter().map(Vector2::norm).fold(0.0, f64::max);
        Ok(Self { outline: Outline::Polygon(corners), reach })
    }

    /// Distance from the base to the farthest point of the body, in metres.
    pub const fn reach(&self) -> f64 {
        self.reach
    }

    /// Distance between the body at `map_from_body` and a point of the map, in metres; zero inside.
    pub fn distance_to_point(&self, map_from_body: &Se2, point: &Vector2<f64>) -> f64 {
        match &self.outline {
            Outline::Circle(radius) => ((point - map_from_body.translation()).norm() - radius).max(0.0),
            Outline::Polygon(corners) => {
                let local = agv_core::geometry::LieGroup::inverse(map_from_body) * *point;
                if point_in_polygon(corners, &local) {
                    return 0.0;
                }
                edges(corners).map(|(a, b)| segment_point_distance(a, b, &local)).fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// Distance between the body at `map_from_body` and the segment `ab` of the map, in metres; zero if they meet.
    pub fn distance_to_segment(&self, map_from_body: &Se2, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
        match &self.outline {
            Outline::Circle(radius) => (segment_point_distance(a, b, &map_from_body.translation()) - radius).max(0.0),
            Outline::Polygon(corners) => {
                let body_from_map = agv_core::geometry::LieGroup::inverse(map_from_body);
                let (a, b) = (body_from_map * *a, body_from_map * *b);
                if point_in_polygon(corners, &a) {
                    return 0.0;
                }
                edges(corners).map(|(c, d)| segment_distance(c, d, &a, &b)).fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// A point of the body, in the base frame.
    pub(crate) fn reference_point(&self) -> Vector2<f64> {
        match &self.outline {
            Outline::Circle(_) => Vector2::zeros(),
            Outline::Polygon(corners) => corners.first().copied().unwrap_or_default(),
        }
    }

    /// The least axis-aligned box of the map around the body.
    pub(crate) fn bounds(&self, map_from_body: &Se2) -> Bounds<2> {
        match &self.outline {
            Outline::Circle(radius) => Bounds::around([map_from_body.translation().into()]).grown(*radius),
            Outline::Polygon(corners) => Bounds::around(corners.iter().map(|c| (*map_from_body * *c).into())),
        }
    }
}

/// Each edge of a closed polygon.
fn edges(corners: &[Vector2<f64>]) -> impl Iterator<Item = (&Vector2<f64>, &Vector2<f64>)> {
    corners.iter().zip(corners.iter().cycle().skip(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PlanarWorld, Shape, World2d};
    use proptest::prelude::*;

    proptest! {
        /// A body moved by less than its clearance still touches nothing: distances are 1-Lipschitz.
        #[test]
        fn a_body_is_free_within_its_clearance(x in -6.0..6.0_f64, y in -6.0..6.0_f64, yaw in -3.1..3.1_f64, way in -3.1..3.1_f64) {
            let world = World2d::new(vec![
                Shape::rectangle(Se2::new(1.0, 1.0, 0.4), 2.0, 1.0),
                Shape::Circle { center: Vector2::new(-3.0, 2.0), radius: 0.7 },
                Shape::Segment { a: Vector2::new(-5.0, -4.0), b: Vector2::new(4.0, -3.0) },
            ]).unwrap();
            let body = Body::polygon(vec![Vector2::new(0.8, 0.0), Vector2::new(-0.4, 0.3), Vector2::new(-0.2, 0.0), Vector2::new(-0.4, -0.3)]).unwrap();
            let gap = world.clearance(&body, &Se2::new(x, y, yaw), 50.0);
            let moved = Se2::new(x + 0.999 * gap * way.cos(), y + 0.999 * gap * way.sin(), yaw);
            prop_assert!(gap <= 0.0 || !world.touches(&body, &moved));
        }
    }

    #[test]
    fn a_swallowed_body_is_in_contact() {
        let world = World2d::new(vec![
            Shape::rectangle(Se2::new(0.0, 0.0, 0.3), 10.0, 10.0),
            Shape::Circle { center: Vector2::new(20.0, 0.0), radius: 5.0 },
        ])
        .unwrap();
        for body in [Body::circle(0.2).unwrap(), Body::rectangle(0.5, 0.3).unwrap()] {
            for x in [0.0, 1.0, 20.0, 22.0] {
                assert!(world.touches(&body, &Se2::new(x, 0.0, 1.0)), "{x}");
            }
            assert!(!world.touches(&body, &Se2::new(10.0, 0.0, 1.0)));
        }
    }

    #[test]
    fn a_thin_wall_inside_a_large_body_is_in_contact() {
        let world =
            World2d::new(vec![Shape::Segment { a: Vector2::new(0.1, 0.0), b: Vector2::new(0.2, 0.0) }]).unwrap();
        assert!(world.touches(&Body::rectangle(2.0, 2.0).unwrap(), &Se2::default()));
    }

    #[test]
    fn bad_bodies_are_refused() {
        assert!(Body::circle(-1.0).is_err());
        assert!(Body::circle(f64::NAN).is_err());
        assert!(Body::rectangle(0.0, 1.0).is_err());
        assert!(Body::rectangle(1.0, f64::INFINITY).is_err());
        assert!(Body::polygon(vec![Vector2::zeros(); 2]).is_err());
        assert!(Body::polygon(vec![Vector2::new(f64::NAN, 0.0); 3]).is_err());
    }
}
