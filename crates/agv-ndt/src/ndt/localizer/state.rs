//! What an initialised localizer knows: its belief, and the track of the last second.

use agv_core::{
    geometry::{LieGroup, Se3},
    odometry::MotionIncrement,
    roles::PoseEstimate,
    sensors::SensorId,
    time::Stamp,
};

/// What an initialised localizer knows.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct State {
    pub(super) belief: PoseEstimate<Se3>,
    /// Whether the vehicle may be anywhere in the map.
    pub(super) anywhere: bool,
    /// Clouds in a row that did not fit.
    pub(super) misses: u32,
    /// Poses in the odometry's frame at the ends of the last motions.
    pub(super) track: Vec<(Stamp, Se3)>,
    /// The last cloud that each sensor had applied.
    pub(super) applied: Vec<(SensorId, Stamp)>,
}

impl State {
    /// Adds the end of a motion to the track, and forgets what is older than `history` seconds.
    pub(super) fn remember(&mut self, odometry: &MotionIncrement<Se3>, history: f64) {
        let last = self.track.last().copied();
        let (newest, odom_from_start) = last.unwrap_or((odometry.start, Se3::identity()));
        if odometry.end < odometry.start.max(newest) {
            // The clock stepped back: what was before lies in no order with it.
            self.track.clear();
            self.track.push((odometry.end, Se3::identity()));
            return;
        }
        if last.is_none() || odometry.start > newest {
            // The first motion, or one after a gap in which nothing is known to have moved.
            self.track.push((odometry.start, odom_from_start));
        }
        let odom_from_end = odom_from_start.compose(&odometry.start_from_end);
        match self.track.last_mut() {
            // No time has passed, but the vehicle has moved.
            Some((stamp, pose)) if *stamp == odometry.end => *pose = odom_from_end,
            _ => self.track.push((odometry.end, odom_from_end)),
        }
        let old = self.track.partition_point(|(stamp, _)| odometry.end - *stamp > history);
        // One before the history stays, so that all of it lies between two poses.
        self.track.drain(..old.saturating_sub(1));
    }
}
