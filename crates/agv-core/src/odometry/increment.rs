//! The motion between two moments, with its uncertainty.

use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
    time::Stamp,
};
use nalgebra::Matrix3;

/// A relative motion of the base, as odometry reports it: all that a localizer needs to know of wheels and gyros.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::time::Stamp;
///
/// // Two poses of a wheel odometer, half a second apart.
/// let (a, b) = (Se2::new(1.0, 0.0, 0.1), Se2::new(1.4, 0.05, 0.15));
/// let motion = OdometryIncrement::between(Stamp::from_seconds(3.0), &a, Stamp::from_seconds(3.5), &b)?;
/// assert_eq!(motion.dt(), 0.5);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OdometryIncrement {
    /// When the motion began.
    pub start: Stamp,
    /// When it ended. Logs of real vehicles have ends before starts: consumers that need `dt` say what they do then.
    pub end: Stamp,
    /// Pose of the base at the end in the base frame of the start.
    pub start_from_end: Se2,
    /// Covariance of `start_from_end` over `(x, y, yaw)` in the base frame of the end, in m², m rad and rad²; zero
    /// where the odometry does not know its own noise, and the consumer's motion model states it.
    pub covariance: Matrix3<f64>,
}

impl OdometryIncrement {
    /// The motion between two poses in the odometry frame, without a noise of its own.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if either pose is not finite.
    pub fn between(start: Stamp, odom_from_start: &Se2, end: Stamp, odom_from_end: &Se2) -> Result<Self, Error> {
        for pose in [odom_from_start, odom_from_end] {
            check::all_finite("odometry pose", &[pose.x(), pose.y(), pose.yaw()])?;
        }
        Ok(Self { start, end, start_from_end: odom_from_start.between(odom_from_end), covariance: Matrix3::zeros() })
    }

    /// Duration in seconds; negative where the log's stamps step backwards.
    pub fn dt(&self) -> f64 {
        self.end - self.start
    }

    /// Whether motion and covariance are finite.
    pub fn is_finite(&self) -> bool {
        self.start_from_end.is_finite() && self.covariance.iter().all(|v| v.is_finite())
    }
}
