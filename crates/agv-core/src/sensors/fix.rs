//! Measurements of where the vehicle is and how fast it goes, from whatever finds them: a scan matcher, another
//! localizer, a radio or tracking system, a Doppler radar. What a fusion filter takes beside IMU and markers.

use super::origin::{Origin, has_origin};
use crate::{
    Error,
    geometry::{LieGroup, Se2, UncertainPose, UncertainVector, propagate_covariance},
    time::Stamp,
};
use nalgebra::Vector2;

/// A measured pose of the sensor in the map; a localizer's estimate is one by a sensor at the vehicle's origin.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, UncertainPose};
/// use agv_core::sensors::PoseObservation;
/// use agv_core::time::Stamp;
///
/// let tracked = UncertainPose::exact(Se2::new(5.0, 1.0, 0.0));
/// let observation = PoseObservation::new(Stamp::default(), tracked).with_mount(Se2::new(0.5, 0.0, 0.0))?;
/// assert!(observation.map_from_base().mean().minus(&Se2::new(4.5, 1.0, 0.0)).norm() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
pub struct PoseObservation<G: LieGroup> {
    origin: Origin<G>,
    map_from_sensor: UncertainPose<G>,
}

has_origin!(PoseObservation<G>, G);

impl<G: LieGroup> PoseObservation<G> {
    /// A pose by the only sensor of its kind, at the vehicle's origin.
    pub fn new(stamp: Stamp, map_from_sensor: UncertainPose<G>) -> Self {
        Self { origin: Origin::new(stamp), map_from_sensor }
    }

    /// Measured pose of the sensor in the map.
    pub const fn map_from_sensor(&self) -> &UncertainPose<G> {
        &self.map_from_sensor
    }

    /// Pose of the vehicle that follows.
    pub fn map_from_base(&self) -> UncertainPose<G> {
        self.map_from_sensor.transport_source(&self.origin.base_from_sensor.inverse())
    }
}

/// A measured place of the sensor in the map, in metres, without its heading: radio or ultrasonic positioning.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PositionObservation {
    origin: Origin<Se2>,
    position: UncertainVector<2>,
}

has_origin!(PositionObservation, Se2);

impl PositionObservation {
    /// A place by the only sensor of its kind, at the vehicle's origin.
    pub fn new(stamp: Stamp, position: UncertainVector<2>) -> Self {
        Self { origin: Origin::new(stamp), position }
    }

    /// Measured place of the sensor in the map, in metres.
    pub const fn position(&self) -> &UncertainVector<2> {
        &self.position
    }

    /// Measured place less the one of the sensor on a vehicle at `map_from_base`, in metres: a filter's innovation.
    pub fn residual(&self, map_from_base: &Se2) -> Vector2<f64> {
        self.position.mean() - map_from_base.act(&self.origin.base_from_sensor.translation())
    }
}

/// A measured velocity of the sensor in its own frame, as a tangent, translation first (m/s, rad/s): wheels, a radar, an
/// optical flow sensor.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::sensors::VelocityObservation;
/// use agv_core::time::Stamp;
///
/// // A flow sensor half a metre ahead of the axle slides sideways as the vehicle turns on the spot.
/// let sliding = VelocityObservation::<Se2>::new(Stamp::default(), Vector3::new(0.0, 0.4, 0.8), Matrix3::identity())?;
/// let (base, _) = sliding.with_mount(Se2::new(0.5, 0.0, 0.0))?.in_base();
/// assert!((base - Vector3::new(0.0, 0.0, 0.8)).norm() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "RawVelocity<G>",
        bound(
            serialize = "G: serde::Serialize, G::Tangent: serde::Serialize, G::Matrix: serde::Serialize",
            deserialize = "G: serde::Deserialize<'de>, G::Tangent: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
        )
    )
)]
pub struct VelocityObservation<G: LieGroup> {
    origin: Origin<G>,
    velocity: G::Tangent,
    covariance: G::Matrix,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(bound(
    deserialize = "G: serde::Deserialize<'de>, G::Tangent: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
))]
struct RawVelocity<G: LieGroup> {
    origin: Origin<G>,
    velocity: G::Tangent,
    covariance: G::Matrix,
}

