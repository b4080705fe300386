//! What a navigation says.

use super::Recovery;
use agv_core::{
    kinematics::Motion,
    roles::{BlockReason, NoPathReason},
};

/// What a navigation decided in one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavigationCommand {
    /// What to drive next; it respects the limits.
    pub motion: Motion,
    /// What it is for.
    pub status: NavigationStatus,
    /// Whether the map of the surroundings should be forgotten and seen anew: what stands in the way may have been seen wrongly.
    pub forget_map: bool,
    /// Whether a path was planned in this cycle.
    pub planned: bool,
}

/// How a navigation fares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum NavigationStatus {
    /// No goal.
    Idle,
    /// On the way.
    Following,
    /// Standing, or braking, for what is in the way.
    Waiting(BlockReason),
    /// Getting out of the way of what moves.
    Evading,
    /// Getting free.
    Recovering(Recovery),
    /// At the goal.
    Arrived,
    /// Standing for good: another goal, or the same once more, is the caller's decision.
    GaveUp(GiveUpReason),
}

/// Why a navigation gave up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum GiveUpReason {
    /// The global planner found no way.
    NoPath(NoPathReason),
    /// There is a way, and the local planner cannot go it.
    Blocked(BlockReason),
    /// Nothing is in the way, and still the vehicle does not get on.
    NoProgress,
}
