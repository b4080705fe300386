//! What a colony tells of its iterations.

/// One iteration. Lengths are in cells and infinite where no ant arrived.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Iteration {
    /// Length of its shortest way.
    pub best: f64,
    /// Mean length of its ways.
    pub mean: f64,
    /// Length of its longest way.
    pub worst: f64,
    /// Ants that arrived.
    pub arrived: usize,
    /// Length of the shortest way of the run so far.
    pub best_so_far: f64,
}

/// What became of a run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Run {
    /// Length of the shortest way, in cells, if an ant arrived.
    pub length: Option<f64>,
    /// Turns of that way.
    pub turns: usize,
    /// Iteration that found it, counted from 1; zero if none did. The paper's "number of iterations".
    pub converged: usize,
    /// Iterations that were run.
    pub iterations: usize,
    /// Ants that were sent and ants that arrived.
    pub sent: u64,
    /// Ants that arrived.
    pub arrived: u64,
    /// Steps that all ants took, those back included.
    pub steps: u64,
}
