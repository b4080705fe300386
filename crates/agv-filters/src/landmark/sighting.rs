//! A landmark as a sensor shows it that is not calibrated and whose clock is not the odometry's.
//!
//! ```text
//! X_t = X exp(ξ (Δ - τ))                          the vehicle at the moment of the sighting, ξ its twist
//! q   = (X_t · base_from_sensor)⁻¹ l               the landmark in the sensor frame, r = |q|, β = atan2(q_y, q_x)
//! z_r = (1 + s_r) ρ + b_r                          ρ = r, or ρ = q_x for a depth
//! z_β = β + b_0 + b_1 sin β + b_2 (1 - cos β)
//! ```

use super::{CalibratedPose, DEGREES, Parameter, RangeKind};
use crate::kalman::{Expected, MeasurementModel};
use agv_core::geometry::{LieGroup, Se2, angle_difference, wrap_angle};
use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2, Vector3};

/// A [`MeasurementModel`] of a [`CalibratedPose`]: range in metres and bearing in radians of a landmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Place of the landmark in the map, in metres.
    pub landmark: Vector2<f64>,
    /// Pose of the sensor on the vehicle.
    pub base_from_sensor: Se2,
    /// What the ranges are.
    pub range_kind: RangeKind,
    /// Covariance of range and bearing that the sensor states.
    pub covariance: Matrix2<f64>,
    /// Deviation of the range per metre of it.
    pub range_share: f64,
    /// Velocities ahead, to the left (m/s) and of the heading (rad/s) about the moment of the sighting.
    pub twist: Vector3<f64>,
    /// Seconds from the state's time to the sighting's stamp: the sighting is of the pose `delay - τ` later than the state.
    pub delay: f64,
}

/// A landmark in the sensor frame, and how it moves there.
struct View {
    seen: Vector2<f64>,
    by_increment: SMatrix<f64, 2, DEGREES>,
}

impl Sighting {
    fn view(&self, state: &CalibratedPose) -> View {
        let since = Se2::exp(&(self.twist * (self.delay - state.get(Parameter::Latency))));
        let moved = state.map_from_base * since;
        let in_base = moved.inverse().act(&self.landmark);
        let seen = self.base_from_sensor.inverse().act(&in_base);
        let turn = self.base_from_sensor.rotation().inverse();
        // A right increment (e, φ) of the moved pose: d in_base = -e - φ (-y, x) of in_base.
        let by_moved = Matrix2x3::new(-1.0, 0.0, in_base.y, 0.0, -1.0, -in_base.x);
        let by_moved = Matrix2x3::from_columns(&[
            turn.act(&by_moved.column(0).into_owned()),
            turn.act(&by_moved.column(1).into_owned()),
            turn.act(&by_moved.column(2).into_owned()),
        ]);
        let mut by_increment = SMatrix::<f64, 2, DEGREES>::zeros();
        by_increment.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_moved * since.inverse().adjoint()));
        by_increment.set_column(Parameter::Latency.row(), &(-(by_moved * self.twist)));
        View { seen, by_increment }
    }

    /// Range before scale and bias, in metres.
    fn extent(&self, seen: &Vector2<f64>) -> f64 {
        match self.range_kind {
            RangeKind::Distance => seen.norm(),
            RangeKind::Depth => seen.x,
        }
    }

    fn reading(&self, state: &CalibratedPose, seen: &Vector2<f64>) -> Vector2<f64> {
        let bearing = seen.y.atan2(seen.x);
        let (sin, cos) = bearing.sin_cos();
        let error = state.get(Parameter::BearingBias)
            + state.get(Parameter::BearingSine) * sin
            + state.get(Parameter::BearingCosine) * (1.0 - cos);
        let range = (1.0 + state.get(Parameter::RangeScale)) * self.extent(seen) + state.get(Parameter::RangeBias);
        Vector2::new(range, wrap_angle(bearing + error))
    }

    fn jacobian_at(&self, state: &CalibratedPose, view: &View) -> SMatrix<f64, 2, DEGREES> {
        let seen = &view.seen;
        let squared = seen.norm_squared();
        let range = squared.sqrt();
        let (sin, cos) = (seen.y / range, seen.x / range);
        let by_seen = match self.range_kind {
            RangeKind::Distance => Vector2::new(cos, sin),
            RangeKind::Depth => Vector2::new(1.0, 0.0),
        };
        let stretch = 1.0 + state.get(Parameter::BearingSine) * cos + state.get(Parameter::BearingCosine) * sin;
        let by_view = Matrix2::from_rows(&[
            (by_seen * (1.0 + state.get(Parameter::RangeScale))).transpose(),
            (Vector2::new(-seen.y, seen.x) * (stretch / squared)).transpose(),
        ]);
        let mut jacobian = by_view * view.by_increment;
        jacobian[(0, Parameter::RangeScale.row())] = self.extent(seen);
        jacobian[(0, Parameter::RangeBias.row())] = 1.0;
        jacobian[(1, Parameter::BearingBias.row())] = 1.0;
        jacobian[(1, Parameter::BearingSine.row())] = sin;
        jacobian[(1, Parameter::BearingCosine.row())] = 1.0 - cos;
        jacobian
    }

    fn noise_at(&self, seen: &Vector2<f64>) -> Matrix2<f64> {
        let growing = self.range_share * self.extent(seen);
        let mut noise = self.covariance;
        noise[(0, 0)] += growing * growing;
        noise
    }
}

