//! Obstacles that move, as planners see them.

mod gap;
mod hull;

use crate::{Error, check};
pub use hull::Hull;
use nalgebra::Vector2;

/// Which obstacle it is: the same in every cycle, as long as it is tracked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ObstacleId(pub u64);

/// An obstacle on a straight course, in the map frame: a small convex outline, grown by a radius.
///
/// A point and a radius make a disc, a segment and a radius a capsule; a polygon may have rounded corners.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::obstacle::{Hull, MovingObstacle, ObstacleId};
///
/// let person = MovingObstacle::new(Vector2::new(4.0, 0.0), Vector2::new(-1.0, 0.0), 0.3)?.with_id(ObstacleId(7));
/// assert_eq!(person.position_after(2.0), Vector2::new(2.0, 0.0));
/// assert!((person.distance_after(2.0, &Vector2::zeros()) - 1.7).abs() < 1e-12);
///
/// // A truck with its trailer, 3 m long.
/// let train = Hull::new(&[Vector2::new(-1.5, 0.0), Vector2::new(1.5, 0.0)])?;
/// let train = MovingObstacle::new(Vector2::new(0.0, 2.0), Vector2::new(0.5, 0.0), 0.4)?.with_hull(train);
/// assert!((train.distance_after(0.0, &Vector2::new(1.5, 0.0)) - 1.6).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MovingObstacle {
    /// Which one it is.
    pub id: ObstacleId,
    /// Position of the outline's origin now, in metres.
    pub position: Vector2<f64>,
    /// Velocity, in metres per second; zero for an obstacle at rest.
    pub velocity: Vector2<f64>,
    /// By how much the outline is grown, in metres; a disc's radius.
    pub radius: f64,
    /// The outline around its position, along the axes of the map.
    pub hull: Hull,
}

impl MovingObstacle {
    /// A disc from its state now, with the identity zero; a radius of zero makes it a point.
    ///
    /// # Errors
    /// A position or velocity that is not finite, or a negative radius.
    pub fn new(position: Vector2<f64>, velocity: Vector2<f64>, radius: f64) -> Result<Self, Error> {
        check::all_finite("position", position.iter())?;
        check::all_finite("velocity", velocity.iter())?;
        check::non_negative("radius", radius)?;
        Ok(Self { id: ObstacleId::default(), position, velocity, radius, hull: Hull::POINT })
    }

    /// The same obstacle with an identity.
    #[must_use]
    pub const fn with_id(self, id: ObstacleId) -> Self {
        Self { id, ..self }
    }

    /// The same obstacle with an outline, which the radius grows.
    #[must_use]
    pub const fn with_hull(self, hull: Hull) -> Self {
        Self { hull, ..self }
    }

    /// Position after `dt` seconds, in metres.
    #[inline]
    pub fn position_after(&self, dt: f64) -> Vector2<f64> {
        self.position + self.velocity * dt
    }

    /// Distance of a point of the map from the obstacle as it is after `dt` seconds, in metres; negative inside.
    #[inline]
    pub fn distance_after(&self, dt: f64, point: &Vector2<f64>) -> f64 {
        self.hull.distance(&(point - self.position_after(dt))) - self.radius
    }

    /// Radius of the least circle around the position that holds the obstacle, in metres.
    pub fn circumscribed_radius(&self) -> f64 {
        self.hull.circumscribed_radius() + self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_input_is_refused() {
        let zero = Vector2::zeros();
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(MovingObstacle::new(Vector2::new(bad, 0.0), zero, 0.1).is_err());
            assert!(MovingObstacle::new(zero, Vector2::new(0.0, bad), 0.1).is_err());
            assert!(MovingObstacle::new(zero, zero, bad).is_err());
        }
        assert!(MovingObstacle::new(zero, zero, -0.1).is_err() && MovingObstacle::new(zero, zero, 0.0).is_ok());
    }

    #[cfg(feature = "serde")]
    #[test]
    fn stored_outlines_are_checked() {
        let hull = Hull::new(&[Vector2::new(0.0, 0.0), Vector2::new(1.0, 0.0), Vector2::new(0.0, 1.0)]).unwrap();
        let obstacle = MovingObstacle::new(Vector2::x(), Vector2::y(), 0.2).unwrap().with_hull(hull);
        let text = serde_json::to_string(&obstacle).unwrap();
        assert_eq!(serde_json::from_str::<MovingObstacle>(&text).unwrap(), obstacle);
        assert!(serde_json::from_str::<Hull>("[]").is_err());
    }
}
