//! A landmark before a sensor, and how it moves there when the vehicle does.
//!
//! ```text
//! b = X⁻¹ l                                       the landmark in the base frame
//! q = base_from_sensor⁻¹ b                        in the sensor frame
//! d q = Rᵀ (-e - φ (-b_y, b_x))                   for a right increment (e, φ) of the pose X, R the sensor's turn on the base
//! ```

use agv_core::geometry::{LieGroup, Se2};
use nalgebra::{Matrix2, Matrix2x3, Vector2};

/// A landmark in the frame of a sensor.
pub(crate) struct View {
    /// Its place there, in metres.
    pub(crate) seen: Vector2<f64>,
    /// The Jacobian of that by a right increment of the vehicle's pose.
    pub(crate) by_pose: Matrix2x3<f64>,
}

impl View {
    /// Of a landmark at `place` in the map.
    pub(crate) fn of(map_from_base: &Se2, base_from_sensor: &Se2, place: &Vector2<f64>) -> Self {
        let in_base = map_from_base.inverse().act(place);
        let turn = base_from_sensor.rotation().inverse();
        let by_pose = Matrix2x3::new(-1.0, 0.0, in_base.y, 0.0, -1.0, -in_base.x);
        let by_pose = Matrix2x3::from_columns(&[
            turn.act(&by_pose.column(0).into_owned()),
            turn.act(&by_pose.column(1).into_owned()),
            turn.act(&by_pose.column(2).into_owned()),
        ]);
        Self { seen: base_from_sensor.inverse().act(&in_base), by_pose }
    }

    /// Distance from the sensor, in metres.
    pub(crate) fn distance(&self) -> f64 {
        self.seen.norm()
    }

    /// Direction from the sensor's x axis, in radians.
    pub(crate) fn bearing(&self) -> f64 {
        self.seen.y.atan2(self.seen.x)
    }

    /// The Jacobian of distance and bearing by the place in the sensor frame; not finite on top of the landmark.
    pub(crate) fn polar_by_seen(&self) -> Matrix2<f64> {
        let (squared, distance) = (self.seen.norm_squared(), self.distance());
        let (x, y) = (self.seen.x, self.seen.y);
        Matrix2::new(x / distance, y / distance, -y / squared, x / squared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        /// Distance and bearing move as the Jacobians say when the vehicle does, by central differences.
        #[test]
        fn jacobians_are_the_derivatives(
            pose in prop::array::uniform3(-3.0..3.0_f64), mount in prop::array::uniform3(-0.5..0.5_f64), place in prop::array::uniform2(5.0..9.0_f64),
        ) {
            let [pose, mount] = [pose, mount].map(|[x, y, yaw]| Se2::new(x, y, yaw));
            let place = Vector2::from(place);
            let view = View::of(&pose, &mount, &place);
            let jacobian = view.polar_by_seen() * view.by_pose;
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-6);
                let [after, before] = [step, -step].map(|step| View::of(&pose.plus(&step), &mount, &place));
                let turn = Se2::new(0.0, 0.0, before.bearing()).between(&Se2::new(0.0, 0.0, after.bearing())).yaw();
                let slope = Vector2::new(after.distance() - before.distance(), turn) / 2e-6;
                prop_assert!((jacobian.column(axis) - slope).amax() < 1e-6);
            }
        }
    }
}
