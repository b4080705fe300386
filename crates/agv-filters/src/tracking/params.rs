//! What a tracker believes of the things around it.

use super::ClusterParams;
use agv_core::{Error, check};

/// Parameters of an [`ObstacleTracker`](super::ObstacleTracker).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TrackerParams {
    /// How a scan falls into clusters.
    pub clusters: ClusterParams,
    /// Greatest extent of what is tracked, in metres: more is a wall, or several things that look like one.
    pub max_extent: f64,
    /// Standard deviation of a surface's points around a disc or hull, in metres; the scanner's noise is part of it.
    pub surface_sigma: f64,
    /// Change of a velocity within a second, one standard deviation, in metres per second.
    pub wander: f64,
    /// Standard deviation of the velocity of something new, in metres per second.
    pub initial_speed_sigma: f64,
    /// Probability with which a cluster of the right track passes its gate.
    pub gate_probability: f64,
    /// Scans that must show something until it may count as moving.
    pub confirm_hits: u32,
    /// Time for which something is expected where nothing was seen of it, in seconds.
    pub coast_time: f64,
    /// Least speed of what moves, in metres per second.
    pub min_speed: f64,
    /// Confidence with which a velocity must differ from zero.
    pub speed_confidence: f64,
    /// By how much earlier beams must have passed a point, beside and beyond it, until it was free, in metres; 1 % of the
    /// distance is added. It covers the error of the pose over [`memory`](Self::memory).
    pub free_margin: f64,
    /// How far earlier scans are remembered, in seconds.
    pub memory: f64,
    /// Distance from a static map's obstacles within which a hit is explained by them, in metres.
    pub map_tolerance: f64,
}

impl Default for TrackerParams {
    /// People, carts and vehicles of up to 2.5 m among poles and walls, of 0.15 to about 3 m/s, seen by a scanner of 10 to
    /// 40 Hz from a vehicle whose odometry drifts by 1 %: a velocity changes by half a metre per second within one, gates at
    /// 99.9 %, three scans to confirm, and a second of foresight, as a pillar of 0.5 m hides who walks behind it.
    fn default() -> Self {
        Self {
            clusters: ClusterParams::default(),
            max_extent: 2.5,
            surface_sigma: 0.02,
            wander: 0.5,
            initial_speed_sigma: 1.5,
            gate_probability: 0.999,
            confirm_hits: 3,
            coast_time: 1.0,
            min_speed: 0.15,
            speed_confidence: 0.95,
            free_margin: 0.1,
            memory: 0.8,
            map_tolerance: 0.15,
        }
    }
}

impl TrackerParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        for (name, value) in [
            ("max_extent", self.max_extent),
            ("surface_sigma", self.surface_sigma),
            ("initial_speed_sigma", self.initial_speed_sigma),
            ("coast_time", self.coast_time),
            ("memory", self.memory),
            ("map_tolerance", self.map_tolerance),
        ] {
            check::positive(name, value)?;
        }
        check::non_negative("wander", self.wander)?;
        check::non_negative("min_speed", self.min_speed)?;
        check::non_negative("free_margin", self.free_margin)?;
        check::open_probability("gate_probability", self.gate_probability)?;
        check::open_probability("speed_confidence", self.speed_confidence)?;
        check::in_range("confirm_hits", f64::from(self.confirm_hits), 1.0, 1e6)?;
        Ok(())
    }
}
