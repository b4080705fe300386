//! How far a vehicle has been from a place, as opposed to how far it is from there now.
//!
//! A vehicle that comes by a code once a lap is each time where it was when it saw the code last: the motion between the two looks
//! is none, the way between them is a lap. What it has been away at most says that, and unlike the length of the way it does not
//! grow while a vehicle stands and its odometry trembles.

use agv_core::geometry::{LieGroup, Se2};

/// The way since a place, by the odometry.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Excursion {
    /// The base at the place, in the frame that the odometry is summed up in.
    odom_from_base: Se2,
    /// Greatest distance from there so far, in metres.
    distance: f64,
    /// Greatest turn from there so far, in radians.
    angle: f64,
}

impl Excursion {
    /// Begins at this place.
    pub(super) const fn from(odom_from_base: Se2) -> Self {
        Self { odom_from_base, distance: 0.0, angle: 0.0 }
    }

    /// The vehicle is here now.
    pub(super) fn reached(&mut self, odom_from_base: &Se2) {
        let motion = self.motion_to(odom_from_base);
        self.distance = self.distance.max(motion.translation().norm());
        self.angle = self.angle.max(motion.yaw().abs());
    }

    /// The base here, in the base frame of then.
    pub(super) fn motion_to(&self, odom_from_base: &Se2) -> Se2 {
        self.odom_from_base.between(odom_from_base)
    }

    /// Greatest distance and turn so far, in metres and radians.
    pub(super) const fn farthest(&self) -> (f64, f64) {
        (self.distance, self.angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn a_lap_leads_back_and_has_been_far() {
        let lap = |steps: u32, radius: f64| {
            let step = Se2::new(TAU * radius / f64::from(steps), 0.0, TAU / f64::from(steps));
            let (mut here, start) = (Se2::new(3.0, -1.0, 2.0), Se2::new(3.0, -1.0, 2.0));
            let mut way = Excursion::from(start);
            for _ in 0..steps {
                here = here * step;
                way.reached(&here);
            }
            (way.motion_to(&here), way.farthest())
        };
        let (motion, (distance, angle)) = lap(3600, 2.0);
        assert!(motion.translation().norm() < 0.02 && motion.yaw().abs() < 0.01, "{motion:?}");
        assert!((distance - 4.0).abs() < 0.01 && (angle - PI).abs() < 0.01, "{distance} {angle}");
        // On the spot: a turn alone.
        let (_, (distance, angle)) = lap(100, 0.0);
        assert!(distance == 0.0 && (angle - PI).abs() < 0.1);
    }

    #[test]
    fn odometry_that_trembles_leads_nowhere() {
        let mut way = Excursion::from(Se2::identity());
        for i in 0..10_000 {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            way.reached(&Se2::new(sign * 1e-3, 0.0, sign * 1e-3));
        }
        let (distance, angle) = way.farthest();
        assert!(distance <= 1.001e-3 && angle <= 1.001e-3);
    }
}
