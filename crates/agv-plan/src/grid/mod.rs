//! Best-first search on costmaps.
//!
//! What a planner is made of:
//!
//! ```text
//! Costmap -> GridSpace (masks)  \
//!            Heuristic           >  Workspace::search  ->  cost, way, expansions
//!            OpenList (buckets) /
//! ```
//!
//! Planners put the parts together behind [`GlobalPlanner`](agv_core::roles::GlobalPlanner):
//!
//! | planner | for |
//! |---|---|
//! | [`AStar`] | costs that differ from cell to cell; the plain choice |
//! | [`Dijkstra`] | what the others are held to; [`Potential`] is its full field, for many starts or local planners |
//! | [`Bidirectional`] | start or goal in a dead end |
//! | [`Jps`] | shortest paths, on maps that change |
//! | [`JpsPlus`] | shortest paths, on maps that seldom change |
//! | [`DStarLite`] | one goal, while the vehicle moves and the map changes |
//! | [`ThetaStar`], [`LazyThetaStar`] | paths that are not bound to the grid's eight directions |
//! | [`Anya`] | the shortest of those, which touch the corners of blocked cells |
//!
//! Who asks many questions of one map, wants several goals, or brings another graph, holds the parts:
//!
//! ```
//! use agv_core::geometry::Se2;
//! use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
//! use agv_plan::grid::{GridParams, GridSpace, Limits, Octile, Offset, SearchEnd, Workspace};
//!
//! let map = Grid::filled(GridLayout::new(50, 40, 0.1, Se2::default())?, CellState::Free);
//! let mut space = GridSpace::new(GridParams::default())?;
//! space.update(&Costmap::from_map(&map));
//!
//! let goal = Cell::new(30, 20);
//! let goal_node = space.node(goal).unwrap();
//! let mut workspace: Workspace<_> = Workspace::default();
//! let result =
//!     workspace.search(&space.uniform(), &Octile(Offset::new(50, goal)), 0, |n| n == goal_node, &mut Limits::none());
//! assert!(matches!(result.end, SearchEnd::Goal { .. }));
//!
//! let mut way = Vec::new();
//! workspace.trace_into(&space.uniform(), goal_node, &mut way);
//! assert_eq!(space.path_cost(&way), 10.0 + 20.0 * 2.0_f64.sqrt());
//! # Ok::<(), agv_plan::Error>(())
//! ```
//!
//! # Clearance
//! The planners move a point; what the vehicle needs around it is put into the costmap before. [`Inflation`] blocks every cell
//! within the vehicle's inscribed radius of an obstacle, by exact Euclidean distances, and lets costs fall off beyond, as Nav2's
//! inflation layer does. With a `cost_weight`, paths keep to the middle of aisles where that is cheap:
//!
//! ```
//! use agv_core::geometry::Se2;
//! use agv_core::grid::{Cell, CellState, Footprint, Grid, GridLayout, Inflation, InflationParams};
//! use agv_core::path::Path;
//! use agv_core::roles::{GlobalPlanner, PlanOutcome};
//! use agv_plan::grid::{AStar, AStarParams, GridParams};
//!
//! // A hall with a wall that leaves 2 m at its upper end.
//! let mut map = Grid::filled(GridLayout::new(120, 80, 0.1, Se2::default())?, CellState::Free);
//! for y in 0..60 {
//!     map.set(Cell::new(60, y), CellState::Occupied);
//! }
//! let footprint = Footprint::rectangle(-0.4, 0.4, 0.6)?;
//! let costmap = Inflation::new(InflationParams::for_footprint(&footprint))?.inflate(&map)?;
//! let (start, goal, mut path) = (Se2::new(2.0, 2.0, 0.0), Se2::new(10.0, 2.0, 0.0), Path::new());
//! let mut clearance = |cost_weight: f64| {
//!     let grid = GridParams { cost_weight, ..Default::default() };
//!     let outcome = AStar::new(AStarParams { grid, ..Default::default() })?.plan_into(&costmap, &start, &goal, &mut path)?;
//!     assert!(matches!(outcome, PlanOutcome::Found { .. }));
//!     let to_wall = |p: &Se2| (p.x() - 6.05).hypot((p.y() - 5.95).max(0.0));
//!     Ok::<_, Box<dyn std::error::Error>>(path.points().iter().map(|p| to_wall(&p.pose)).fold(f64::INFINITY, f64::min))
//! };
//! let (shortest, wide) = (clearance(0.0)?, clearance(2.0)?);
//! assert!(shortest > 0.3 && shortest < 0.45, "no nearer than the inscribed radius");
//! assert!(wide > shortest + 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! For outlines that fit only lengthwise, plan with the inscribed radius and check the path by
//! [`CollisionChecker`](agv_core::grid::CollisionChecker), or search with headings.
//!
//! [`Inflation`]: agv_core::grid::Inflation

mod any_angle;
mod anya;
mod astar;
mod bidirectional;
mod components;
mod dijkstra;
mod dstar_lite;
mod heuristic;
mod indexed_heap;
mod jps;
mod jps_plus;
mod jump_table;
mod jumps;
mod lazy_theta;
mod limits;
mod masks;
mod nodes;
mod planner;
mod potential;
mod query;
mod queue;
mod search;
mod space;
mod step;
mod straight_runs;
mod theta;
mod view;

pub use agv_core::grid::{Components, Connectivity, CornerRule};
pub use any_angle::Parent;
pub use anya::Anya;
pub use astar::{AStar, AStarParams, AStarSolver, GridHeuristic};
pub use bidirectional::{Bidirectional, BidirectionalSolver};
pub use dijkstra::{Dijkstra, DijkstraSolver};
pub use dstar_lite::{DStarLite, DStarLiteSolver};
pub use heuristic::{Euclidean, Heuristic, Manhattan, Nearest, Octile, Offset, Zero};
pub use jps::{Jps, JpsSolver};
pub use jps_plus::{JpsPlus, JpsPlusSolver};
pub use lazy_theta::{LazyTheta, LazyThetaSolver, LazyThetaStar, Promise};
pub use limits::{Limits, SearchEnd, SearchResult};
pub use nodes::{DenseNodes, Known, NodeStore, SparseNodes};
pub use planner::{GridPlanner, GridPlannerParams, GridSolver};
pub use potential::Potential;
pub use queue::{BucketQueue, Entry, HeapQueue, OpenList};
pub use search::{Frontier, Reached, SearchSpace, Workspace};
pub use space::{GridParams, GridSpace, UnknownCells};
pub use step::{DIAGONAL, STRAIGHT, Step};
pub use theta::{Theta, ThetaSolver, ThetaStar};
pub use view::{CostWeighted, GridView, Lengths, StepPrices, Uniform, Weighted};
