//! What a search that goes on over several updates has found so far.

use agv_core::geometry::Se2;

/// The state of a [`LikelihoodSearch`](super::LikelihoodSearch) between two updates, to store and to resume from.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SearchState {
    /// The update with which it goes on; with another one it begins anew.
    pub(super) next_update: u64,
    /// Candidates that were tried.
    pub(super) tried: u64,
    /// The base at the last update, in the frame that the odometry is summed up in.
    pub(super) odom_from_base: Se2,
    /// What was found, by falling likelihood.
    pub(super) places: Vec<Place>,
}

/// A pose that is worth a closer look.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Place {
    pub(super) pose: Se2,
    /// How often it was refined.
    pub(super) rounds: u32,
}
