//! Obstacles that move, as planners see them.

use crate::{Error, check};
use nalgebra::Vector2;

/// A round obstacle on a straight course, in the map frame.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::obstacle::MovingObstacle;
///
/// let person = MovingObstacle::new(Vector2::new(4.0, 0.0), Vector2::new(-1.0, 0.0), 0.3)?;
/// assert_eq!(person.position_after(2.0), Vector2::new(2.0, 0.0));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MovingObstacle {
    /// Centre now, in metres.
    pub position: Vector2<f64>,
    /// Velocity, in metres per second; zero for an obstacle at rest.
    pub velocity: Vector2<f64>,
    /// Radius, in metres; zero for a point.
    pub radius: f64,
}

impl MovingObstacle {
    /// An obstacle from its state now.
    ///
    /// # Errors
    /// A position or velocity that is not finite, or a negative radius.
    pub fn new(position: Vector2<f64>, velocity: Vector2<f64>, radius: f64) -> Result<Self, Error> {
        check::all_finite("position", position.iter())?;
        check::all_finite("velocity", velocity.iter())?;
        check::non_negative("radius", radius)?;
        Ok(Self { position, velocity, radius })
    }

    /// Centre after `dt` seconds, in metres.
    #[inline]
    pub fn position_after(&self, dt: f64) -> Vector2<f64> {
        self.position + self.velocity * dt
    }
}
