//! A motion as a rotation, a straight line and a second rotation.
//!
//! ```text
//! rot1 = atan2(y, x)        trans = |(x, y)|        rot2 = yaw - rot1
//! ```
//!
//! for the pose `(x, y, yaw)` of the end in the frame of the start (Thrun, Burgard and Fox 2005, Table 5.6; paper 001,
//! Eqs. 2–3, with `atan2` for its printed arctan²). The motion models state their noise in these three numbers.

use crate::geometry::{Se2, wrap_angle};
use std::f64::consts::PI;

/// Rotation, translation, rotation.
///
/// A vehicle that backs up does not turn around first: of the two ways to make a motion, forwards and backwards, the
/// one that turns less is taken, and `translation` is negative for the second.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::odometry::RotTransRot;
///
/// let back = RotTransRot::from_motion(&Se2::new(-0.3, 0.0, 0.1));
/// assert!(back.rotation1.abs() < 1e-12 && (back.translation + 0.3).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RotTransRot {
    /// Turn at the start, in radians, in (-π, π].
    pub rotation1: f64,
    /// Distance along the new heading, in metres; negative backwards.
    pub translation: f64,
    /// Turn at the end, in radians, in (-π, π].
    pub rotation2: f64,
}

impl RotTransRot {
    /// Translations below this say nothing of their direction, in metres: encoders and gyros jitter by less.
    pub const STANDING: f64 = 1e-3;

    /// The decomposition of `start_from_end`; see [`from_motion_above`](Self::from_motion_above) for a standing vehicle.
    /// A motion that is not finite gives parts that are not: an odometry increment is checked before.
    pub fn from_motion(start_from_end: &Se2) -> Self {
        Self::from_motion_above(start_from_end, Self::STANDING)
    }

    /// The decomposition of `start_from_end`. A translation shorter than `standing` metres has no direction that could
    /// be trusted: `rotation1` is then zero, and `translation` is what was moved along x.
    pub fn from_motion_above(start_from_end: &Se2, standing: f64) -> Self {
        let (x, y, yaw) = (start_from_end.x(), start_from_end.y(), start_from_end.yaw());
        let distance = x.hypot(y);
        if distance < standing {
            return Self { rotation1: 0.0, translation: x, rotation2: wrap_angle(yaw) };
        }
        let heading = y.atan2(x);
        let branch = |rotation1: f64, translation| Self {
            rotation1: wrap_angle(rotation1),
            translation,
            rotation2: wrap_angle(yaw - rotation1),
        };
        let (forwards, backwards) = (branch(heading, distance), branch(heading + PI, -distance));
        if backwards.turning() < forwards.turning() { backwards } else { forwards }
    }

    /// The motion that these three steps make.
    pub fn to_motion(&self) -> Se2 {
        let (sin, cos) = self.rotation1.sin_cos();
        Se2::new(self.translation * cos, self.translation * sin, self.rotation1 + self.rotation2)
    }

    /// Sum of both turns, in radians.
    pub fn turning(&self) -> f64 {
        self.rotation1.abs() + self.rotation2.abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::LieGroup;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn recomposition_undoes_decomposition(x in -2.0..2.0_f64, y in -2.0..2.0_f64, yaw in -3.2..3.2_f64) {
            prop_assume!(x.hypot(y) >= RotTransRot::STANDING);
            let motion = Se2::new(x, y, yaw);
            let parts = RotTransRot::from_motion(&motion);
            prop_assert!(parts.to_motion().minus(&motion).norm() < 1e-12);
            // The other branch turns by π - |r| each, so the better one never turns by more than π in all.
            prop_assert!(parts.turning() <= PI + 1e-12, "{:?}", parts);
        }

        /// A motion and the same one backwards turn by the same amounts.
        #[test]
        fn reverse_motion_mirrors_forward_motion(d in 0.01..2.0_f64, r1 in -0.7..0.7_f64, r2 in -0.7..0.7_f64) {
            let forwards = RotTransRot { rotation1: r1, translation: d, rotation2: r2 };
            let backwards = RotTransRot { translation: -d, ..forwards };
            for parts in [forwards, backwards] {
                let back = RotTransRot::from_motion(&parts.to_motion());
                prop_assert!((back.rotation1 - r1).abs() < 1e-9 && (back.rotation2 - r2).abs() < 1e-9);
                prop_assert!((back.translation - parts.translation).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_standing_vehicle_does_not_turn_towards_its_jitter() {
        let parts = RotTransRot::from_motion(&Se2::new(1e-5, -3e-4, 0.2));
        assert_eq!(
            parts,
            RotTransRot { rotation1: 0.0, translation: 1e-5, rotation2: 0.2_f64.sin().atan2(0.2_f64.cos()) }
        );
        assert_eq!(RotTransRot::from_motion(&Se2::default()), RotTransRot::default());
    }
}
