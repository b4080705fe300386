//! A landmark as a sensor shows it that is not calibrated and whose clock is not the odometry's.
//!
//! ```text
//! X_t = X exp(ξ (Δ - τ))                          the vehicle at the moment of the sighting, ξ its twist
//! q   = (X_t · base_from_sensor)⁻¹ l               the landmark in the sensor frame, r = |q|, β = atan2(q_y, q_x)
//! z_r = (1 + s_r) ρ + b_r                          ρ = r, or ρ = q_x for a depth
//! z_β = β + b_0 + b_1 sin β + b_2 (1 - cos β)
//! ```

use super::{CalibratedPose, DEGREES, Parameter, RangeKind, view::View};
use crate::kalman::{Expected, MeasurementModel};
use agv_core::geometry::{LieGroup, Se2, angle_difference, wrap_angle};
use nalgebra::{Matrix2, RowVector2, SMatrix, Vector2, Vector3};

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

/// How the vehicle has moved between the state's time and the moment of the sighting, and what it sees then.
struct Moment {
    since: Se2,
    view: View,
}

impl Sighting {
    fn moment(&self, state: &CalibratedPose) -> Moment {
        let since = Se2::exp(&(self.twist * (self.delay - state.get(Parameter::Latency))));
        let moved = state.map_from_base * since;
        Moment { since, view: View::of(&moved, &self.base_from_sensor, &self.landmark) }
    }

    /// Range before scale and bias, in metres.
    fn extent(&self, view: &View) -> f64 {
        match self.range_kind {
            RangeKind::Distance => view.distance(),
            RangeKind::Depth => view.seen.x,
        }
    }

    fn reading(&self, state: &CalibratedPose, view: &View) -> Vector2<f64> {
        let bearing = view.bearing();
        let (sin, cos) = bearing.sin_cos();
        let error = state.get(Parameter::BearingBias)
            + state.get(Parameter::BearingSine) * sin
            + state.get(Parameter::BearingCosine) * (1.0 - cos);
        let range = (1.0 + state.get(Parameter::RangeScale)) * self.extent(view) + state.get(Parameter::RangeBias);
        Vector2::new(range, wrap_angle(bearing + error))
    }

    fn jacobian_at(&self, state: &CalibratedPose, Moment { since, view }: &Moment) -> SMatrix<f64, 2, DEGREES> {
        let polar = view.polar_by_seen();
        let (cos, sin) = (polar.m11, polar.m12);
        let by_seen = match self.range_kind {
            RangeKind::Distance => polar.row(0).into_owned(),
            RangeKind::Depth => RowVector2::new(1.0, 0.0),
        };
        let stretch = 1.0 + state.get(Parameter::BearingSine) * cos + state.get(Parameter::BearingCosine) * sin;
        let by_view = Matrix2::from_rows(&[by_seen * (1.0 + state.get(Parameter::RangeScale)), polar.row(1) * stretch]);
        let by_moved = by_view * view.by_pose;
        let mut jacobian = SMatrix::<f64, 2, DEGREES>::zeros();
        jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&(by_moved * since.inverse().adjoint()));
        jacobian.set_column(Parameter::Latency.row(), &(-(by_moved * self.twist)));
        jacobian[(0, Parameter::RangeScale.row())] = self.extent(view);
        jacobian[(0, Parameter::RangeBias.row())] = 1.0;
        jacobian[(1, Parameter::BearingBias.row())] = 1.0;
        jacobian[(1, Parameter::BearingSine.row())] = sin;
        jacobian[(1, Parameter::BearingCosine.row())] = 1.0 - cos;
        jacobian
    }

    fn noise_at(&self, view: &View) -> Matrix2<f64> {
        let growing = self.range_share * self.extent(view);
        let mut noise = self.covariance;
        noise[(0, 0)] += growing * growing;
        noise
    }
}

impl MeasurementModel<CalibratedPose, DEGREES, 2> for Sighting {
    type Value = Vector2<f64>;

    fn predict(&self, state: &CalibratedPose) -> Vector2<f64> {
        self.reading(state, &self.moment(state).view)
    }

    fn jacobian(&self, state: &CalibratedPose) -> SMatrix<f64, 2, DEGREES> {
        self.jacobian_at(state, &self.moment(state))
    }

    fn noise(&self, state: &CalibratedPose) -> Matrix2<f64> {
        self.noise_at(&self.moment(state).view)
    }

    fn residual(&self, measured: &Vector2<f64>, expected: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(measured.x - expected.x, angle_difference(measured.y, expected.y))
    }

    fn linearize(&self, state: &CalibratedPose) -> Expected<Vector2<f64>, DEGREES, 2> {
        let moment = self.moment(state);
        Expected {
            value: self.reading(state, &moment.view),
            jacobian: self.jacobian_at(state, &moment),
            noise: self.noise_at(&moment.view),
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
