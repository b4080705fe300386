//! Where the next cloud is expected, and how far off that has been so far.
//!
//! Without odometry the vehicle is taken to go on as it went. How much this is worth is measured: with the deviation `(δR, δt)` of a
//! result from its prediction, a point at the range `r` was off by at most
//!
//! ```text
//! δ = 2 r sin(|δR| / 2) + |δt|            σ² = mean of δ²
//! ```
//!
//! which sets how far correspondences are looked for (Vizzo et al., *KISS-ICP*, 2023, section III-C, with the mean range of the points
//! instead of the sensor's greatest, and the latest deviations for the most part).
//!
//! Velocities are taken over intervals that are long enough: of two clouds of two lidars a millisecond apart, centimetres of noise would
//! make metres per second.

use agv_core::{
    geometry::{LieGroup, Se3},
    sensors::PointCloud,
    time::Stamp,
};
use nalgebra::Vector6;

/// The motion so far, as much of it as the next cloud needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotionPrior {
    /// Pose and time of the last cloud.
    last: (Stamp, Se3),
    /// Pose and time since which the motion has not been renewed: of the last cloud, or of one shortly before.
    since: (Stamp, Se3),
    /// The latest motion over an interval long enough, and the seconds that it took (zero: not known).
    motion: (Se3, f64),
    /// Sum of `δ²` and the weight of its terms, later ones weighing more.
    square_sum: f64,
    weight: f64,
    initial_sigma: f64,
}

/// What a deviation's weight is multiplied with at every later one: some ten of them count.
const FADE: f64 = 0.9;

/// Share of the last interval, and seconds, either of which make another long enough for a velocity.
const LONG_ENOUGH: (f64, f64) = (0.5, 0.04);

impl MotionPrior {
    /// At rest at the origin; `sigma` metres are taken for the first deviation.
    pub(crate) fn new(stamp: Stamp, sigma: f64) -> Self {
        Self {
            last: (stamp, Se3::identity()),
            since: (stamp, Se3::identity()),
            motion: (Se3::identity(), 0.0),
            square_sum: 0.0,
            weight: 0.0,
            initial_sigma: sigma,
        }
    }

    /// Pose of the last cloud.
    pub(crate) const fn pose(&self) -> Se3 {
        self.last.1
    }

    /// Seconds since the last cloud; zero if times are not known.
    pub(crate) fn seconds_to(&self, stamp: Stamp) -> f64 {
        (stamp - self.last.0).max(0.0)
    }

    /// Motion until `stamp`: as it was, scaled by the time where times are known; none for a cloud of the same time.
    pub(crate) fn motion_until(&self, stamp: Stamp) -> Se3 {
        let (motion, before) = self.motion;
        let now = self.seconds_to(stamp);
        // A gap of many cycles says nothing about where the vehicle went.
        if before > 0.0 && now < 10.0 * before {
            return Se3::exp(&(motion.log() * (now / before)));
        }
        motion
    }

    /// Velocity of the base, as [`Se3::log`] has it per second, if it is at `pose` at `stamp`; `None` if times are not known, or were too
    /// near to each other to tell of a `sweep` of so many seconds.
    pub(crate) fn velocity(&self, stamp: Stamp, pose: &Se3, sweep: f64) -> Option<Vector6<f64>> {
        let (motion, seconds) = self.renewed(stamp, pose).unwrap_or(self.motion);
        (seconds > 0.0 && seconds >= 0.5 * sweep).then(|| motion.log() / seconds)
    }

    /// The motion up to `pose` at `stamp` and its seconds, if they are enough.
    fn renewed(&self, stamp: Stamp, pose: &Se3) -> Option<(Se3, f64)> {
        let (seconds, (share, enough)) = ((stamp - self.since.0).max(0.0), LONG_ENOUGH);
        (seconds >= (share * self.motion.1).min(enough)).then(|| (self.since.1.between(pose), seconds))
    }

    /// Standard deviation of predictions at the points, in metres.
    pub(crate) fn sigma(&self) -> f64 {
        if self.weight > 0.0 { (self.square_sum / self.weight).sqrt() } else { self.initial_sigma }
    }