impl MeasurementModel<CalibratedPose, DEGREES, 2> for Sighting {
    type Value = Vector2<f64>;

    fn predict(&self, state: &CalibratedPose) -> Vector2<f64> {
        self.reading(state, &self.view(state).seen)
    }

    fn jacobian(&self, state: &CalibratedPose) -> SMatrix<f64, 2, DEGREES> {
        self.jacobian_at(state, &self.view(state))
    }

    fn noise(&self, state: &CalibratedPose) -> Matrix2<f64> {
        self.noise_at(&self.view(state).seen)
    }

    fn residual(&self, measured: &Vector2<f64>, expected: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(measured.x - expected.x, angle_difference(measured.y, expected.y))
    }

    fn linearize(&self, state: &CalibratedPose) -> Expected<Vector2<f64>, DEGREES, 2> {
        let view = self.view(state);
        Expected {
            value: self.reading(state, &view.seen),
            jacobian: self.jacobian_at(state, &view),
            noise: self.noise_at(&view.seen),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Manifold, laws};
    use nalgebra::SVector;
    use proptest::prelude::*;

    fn sighting(range_kind: RangeKind, place: [f64; 2], mount: [f64; 3]) -> Sighting {
        Sighting {
            landmark: Vector2::from(place),
            base_from_sensor: Se2::new(mount[0], mount[1], mount[2]),
            range_kind,
            covariance: Matrix2::identity() * 1e-4,
            range_share: 0.02,
            twist: Vector3::new(0.5, -0.1, 0.7),
            delay: 0.3,
        }
    }

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(
            x in prop::array::uniform15(-0.3..0.3_f64), place in prop::array::uniform2(3.0..9.0_f64), mount in prop::array::uniform3(-0.5..0.5_f64),
        ) {
            let zero = CalibratedPose { map_from_base: Se2::new(1.0, -2.0, 0.4), parameters: SVector::zeros() };
            let state = zero.boxplus(&SVector::from(x));
            for kind in [RangeKind::Distance, RangeKind::Depth] {
                prop_assert!(laws::measurement_jacobian(&sighting(kind, place, mount), &state) < 1e-6);
            }
        }
    }

    /// A tube 4 m ahead and 3 m to the left of a camera: 5 m away, 4 m deep.
    #[test]
    fn a_camera_measures_depth() {
        let state = CalibratedPose { map_from_base: Se2::default(), parameters: SVector::zeros() };
        let read = |kind| {
            let seen = Sighting { twist: Vector3::zeros(), ..sighting(kind, [4.5, 3.0], [0.5, 0.0, 0.0]) };
            seen.predict(&state)
        };
        let bearing = 3.0_f64.atan2(4.0);
        assert!((read(RangeKind::Distance) - Vector2::new(5.0, bearing)).norm() < 1e-12);
        assert!((read(RangeKind::Depth) - Vector2::new(4.0, bearing)).norm() < 1e-12);
    }
}
