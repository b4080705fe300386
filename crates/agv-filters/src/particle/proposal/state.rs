//! What a search that goes on over several updates has found so far.

use super::ProposalContext;
use agv_core::geometry::Se2;

/// The state of a [`LikelihoodSearch`](super::LikelihoodSearch) between two updates, to store and to resume from.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SearchState {
    /// The belief that was searched for ([`ProposalContext::belief`]); in another one it begins anew.
    pub(super) belief: u64,
    /// The update with which it goes on; with another one it begins anew.
    pub(super) next_update: u64,
    /// Candidates that were tried.
    pub(super) tried: u64,
    /// The base at the last update, in the frame that the odometry is summed up in.
    pub(super) odom_from_base: Se2,
    /// What was found, by falling likelihood.
    pub(super) places: Vec<Place>,
}

impl SearchState {
    /// Whether it is this update that the search goes on with.
    pub(super) const fn goes_on_with(&self, context: &ProposalContext<'_>) -> bool {
        self.belief == context.belief && self.next_update == context.updates
    }

    /// The search is to go on with the update after this one.
    pub(super) const fn goes_on_after(&mut self, context: &ProposalContext<'_>) {
        self.belief = context.belief;
        self.next_update = context.updates.wrapping_add(1);
        self.odom_from_base = context.odom_from_base;
    }
}

/// A pose that is worth a closer look.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Place {
    pub(super) pose: Se2,
    /// How often it was refined.
    pub(super) rounds: u32,
}
