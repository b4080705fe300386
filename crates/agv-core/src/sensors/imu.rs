//! What an inertial measurement unit reports.

use super::origin::{Origin, has_origin};
use crate::{
    geometry::{Se3, So3, UncertainPose, UncertainVector},
    time::Stamp,
};

/// Standard gravity, in m/s².
pub const GRAVITY: f64 = 9.806_65;

/// A sample of an inertial measurement unit, in its own frame, with what it has: a single gyro, six axes, or an attitude
/// too.
///
/// The parts are those of ROS's `sensor_msgs/Imu`; one that is missing there (a covariance that starts with -1) is none
/// here, and a covariance of zero says that the driver does not know it: the consumer's parameters then state the noise.
/// White noise of a density `n` per √Hz makes a sample over `dt` seconds vary by `n² / dt`.
///
/// ```
/// use agv_core::geometry::UncertainVector;
/// use agv_core::nalgebra::Vector3;
/// use agv_core::sensors::ImuSample;
/// use agv_core::time::Stamp;
///
/// let (density, dt) = (1.7e-4_f64, 0.01_f64);
/// let sigmas = Vector3::repeat(density / dt.sqrt());
/// let rates = UncertainVector::from_sigmas(Vector3::new(0.0, 0.0, 0.5), &sigmas)?;
/// let sample = ImuSample::new(Stamp::from_seconds(3.0)).with_angular_velocity(rates);
/// let (rate, variance) = sample.yaw_rate().unwrap();
/// assert_eq!(rate, 0.5);
/// assert!((variance.sqrt() - 1.7e-3).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ImuSample {
    origin: Origin<Se3>,
    angular_velocity: Option<UncertainVector<3>>,
    specific_force: Option<UncertainVector<3>>,
    orientation: Option<UncertainPose<So3>>,
}

has_origin!(ImuSample, Se3);

impl ImuSample {
    /// A sample without any part yet, of the only unit, at the vehicle's origin.
    pub fn new(stamp: Stamp) -> Self {
        Self { origin: Origin::new(stamp), angular_velocity: None, specific_force: None, orientation: None }
    }

    /// The same sample with turn rates about the unit's axes, in radians per second.
    #[must_use]
    pub const fn with_angular_velocity(mut self, angular_velocity: UncertainVector<3>) -> Self {
        self.angular_velocity = Some(angular_velocity);
        self
    }

    /// The same sample with specific force along the unit's axes, in metres per second squared: acceleration less
    /// gravity, so that a unit at rest reads +9.81 upwards (`linear_acceleration` of ROS).
    #[must_use]
    pub const fn with_specific_force(mut self, specific_force: UncertainVector<3>) -> Self {
        self.specific_force = Some(specific_force);
        self
    }

    /// The same sample with the attitude that the unit itself makes of them: `world_from_sensor`, z up, with the
    /// covariance of its right increment in rad².
    #[must_use]
    pub const fn with_orientation(mut self, world_from_sensor: UncertainPose<So3>) -> Self {
        self.orientation = Some(world_from_sensor);
        self
    }

    /// Turn rates about the unit's axes, in radians per second.
    pub const fn angular_velocity(&self) -> Option<&UncertainVector<3>> {
        self.angular_velocity.as_ref()
    }

    /// Specific force along the unit's axes, in metres per second squared: acceleration less gravity.
    pub const fn specific_force(&self) -> Option<&UncertainVector<3>> {
        self.specific_force.as_ref()
    }

    /// Attitude `world_from_sensor`, z up.
    pub const fn orientation(&self) -> Option<&UncertainPose<So3>> {
        self.orientation.as_ref()
    }

    /// Turn rate about the vehicle's z axis, in radians per second, and its variance: what a vehicle on a floor needs.
    /// None without gyros.
    pub fn yaw_rate(&self) -> Option<(f64, f64)> {
        let row = self.origin.base_from_sensor.rotation().matrix().fixed_rows::<1>(2).into_owned();
        let about_z = self.angular_velocity?.transformed(&row);
        Some((about_z.mean().x, about_z.covariance().x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A unit mounted upside down and turned reads the yaw rate of the vehicle on its own axes.
    #[test]
    fn the_yaw_rate_is_the_vehicles() {
        let mount = Se3::from_parts(Vector3::new(0.1, 0.0, 0.3), So3::from_roll_pitch_yaw(0.5, -0.2, 1.0));
        let own = mount.rotation().matrix().transpose() * Vector3::new(0.1, -0.2, 0.7);
        let rates = UncertainVector::from_sigmas(own, &Vector3::repeat(0.02)).unwrap();
        let sample = ImuSample::new(Stamp::default()).with_angular_velocity(rates).with_mount(mount).unwrap();
        let (rate, variance) = sample.yaw_rate().unwrap();
        assert!((rate - 0.7).abs() < 1e-12 && (variance - 4e-4).abs() < 1e-15);
        assert_eq!(ImuSample::new(Stamp::default()).with_specific_force(rates).yaw_rate(), None);
        let nowhere = Se3::from_parts(Vector3::new(f64::NAN, 0.0, 0.0), So3::default());
        assert!(sample.with_mount(nowhere).is_err());
    }
}
