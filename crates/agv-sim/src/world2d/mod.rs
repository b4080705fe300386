//! The planar world: what single rays and vehicle bodies meet.
//!
//! Two worlds implement [`PlanarWorld`]: [`World2d`] of exact shapes, and [`GridWorld`] over an occupancy map. Sensors
//! and [`Simulator2d`](crate::Simulator2d) take either, or a user's own.

mod grid_world;
mod planar;
mod shape;
mod shapes_world;

use crate::Body;
use agv_core::{geometry::Se2, obstacle::MovingObstacle};
use nalgebra::Vector2;

pub use grid_world::GridWorld;
pub(crate) use planar::{point_in_polygon, ray_circle, ray_segment, segment_distance, segment_point_distance};
pub use shape::Shape;
pub(crate) use shape::rectangle_corners;
pub use shapes_world::World2d;

/// A world on the floor plane, in the map frame, in metres.
///
/// Laws: `cast` and `clearance` are pure; a body with positive clearance `c` touches nothing within `c` of it.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{PlanarWorld, Shape, World2d};
///
/// let world = World2d::new(vec![Shape::Circle { center: Vector2::new(5.0, 0.0), radius: 1.0 }])?;
/// assert_eq!(world.cast(&Vector2::zeros(), &Vector2::x(), 10.0), Some(4.0));
/// assert_eq!(world.cast(&Vector2::zeros(), &Vector2::y(), 10.0), None);
/// # Ok::<(), agv_sim::Error>(())
/// ```
pub trait PlanarWorld: Sync {
    /// Distance in metres from `origin` along the unit vector `direction` to the first surface, if it is at most
    /// `max_range` metres away. None for a ray that is not finite.
    fn cast(&self, origin: &Vector2<f64>, direction: &Vector2<f64>, max_range: f64) -> Option<f64>;

    /// Distance in metres between the body at `map_from_body` and the nearest obstacle, at most `limit`; zero is contact.
    fn clearance(&self, body: &Body, map_from_body: &Se2, limit: f64) -> f64;

    /// Whether the body at `map_from_body` touches an obstacle.
    fn touches(&self, body: &Body, map_from_body: &Se2) -> bool {
        self.clearance(body, map_from_body, 0.01) <= 0.0
    }
}

impl<W: PlanarWorld + ?Sized> PlanarWorld for &W {
    fn cast(&self, origin: &Vector2<f64>, direction: &Vector2<f64>, max_range: f64) -> Option<f64> {
        (**self).cast(origin, direction, max_range)
    }

    fn clearance(&self, body: &Body, map_from_body: &Se2, limit: f64) -> f64 {
        (**self).clearance(body, map_from_body, limit)
    }
}

/// A static world with round obstacles that stand where they are now.
#[derive(Debug, Clone, Copy)]
pub struct Populated<'a, W> {
    /// What does not move.
    pub world: W,
    /// What moves, at this moment; see [`MovingDiscs::states_into`](crate::MovingDiscs::states_into).
    pub obstacles: &'a [MovingObstacle],
}

impl<W: PlanarWorld> PlanarWorld for Populated<'_, W> {
    fn cast(&self, origin: &Vector2<f64>, direction: &Vector2<f64>, max_range: f64) -> Option<f64> {
        let fixed = self.world.cast(origin, direction, max_range);
        self.obstacles.iter().fold(fixed, |nearest, disc| {
            let limit = nearest.unwrap_or(max_range);
            ray_circle(origin, direction, &disc.position, disc.radius).filter(|&t| t <= limit).or(nearest)
        })
    }

    fn clearance(&self, body: &Body, map_from_body: &Se2, limit: f64) -> f64 {
        let fixed = self.world.clearance(body, map_from_body, limit);
        self.obstacles.iter().fold(fixed, |nearest, disc| {
            let gap = body.distance_to_point(map_from_body, &disc.position) - disc.radius;
            nearest.min(gap.max(0.0))
        })
    }
}
