//! A world of segments, circles and polygons, with exact rays and distances.

use super::{PlanarWorld, Shape, point_in_polygon, ray_circle, ray_segment, shape::bounds_of};
use crate::bvh::{Bounds, Bvh, Ray};
use crate::{Body, Error};
use agv_core::geometry::Se2;
use nalgebra::Vector2;

/// What rays are tested against: polygons are taken apart into their edges.
#[derive(Debug, Clone, Copy)]
enum Primitive {
    Segment { a: Vector2<f64>, b: Vector2<f64> },
    Circle { center: Vector2<f64>, radius: f64 },
}

impl Primitive {
    fn bounds(&self) -> Bounds<2> {
        match self {
            Self::Segment { a, b } => bounds_of([a, b]),
            Self::Circle { center, radius } => bounds_of([center]).grown(*radius),
        }
    }
}

/// A world of exact shapes; ranges are analytic, not sampled.
///
/// A tree over the outlines makes a ray cost O(log n): a world of thousands of walls scans like one of a few.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{Body, PlanarWorld, Shape, World2d};
///
/// let mut shapes = Shape::room(Vector2::new(-5.0, -4.0), Vector2::new(5.0, 4.0)).to_vec();
/// shapes.push(Shape::rectangle(Se2::new(3.0, 0.0, 0.0), 1.0, 2.0));
/// let world = World2d::new(shapes)?;
///
/// assert_eq!(world.cast(&Vector2::zeros(), &Vector2::x(), 30.0), Some(2.5));
/// let agv = Body::rectangle(1.0, 0.6)?;
/// assert_eq!(world.clearance(&agv, &Se2::new(1.5, 0.0, 0.0), 10.0), 0.5);
/// assert!(world.touches(&agv, &Se2::new(4.6, 2.0, 0.0)));
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct World2d {
    shapes: Vec<Shape>,
    primitives: Vec<Primitive>,
    tree: Bvh<2>,
    /// Bounds and place in `shapes` of the polygons, for containment.
    polygons: Vec<(Bounds<2>, usize)>,
}

impl World2d {
    /// Most shapes of a world.
    pub const MAX_SHAPES: usize = 1 << 20;

    /// A world of these shapes in the map frame; none makes an empty world. Takes O(n log n).
    ///
    /// # Errors
    /// A shape that is not finite or degenerate, or more than [`MAX_SHAPES`](Self::MAX_SHAPES).
    pub fn new(shapes: Vec<Shape>) -> Result<Self, Error> {
        if shapes.len() > Self::MAX_SHAPES {
            let (len, max) = (shapes.len(), Self::MAX_SHAPES);
            return Err(agv_core::Error::TooMany { name: "shapes", len, max }.into());
        }
        let mut primitives = Vec::new();
        let mut polygons = Vec::new();
        for (index, shape) in shapes.iter().enumerate() {
            shape.validate(index)?;
            match shape {
                Shape::Segment { a, b } => primitives.push(Primitive::Segment { a: *a, b: *b }),
                Shape::Circle { center, radius } => {
                    primitives.push(Primitive::Circle { center: *center, radius: *radius });
                }
                Shape::Polygon(corners) => {
                    polygons.push((bounds_of(corners), index));
                    let next = corners.iter().cycle().skip(1);
                    primitives.extend(corners.iter().zip(next).map(|(&a, &b)| Primitive::Segment { a, b }));
                }
            }
        }
        let boxes: Vec<_> = primitives.iter().map(Primitive::bounds).collect();
        let (tree, order) = Bvh::build(&boxes);
        let primitives = order.iter().map(|&i| primitives[i]).collect();
        Ok(Self { shapes, primitives, tree, polygons })
    }

    /// The shapes it was made of.
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }
}