    /// Takes a result, which differs from its prediction; `range` is the mean of the points' ranges.
    pub(crate) fn learn(&mut self, predicted: &Se3, found: &Se3, range: f64) {
        let deviation = predicted.between(found);
        let angle = deviation.rotation().log().norm();
        let off = 2.0 * range * (0.5 * angle).sin() + deviation.translation().norm();
        self.square_sum = self.square_sum * FADE + off * off;
        self.weight = self.weight * FADE + 1.0;
    }

    /// Goes on from `pose`.
    pub(crate) fn advance(&mut self, stamp: Stamp, pose: &Se3) {
        if let Some(motion) = self.renewed(stamp, pose) {
            self.motion = motion;
            self.since = (stamp, *pose);
        } else if stamp < self.since.0 {
            // The clock was set back.
            self.since = (stamp, *pose);
        }
        self.last = (stamp, *pose);
    }
}

/// How far the motion in a sweep may differ from what a cloud was deskewed with, in metres at its points, before that is done again.
const SKEW: f64 = 0.02;

/// Whether the points of a `sweep` of so many seconds, at a mean `range`, are skewed if one velocity was taken for another.
pub(crate) fn is_skewed(taken: &Vector6<f64>, found: &Vector6<f64>, sweep: f64, range: f64) -> bool {
    let off = found - taken;
    sweep * (off.fixed_rows::<3>(0).norm() + range * off.fixed_rows::<3>(3).norm()) > SKEW
}

/// Greatest time of a cloud's points from its stamp, in seconds; zero without times. What is beyond a second is no sweep.
pub(crate) fn sweep(cloud: &PointCloud) -> f64 {
    let times = cloud.time().unwrap_or_default().iter().map(|time| time.abs());
    f64::from(times.filter(|time| *time <= 1.0).fold(0.0, f32::max))
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::So3;
    use nalgebra::Vector3;

    fn at(x: f64) -> Se3 {
        Se3::from_parts(Vector3::new(x, 0.0, 0.0), So3::default())
    }

    #[test]
    fn two_lidars_a_millisecond_apart_do_not_spoil_the_velocity() {
        let stamp = Stamp::from_seconds;
        let mut prior = MotionPrior::new(stamp(0.0), 2.0);
        for i in 1..30_i32 {
            // Each second lidar finds the vehicle 3 cm off.
            let (cycle, second) = (f64::from(i / 2), i % 2 == 1);
            let (time, error) = if second { (0.1 * cycle + 0.001, 0.03) } else { (0.1 * cycle, 0.0) };
            if i > 4 {
                let predicted = prior.pose().compose(&prior.motion_until(stamp(time))).translation().x;
                assert!((predicted - 2.0 * time).abs() < 0.07, "{i}: {predicted} at {time}");
                let velocity = prior.velocity(stamp(time), &at(2.0 * time + error), 0.1).unwrap().x;
                assert!((velocity - 2.0).abs() < 0.7, "{i}: {velocity}");
            }
            prior.advance(stamp(time), &at(2.0 * time + error));
        }
        let last = prior.last.0;
        assert_eq!(prior.motion_until(last), Se3::identity(), "no time, no motion");
        // After a gap the velocity is that of the next interval, not of the gap for long.
        prior.advance(last + 30.0, &at(5.0));
        prior.advance(last + 30.1, &at(5.1));
        assert!((prior.motion_until(last + 30.2).translation().x - 0.1).abs() < 1e-9);
    }

    #[test]
    fn without_times_a_motion_goes_on_and_gives_no_velocity() {
        let (stamp, mut prior) = (Stamp::default(), MotionPrior::new(Stamp::default(), 2.0));
        prior.advance(stamp, &at(0.3));
        assert!((prior.motion_until(stamp).translation().x - 0.3).abs() < 1e-12);
        assert!(prior.velocity(stamp, &at(0.6), 0.0).is_none());
        // The second of two clouds that begin a drive is too near to the first to say how fast it is.
        let mut prior = MotionPrior::new(stamp, 2.0);
        assert!(prior.velocity(stamp + 0.001, &at(0.03), 0.1).is_none());
        prior.advance(stamp + 1.0, &at(1.0));
        prior.advance(stamp + 0.5, &at(1.0));
        prior.advance(stamp + 0.6, &at(1.2));
        assert!((prior.motion_until(stamp + 0.7).translation().x - 0.2).abs() < 1e-9, "clock set back");
    }
}