#[cfg(feature = "serde")]
impl<G: LieGroup> TryFrom<RawVelocity<G>> for VelocityObservation<G> {
    type Error = Error;

    fn try_from(raw: RawVelocity<G>) -> Result<Self, Error> {
        let fresh = Self::new(raw.origin.stamp, raw.velocity, raw.covariance)?;
        Ok(Self { origin: raw.origin, ..fresh })
    }
}

has_origin!(VelocityObservation<G>, G);

impl<G: LieGroup> VelocityObservation<G> {
    /// A velocity with its covariance, by the only sensor of its kind, at the vehicle's origin.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; [`Error::NotCovariance`] unless symmetric and positive semi-definite.
    pub fn new(stamp: Stamp, velocity: G::Tangent, covariance: G::Matrix) -> Result<Self, Error> {
        crate::check::all_finite("velocity", G::tangent_slice(&velocity))?;
        G::check_covariance("covariance", &covariance)?;
        Ok(Self { origin: Origin::new(stamp), velocity, covariance })
    }

    /// Measured velocity in the sensor frame.
    pub const fn velocity(&self) -> &G::Tangent {
        &self.velocity
    }

    /// Its covariance.
    pub const fn covariance(&self) -> &G::Matrix {
        &self.covariance
    }

    /// Velocity of the vehicle that follows, in the base frame, and its covariance: `Ad v` and `Ad Σ Adᵀ`.
    pub fn in_base(&self) -> (G::Tangent, G::Matrix) {
        let adjoint = self.origin.base_from_sensor.adjoint();
        (adjoint * self.velocity, propagate_covariance::<G>(&adjoint, &self.covariance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};

    /// A body's velocity at the sensor, found by driving for a moment, is the one at the base brought there.
    #[test]
    fn velocities_are_those_of_the_same_motion() {
        let (mount, base, dt) = (Se2::new(0.4, -0.2, 0.6), Vector3::new(0.7, 0.1, 0.9), 1e-6);
        let sensor_motion = mount.inverse().compose(&Se2::exp(&(base * dt))).compose(&mount);
        let seen = sensor_motion.log() / dt;
        let observation = VelocityObservation::<Se2>::new(Stamp::default(), seen, Matrix3::identity()).unwrap();
        assert!((observation.with_mount(mount).unwrap().in_base().0 - base).norm() < 1e-9);
    }

    #[test]
    fn a_position_is_compared_where_the_sensor_is() {
        let place = UncertainVector::from_sigmas(Vector2::new(3.0, 4.0), &Vector2::repeat(0.1)).unwrap();
        let observation =
            PositionObservation::new(Stamp::default(), place).with_mount(Se2::new(1.0, 0.0, 0.0)).unwrap();
        let turned = Se2::new(3.0, 2.5, std::f64::consts::FRAC_PI_2);
        assert!((observation.residual(&turned) - Vector2::new(0.0, 0.5)).norm() < 1e-12);
    }

    #[test]
    fn bad_measurements_are_refused() {
        let (stamp, one) = (Stamp::default(), Matrix3::identity());
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(VelocityObservation::<Se2>::new(stamp, Vector3::new(0.0, bad, 0.0), one).is_err());
            assert!(VelocityObservation::<Se2>::new(stamp, Vector3::zeros(), one * bad).is_err());
            let pose = PoseObservation::new(stamp, UncertainPose::exact(Se2::default()));
            assert!(pose.with_mount(Se2::new(bad, 0.0, 0.0)).is_err());
        }
        assert!(VelocityObservation::<Se2>::new(stamp, Vector3::zeros(), -one).is_err());
    }
}
