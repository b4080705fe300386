//! What the parts of a moving body feel.

use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se3, So3, Twist2},
};
use nalgebra::Vector3;

/// What a body really does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InertialTruth {
    /// Attitude of the body in the map, whose z axis points up.
    pub map_from_body: So3,
    /// Turn rates in the body frame, in radians per second.
    pub angular_rate: Vector3<f64>,
    /// Change of the turn rates, in radians per second squared.
    pub angular_acceleration: Vector3<f64>,
    /// Acceleration of the body's origin in the body frame, in metres per second squared, gravity not counted.
    pub acceleration: Vector3<f64>,
}

impl InertialTruth {
    /// A vehicle on a level floor that heads for `yaw`, with this twist, and the twist's change per second
    /// (`acceleration` in m/s² and rad/s²), at its origin: turning adds the centripetal acceleration.
    pub fn planar(yaw: f64, twist: &Twist2, acceleration: &Twist2) -> Self {
        // d/dt of a velocity given in a frame that turns: v' + ω × v.
        let (vx, vy, rate) = (twist.vx, twist.vy, twist.yaw_rate);
        Self {
            map_from_body: So3::from_roll_pitch_yaw(0.0, 0.0, yaw),
            angular_rate: Vector3::new(0.0, 0.0, rate),
            angular_acceleration: Vector3::new(0.0, 0.0, acceleration.yaw_rate),
            acceleration: Vector3::new(acceleration.vx - rate * vy, acceleration.vy + rate * vx, 0.0),
        }
    }

    /// What a part that is mounted at `body_from_part` does: the lever adds `α × r + ω × (ω × r)`.
    #[must_use]
    pub fn at(&self, body_from_part: &Se3) -> Self {
        let (lever, rotation) = (body_from_part.translation(), body_from_part.rotation());
        let (rate, change) = (self.angular_rate, self.angular_acceleration);
        let acceleration = self.acceleration + change.cross(&lever) + rate.cross(&rate.cross(&lever));
        let part_from_body = rotation.inverse();
        Self {
            map_from_body: self.map_from_body.compose(&rotation),
            angular_rate: part_from_body.act(&rate),
            angular_acceleration: part_from_body.act(&change),
            acceleration: part_from_body.act(&acceleration),
        }
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        check::all_finite("angular_rate", self.angular_rate.iter())?;
        check::all_finite("angular_acceleration", self.angular_acceleration.iter())?;
        check::all_finite("acceleration", self.acceleration.iter())?;
        check::all_finite("map_from_body", &self.map_from_body.matrix())?;
        Ok(())
    }
}
