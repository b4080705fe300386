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

use agv_core::{
    geometry::{LieGroup, Se3},
    time::Stamp,
};

/// The motion so far, as much of it as the next cloud needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotionPrior {
    /// Pose and time of the last cloud.
    last: (Stamp, Se3),
    /// Motion between the last two clouds, and the seconds that it took (zero: not known).
    motion: (Se3, f64),
    /// Sum of `δ²` and the weight of its terms, later ones weighing more.
    square_sum: f64,
    weight: f64,
    initial_sigma: f64,
}

/// What a deviation's weight is multiplied with at every later one: some ten of them count.
const FADE: f64 = 0.9;

impl MotionPrior {
    /// At rest at the origin; `sigma` metres are taken for the first deviation.
    pub(crate) fn new(stamp: Stamp, sigma: f64) -> Self {
        Self {
            last: (stamp, Se3::identity()),
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

    /// Motion until `stamp`: as it was, scaled by the time where both times are known.
    pub(crate) fn motion_until(&self, stamp: Stamp) -> Se3 {
        let (motion, before) = self.motion;
        let now = self.seconds_to(stamp);
        // A gap of many cycles says nothing about where the vehicle went.
        if before > 0.0 && now > 0.0 && now < 10.0 * before {
            return Se3::exp(&(motion.log() * (now / before)));
        }
        motion
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
        self.motion = (self.last.1.between(pose), self.seconds_to(stamp));
        self.last = (stamp, *pose);
    }
}
