//! The crate's one error type.

/// Why a planner's parameters or inputs were refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value was refused.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
    /// The heuristic overestimates under the chosen connectivity, so that paths would not be optimal.
    #[error("heuristic {heuristic} overestimates where diagonal steps are allowed")]
    InconsistentHeuristic {
        /// Its name.
        heuristic: &'static str,
    },
    /// The planner knows lengths only, not costs of cells.
    #[error("{planner} takes no cost weight, got {cost_weight}")]
    UniformCostsOnly {
        /// Its name.
        planner: &'static str,
        /// What was given.
        cost_weight: f64,
    },
    /// A node index is not one of the search space.
    #[error("node {node} does not belong to a space of {len} nodes")]
    NoSuchNode {
        /// What was given.
        node: u32,
        /// Nodes of the space.
        len: usize,
    },
}
