//! The motion between two moments, with its uncertainty.

use crate::{
    Error,
    geometry::{LieGroup, Se2, Se3},
    time::Stamp,
};
use nalgebra::Matrix6;

/// A relative motion of the base, as odometry reports it: all that a localizer needs to know of wheels, gyros or lidars.
///
/// The planar one is [`OdometryIncrement`]; `MotionIncrement::<Se3>::from(&planar)` lifts it onto the floor of space.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, Se3};
/// use agv_core::odometry::{MotionIncrement, OdometryIncrement};
/// use agv_core::time::Stamp;
///
/// // Two poses of a wheel odometer, half a second apart.
/// let (a, b) = (Se2::new(1.0, 0.0, 0.1), Se2::new(1.4, 0.05, 0.15));
/// let motion = OdometryIncrement::between(Stamp::from_seconds(3.0), &a, Stamp::from_seconds(3.5), &b)?;
/// assert_eq!(motion.dt(), 0.5);
/// let in_space = MotionIncrement::<Se3>::from(&motion);
/// assert!((in_space.start_from_end.to_planar().minus(&motion.start_from_end)).norm() < 1e-12);
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
pub struct MotionIncrement<G: LieGroup> {
    /// When the motion began.
    pub start: Stamp,
    /// When it ended. Logs of real vehicles have ends before starts: consumers that need `dt` say what they do then.
    pub end: Stamp,
    /// Pose of the base at the end in the base frame of the start.
    pub start_from_end: G,
    /// Covariance of the right increment of `start_from_end`, that is in the base frame of the end, translation first
    /// (m², m rad, rad²); zero where the odometry does not know its own noise, and the consumer's motion model states it.
    pub covariance: G::Matrix,
}

/// A motion in the plane, as wheels and gyros report it.
pub type OdometryIncrement = MotionIncrement<Se2>;

impl<G: LieGroup> MotionIncrement<G> {
    /// The motion between two poses in the odometry frame, without a noise of its own.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if either pose is not finite.
    pub fn between(start: Stamp, odom_from_start: &G, end: Stamp, odom_from_end: &G) -> Result<Self, Error> {
        check_pose("odometry pose", odom_from_start)?;
        check_pose("odometry pose", odom_from_end)?;
        let covariance = G::identity_matrix() * 0.0;
        Ok(Self { start, end, start_from_end: odom_from_start.between(odom_from_end), covariance })
    }

    /// Duration in seconds; negative where the log's stamps step backwards.
    pub fn dt(&self) -> f64 {
        self.end - self.start
    }

    /// Whether motion and covariance are finite.
    pub fn is_finite(&self) -> bool {
        self.start_from_end.is_finite() && G::matrix_slice(&self.covariance).iter().all(|v| v.is_finite())
    }
}

/// Refuses a pose that is not finite.
pub(super) fn check_pose<G: LieGroup>(name: &'static str, pose: &G) -> Result<(), Error> {
    if pose.is_finite() {
        return Ok(());
    }
    let value = G::tangent_slice(&pose.log()).iter().copied().find(|v| !v.is_finite()).unwrap_or(f64::NAN);
    Err(Error::NotFinite { name, value })
}

impl From<&OdometryIncrement> for MotionIncrement<Se3> {
    /// The motion on the floor: z, roll and pitch do not change, with a variance of zero.
    ///
    /// A filter that is to let them drift adds a process noise of its own.
    fn from(planar: &OdometryIncrement) -> Self {
        // (x, y, yaw) among (x, y, z, rx, ry, rz).
        const ROWS: [usize; 3] = [0, 1, 5];
        let mut covariance = Matrix6::zeros();
        for (i, &row) in ROWS.iter().enumerate() {
            for (j, &column) in ROWS.iter().enumerate() {
                covariance[(row, column)] = planar.covariance[(i, j)];
            }
        }
        Self { start: planar.start, end: planar.end, start_from_end: planar.start_from_end.into(), covariance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// Lifting and composing commute, so a filter in space may gather planar increments or lifted ones.
    #[test]
    fn lifting_keeps_compositions() {
        let spread = Matrix3::new(2.0, 0.3, 0.1, 0.3, 1.0, 0.2, 0.1, 0.2, 0.5) * 0.01;
        let at = |t: f64, pose| OdometryIncrement {
            start: Stamp::from_seconds(t),
            end: Stamp::from_seconds(t + 0.1),
            start_from_end: pose,
            covariance: spread,
        };
        let (a, b) = (at(0.0, Se2::new(0.5, 0.1, 0.7)), at(0.1, Se2::new(-0.2, 0.3, -2.9)));
        let lifted = MotionIncrement::<Se3>::from(&a.then(&b).unwrap());
        let joined = MotionIncrement::<Se3>::from(&a).then(&(&b).into()).unwrap();
        assert!(lifted.start_from_end.minus(&joined.start_from_end).norm() < 1e-12);
        assert!((lifted.covariance - joined.covariance).norm() < 1e-12, "{}", lifted.covariance - joined.covariance);
        assert_eq!((joined.start, joined.end), (a.start, b.end));
    }

    #[test]
    fn poses_that_are_not_finite_are_refused() {
        let now = Stamp::default();
        for bad in [f64::NAN, f64::INFINITY] {
            let nowhere = Se3::from(Se2::new(bad, 0.0, 0.0));
            assert!(MotionIncrement::between(now, &nowhere, now, &Se3::identity()).is_err());
            assert!(MotionIncrement::between(now, &Se3::identity(), now, &nowhere).is_err());
        }
    }
}
