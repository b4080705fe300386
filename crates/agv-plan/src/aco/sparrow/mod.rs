//! Sparrow search on grids: a swarm to compare ant colonies with.
//!
//! Paper 002 compares with an improved sparrow search (its reference [34]: Zhang, He and Yang, *A bioinspired path planning
//! approach for mobile robots based on improved sparrow search algorithm*, 2022), whose text is not at hand. This is its class:
//! the sparrow search of Xue and Shen (2020) over ways across the map, with the three additions that the abstract of [34]
//! names: ways are straightened ("linear path strategy"), the best one is improved by a search around it, and the
//! update of positions is another one.
//!
//! A position is a row per column between start and goal (or a column per row, along the longer way), as an offset from the
//! straight line. The way follows the columns; in each it leaves through the open cell nearest to the position's row, among
//! those from which the goal can still be reached without turning back, and is then straightened by sight. A way that has to
//! turn back along the axis is not among them: where there is no other, the search ends with [`SearchEnd::Budget`].
//!
//! [`SearchEnd::Budget`]: crate::grid::SearchEnd::Budget

mod corridor;
mod swarm;

pub use swarm::{SparrowSearch, Swarm};

use crate::Error;
use agv_core::check;

/// A sparrow search's make.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SparrowParams {
    /// Sparrows.
    pub sparrows: usize,
    /// Iterations of a run.
    pub iterations: usize,
    /// Part of the sparrows that lead, 0 to 1.
    pub producers: f64,
    /// Part of the sparrows that watch for danger, 0 to 1.
    pub scouts: f64,
    /// Alarm below which the producers forage in peace, 0 to 1.
    pub safety: f64,
    /// Trials around the best way in an iteration; zero for the original algorithm.
    pub trials: usize,
    /// Whether hungry sparrows fly to somewhere around the best one (the addition) or anywhere (the original).
    pub gather: bool,
}

impl Default for SparrowParams {
    /// [`SparrowParams::improved`].
    fn default() -> Self {
        Self::improved()
    }
}

impl SparrowParams {
    /// Near the original, without the additions: a fifth leads, a fifth watches, alarm at 0.8 (Xue and Shen 2020); 50 sparrows and 100 iterations, as the
    /// colonies it is compared with. Followers look at the best way of the run, where Xue and Shen's look at the best producer of
    /// the iteration, and the step of the best sparrow's scouts is not divided by the difference of the lengths.
    pub const fn original() -> Self {
        Self { sparrows: 50, iterations: 100, producers: 0.2, scouts: 0.2, safety: 0.8, trials: 0, gather: false }
    }

    /// With the additions: ten trials around the best way, and gathering.
    pub const fn improved() -> Self {
        Self { trials: 10, gather: true, ..Self::original() }
    }

    fn check(&self) -> Result<(), Error> {
        check::at_least("sparrows", self.sparrows, 2)?;
        check::at_least("iterations", self.iterations, 1)?;
        for (name, len) in [("sparrows", self.sparrows), ("trials", self.trials)] {
            if len > Self::MAX {
                return Err(agv_core::Error::TooMany { name, len, max: Self::MAX }.into());
            }
        }
        if self.iterations > Self::MAX {
            return Err(agv_core::Error::TooMany { name: "iterations", len: self.iterations, max: Self::MAX }.into());
        }
        check::in_range("producers", self.producers, 0.0, 1.0)?;
        check::in_range("scouts", self.scouts, 0.0, 1.0)?;
        check::in_range("safety", self.safety, 0.0, 1.0)?;
        Ok(())
    }

    /// Most sparrows, trials and iterations.
    pub const MAX: usize = 1 << 16;
}
