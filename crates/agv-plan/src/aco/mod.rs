//! Ant colonies on grids: the traditional one, the improved one of paper 002 (Xiao et al., *Multiobjective path optimization
//! of an indoor AGV based on an improved ACO-DWA*, MBE 2022), and the ladder of experiments between them.
//!
//! ```text
//! for every iteration:  α, β, q₀ of this iteration            Schedule, Greed     Eqs. 8, 9
//!                       weight of a step = τ^α η^β            Sight               Eqs. 1, 5, 6
//!                       every ant walks to the goal           DeadEnd             Eqs. 1, 7
//!                       τ evaporates, ants leave pheromone    Deposit, TrailLimits   Eqs. 2-4, 10-17
//! ```
//!
//! [`ColonyParams`] composes the parts, one constructor per rung of the ladder. What is lost or missing in print is an option
//! whose default is said to be one: the radical of Eq. 5 ([`GoalDistance`]), the exponent of Eq. 9 ([`Schedule`]), dead ends
//! ([`DeadEnd`]), the least pheromone ([`TrailLimits`]), the first one. Additions to the paper are off in its presets
//! and on in [`ColonyParams::refined`].
//!
//! [`SparrowSearch`] is another swarm to compare with (the class of the paper's reference 34).
//!
//! A colony is a heuristic: it may miss the shortest path, which A* finds in a hundredth of the time. It is here to be compared
//! with, and for its parts.
//!
//! Each ant of each iteration has its own random stream, and pheromone is left in the order of the ants: the result has the
//! same bits for any number of threads. An iteration takes time in proportion to the steps of its ants and the cells of the
//! map, memory some hundred bytes per cell, and two more per cell and squad of eight ants, or ten where detours are erased.
//! Nothing is allocated after the first query of a size, but for ways that are longer than any before.
//!
//! ```
//! use agv_core::compute::Seed;
//! use agv_core::geometry::Se2;
//! use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
//! use agv_core::path::Path;
//! use agv_core::roles::{GlobalPlanner, PlanOutcome};
//! use agv_plan::aco::{AntColony, ColonyParams};
//! use agv_plan::grid::GridPlannerParams;
//!
//! // A wall between start and goal, open at its upper end.
//! let mut map = Grid::filled(GridLayout::new(20, 20, 1.0, Se2::default())?, CellState::Free);
//! for y in 0..15 {
//!     map.set(Cell::new(10, y), CellState::Occupied);
//! }
//! let mut ants = AntColony::new(GridPlannerParams::default(), ColonyParams::refined(), Seed(1))?;
//! let mut path = Path::new();
//! let (start, goal) = (Se2::new(0.5, 0.5, 0.0), Se2::new(19.5, 0.5, 0.0));
//! let outcome = ants.plan_into(&Costmap::from_map(&map), &start, &goal, &mut path)?;
//! assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if cost < 40.0));
//!
//! let run = ants.solver().run();
//! println!("{} turns, found in iteration {}", run.turns, run.converged);
//! for iteration in ants.solver().history() {
//!     assert!(iteration.best <= iteration.mean);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ant;
mod choice;
mod colony;
mod detours;
mod ground;
mod history;
mod marks;
mod params;
mod schedule;
mod sight;
mod sparrow;
mod trail;

pub use ant::DeadEnd;
pub use colony::{AntColony, Colony};
pub use history::{Iteration, Run};
pub use params::ColonyParams;
pub use schedule::{Greed, Schedule};
pub use sight::{GoalDistance, Sight};
pub use sparrow::{SparrowParams, SparrowSearch, Swarm};
pub use trail::{Deposit, TrailLimits};
