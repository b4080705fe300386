//! What the filter says: the estimate, what became of a measurement, and how each source fares.

use agv_core::{
    geometry::{Se2, Twist2, UncertainPose},
    time::Stamp,
};
use nalgebra::{Matrix3, Vector2};

/// What the filter believes at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusedState {
    /// The time that it refers to.
    pub stamp: Stamp,
    /// Pose `map_from_base` with the covariance of its right increment.
    pub pose: UncertainPose<Se2>,
    /// Velocity in the base frame.
    pub twist: Twist2,
    /// Covariance of the velocity (m/s, m/s, rad/s).
    pub twist_covariance: Matrix3<f64>,
    /// Acceleration along the axes of the base, in m/s²; zero where it is not estimated.
    pub acceleration: Vector2<f64>,
    /// Bias of the gyro and its standard deviation, in rad/s.
    pub gyro_bias: (f64, f64),
    /// Share by which ways are longer than the wheels say, and its standard deviation.
    pub distance_scale: (f64, f64),
    /// Share by which turns are greater than the wheels say, and its standard deviation.
    pub yaw_scale: (f64, f64),
    /// By how much the measurements of the source that is [`late`](super::SourceParams::late) are older than its latency says, and the
    /// standard deviation of that, in seconds.
    pub latency: (f64, f64),
}

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum FusionOutcome {
    /// The belief has taken it in, at its own time.
    Applied {
        /// Normalised innovation squared.
        nis: f64,
        /// Numbers of the measurement that count.
        degrees: usize,
    },
    /// It contradicts the belief beyond the gate.
    Gated {
        /// Normalised innovation squared.
        nis: f64,
        /// The gate.
        limit: f64,
    },
    /// It became the reference of those that follow: the first of a source whose measurements refer to one another, or one after
    /// a gap from before the history.
    Anchored,
    /// A motion that began before the last one of its source ended: a part of it has been taken in already, so that it is left out.
    /// For motions that all begin at one key frame take their poses, with [`Reference::First`](super::Reference::First).
    Overlapping,
    /// Older than the history reaches.
    TooOld,
    /// Further ahead of all others than a gap may last.
    TooEarly,
    /// There was a measurement of this source with this very stamp.
    Duplicate,
    /// Its covariance and the belief's leave nothing to weigh by.
    Degenerate,
}

/// How a source fares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceDiagnostics {
    /// Measurements that the belief has taken in.
    pub accepted: u64,
    /// Measurements beyond the gate.
    pub gated: u64,
    /// Measurements beyond the gate since the last one that was taken in.
    pub gated_in_a_row: u32,
    /// Measurements that came too late, too early or twice, and motions that overlapped.
    pub dropped: u64,
    /// Mean normalised innovation squared of the accepted ones; none before the first.
    pub nis_mean: Option<f64>,
    /// The same per number that counted: one if the source is as noisy as it says, more if it is noisier (or the vehicle
    /// is less steady than the parameters say), less if it is quieter.
    pub consistency: Option<f64>,
    /// Latest time of which there was a measurement.
    pub last: Option<Stamp>,
}
