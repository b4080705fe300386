//! When a search ends, and why it did.

use agv_core::{Error, check};

/// When a search ends: at whichever comes first.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Stopping {
    /// Most evaluations of the objective; a generation that would pass it is not begun.
    pub max_evaluations: usize,
    /// Most generations.
    pub max_iterations: usize,
    /// A cost that is good enough. The least number for none.
    pub target: f64,
    /// Generations without a lower cost after which the search is given up; zero for never.
    pub stall_iterations: usize,
    /// The search has converged when it is spread over less than this part of the space; zero turns the test off.
    pub min_spread: f64,
}

impl Default for Stopping {
    /// The budget of paper 000, 20 particles over 100 iterations, and nothing else.
    fn default() -> Self {
        Self {
            max_evaluations: 2000,
            max_iterations: usize::MAX,
            target: f64::MIN,
            stall_iterations: 0,
            min_spread: 0.0,
        }
    }
}

impl Stopping {
    pub(super) fn check(&self) -> Result<(), Error> {
        check::finite("target", self.target)?;
        check::non_negative("min_spread", self.min_spread)?;
        Ok(())
    }
}

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Termination {
    /// A cost as low as was asked for.
    Target,
    /// The candidates have come together.
    Converged,
    /// No lower cost for as long as was allowed.
    Stalled,
    /// Another generation would have passed the number of evaluations that was allowed.
    MaxEvaluations,
    /// As many generations as were allowed.
    MaxIterations,
}