impl PlanarWorld for World2d {
    #[inline]
    fn cast(&self, origin: &Vector2<f64>, direction: &Vector2<f64>, max_range: f64) -> Option<f64> {
        let ray = Ray::new([origin.x, origin.y], [direction.x, direction.y]);
        let hit = self.tree.cast(&ray, max_range, |entry, limit| {
            let distance = match &self.primitives[entry] {
                Primitive::Segment { a, b } => ray_segment(origin, direction, a, b),
                Primitive::Circle { center, radius } => ray_circle(origin, direction, center, *radius),
            };
            distance.filter(|&t| t <= limit)
        });
        hit.map(|(distance, _)| distance)
    }

    fn clearance(&self, body: &Body, map_from_body: &Se2, limit: f64) -> f64 {
        let bounds = body.bounds(map_from_body);
        // A body swallowed by a polygon meets none of its edges.
        let reference = *map_from_body * body.reference_point();
        let swallowed = self.polygons.iter().any(|(polygon, index)| {
            polygon.gap_squared(&bounds) <= 0.0
                && matches!(&self.shapes[*index], Shape::Polygon(corners) if point_in_polygon(corners, &reference))
        });
        if swallowed {
            return 0.0;
        }
        self.tree.nearest(&bounds, limit, |entry| match &self.primitives[entry] {
            Primitive::Segment { a, b } => body.distance_to_segment(map_from_body, a, b),
            Primitive::Circle { center, radius } => (body.distance_to_point(map_from_body, center) - radius).max(0.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shapes() -> impl Strategy<Value = Vec<Shape>> {
        let point = || (-10.0..10.0_f64, -10.0..10.0_f64).prop_map(|(x, y)| Vector2::new(x, y));
        let shape = prop_oneof![
            (point(), point()).prop_map(|(a, b)| Shape::Segment { a, b }),
            (point(), 0.05..2.0_f64).prop_map(|(center, radius)| Shape::Circle { center, radius }),
            (point(), -3.0..3.0_f64, 0.1..3.0_f64, 0.1..3.0_f64).prop_map(|(p, yaw, l, w)| Shape::rectangle(
                Se2::new(p.x, p.y, yaw),
                l,
                w
            )),
        ];
        prop::collection::vec(shape, 0..40)
    }

    /// Every shape in a world of its own: no tree to speak of.
    fn brute_force(shapes: &[Shape], origin: &Vector2<f64>, direction: &Vector2<f64>) -> Option<f64> {
        let alone = shapes.iter().map(|s| World2d::new(vec![s.clone()]).unwrap());
        alone.filter_map(|w| w.cast(origin, direction, 25.0)).min_by(f64::total_cmp)
    }

    proptest! {
        #[test]
        fn the_tree_changes_no_range(shapes in shapes(), x in -12.0..12.0_f64, y in -12.0..12.0_f64, yaw in -3.2..3.2_f64) {
            let (origin, direction) = (Vector2::new(x, y), Vector2::new(yaw.cos(), yaw.sin()));
            let world = World2d::new(shapes.clone()).unwrap();
            prop_assert_eq!(world.cast(&origin, &direction, 25.0), brute_force(&shapes, &origin, &direction));
        }

        /// No surface lies nearer than the clearance in any direction, and the distance to one wall is the textbook's.
        #[test]
        fn clearance_bounds_every_ray(shapes in shapes(), x in -12.0..12.0_f64, y in -12.0..12.0_f64) {
            let world = World2d::new(shapes).unwrap();
            let origin = Vector2::new(x, y);
            let gap = world.clearance(&Body::circle(0.0).unwrap(), &Se2::new(x, y, 0.0), 50.0);
            for beam in 0..64 {
                let yaw = f64::from(beam) * 0.1;
                if let Some(range) = world.cast(&origin, &Vector2::new(yaw.cos(), yaw.sin()), 50.0) {
                    prop_assert!(range >= gap - 1e-9);
                }
            }
        }

        /// From inside a rectangular room the range is the nearer of two wall crossings.
        #[test]
        fn ranges_in_a_room_are_analytic(x in -4.9..4.9_f64, y in -2.9..2.9_f64, yaw in -3.1..3.1_f64) {
            let world = World2d::new(Shape::room(Vector2::new(-5.0, -3.0), Vector2::new(5.0, 3.0)).to_vec()).unwrap();
            let (s, c) = yaw.sin_cos();
            let range = world.cast(&Vector2::new(x, y), &Vector2::new(c, s), 100.0).unwrap();
            let to_x = if c > 0.0 { (5.0 - x) / c } else { (-5.0 - x) / c };
            let to_y = if s > 0.0 { (3.0 - y) / s } else { (-3.0 - y) / s };
            prop_assert!((range - to_x.min(to_y)).abs() < 1e-9);
        }

        /// In a round room: |origin + r d| is the radius.
        #[test]
        fn ranges_in_a_round_room_are_analytic(x in -2.0..2.0_f64, y in -2.0..2.0_f64, yaw in -3.1..3.1_f64) {
            let world = World2d::new(vec![Shape::Circle { center: Vector2::new(1.0, 2.0), radius: 30.0 }]).unwrap();
            let (origin, direction) = (Vector2::new(x, y), Vector2::new(yaw.cos(), yaw.sin()));
            let range = world.cast(&origin, &direction, 100.0).unwrap();
            prop_assert!(((origin + direction * range - Vector2::new(1.0, 2.0)).norm() - 30.0).abs() < 1e-9);
        }

        /// Walls that share a corner have no gap there.
        #[test]
        fn rays_do_not_slip_through_corners(x in -4.0..4.0_f64, y in -4.0..4.0_f64, corner in 0_usize..4) {
            let (min, max) = (Vector2::new(-5.1, -5.7), Vector2::new(5.3, 5.9));
            let world = World2d::new(Shape::room(min, max).to_vec()).unwrap();
            let target = [min, max, Vector2::new(min.x, max.y), Vector2::new(max.x, min.y)][corner];
            let origin = Vector2::new(x, y);
            let range = world.cast(&origin, &(target - origin).normalize(), 100.0).unwrap();
            prop_assert!((range - (target - origin).norm()).abs() < 1e-9);
        }
    }

    #[test]
    fn bad_shapes_are_refused() {
        let (zero, nan) = (Vector2::zeros(), Vector2::new(f64::NAN, 0.0));
        for (shape, message) in [
            (Shape::Segment { a: zero, b: zero }, "shape 0 is degenerate"),
            (Shape::Segment { a: zero, b: nan }, "segment must be finite"),
            (Shape::Circle { center: nan, radius: 1.0 }, "circle centre must be finite"),
            (Shape::Circle { center: zero, radius: 0.0 }, "circle radius"),
            (Shape::Circle { center: zero, radius: f64::INFINITY }, "circle radius"),
            (Shape::Polygon(vec![zero; 2]), "polygon corners"),
            (Shape::Polygon(vec![zero; 4]), "shape 0 is degenerate"),
            (Shape::Polygon(vec![zero, nan, zero]), "polygon corner"),
        ] {
            let error = World2d::new(vec![shape]).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
    }

    #[test]
    fn rays_that_are_none_hit_nothing() {
        let world = World2d::new(Shape::room(Vector2::new(-1.0, -1.0), Vector2::new(1.0, 1.0)).to_vec()).unwrap();
        let (zero, nan) = (Vector2::zeros(), Vector2::new(f64::NAN, 0.0));
        assert_eq!(world.cast(&nan, &Vector2::x(), 10.0), None);
        assert_eq!(world.cast(&zero, &nan, 10.0), None);
        assert_eq!(world.cast(&zero, &Vector2::x(), f64::NAN), None);
        assert_eq!(world.cast(&zero, &Vector2::x(), 0.5), None);
        assert_eq!(World2d::new(vec![]).unwrap().cast(&zero, &Vector2::x(), 10.0), None);
    }
}
