//! Ant colonies on grids (paper 002): the traditional one, the improved one, and the ladder between them.

mod ant;
mod colony;
mod detours;
mod flood;
mod history;
mod params;
mod schedule;
mod sight;
mod trail;

pub use ant::DeadEnd;
pub use colony::{AntColony, Colony};
pub use history::{Iteration, Run};
pub use params::ColonyParams;
pub use schedule::{Greed, Schedule};
pub use sight::{GoalDistance, Sight};
pub use trail::{Deposit, TrailLimits};
