//! From a costmap and two poses to a path.

use super::{ray::Point, runs::Runs, search::Search};
use crate::{
    Error,
    grid::{
        GridParams, GridPlannerParams, GridSpace, Limits,
        components::Parts,
        query::{Tolerances, endpoints},
    },
};
use agv_core::{
    check,
    geometry::{Se2, So2},
    grid::{Connectivity, CornerRule, Costmap, GridLayout},
    path::{Gear, Path, PathPoint},
    roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome},
};
use nalgebra::Vector2;

/// Plans the shortest path of a point at any angle, for cells of uniform cost: nothing is shorter, so it is what other planners
/// are measured against.
///
/// The path runs between the centres of the start's and the goal's cell, by the corners of blocked cells: it touches them, and
/// may run along their edges, but enters none and does not squeeze through where two touch corner to corner, whatever
/// connectivity and corner rule the parameters name. For a vehicle, plan on a costmap that is inflated for it. The start pose
/// and the goal pose are joined to the centres of their cells; the cost is the length from centre to centre, in metres.
///
/// That there is no path is found by a search once per map, and known without one from then on. With a budget, counted in cones and corners, or when it is cancelled, the
/// path leads to the corner nearest to the goal. Once it has seen the largest map, a query allocates nothing beyond the growth of its lists.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{Anya, GridPlannerParams};
///
/// // Round the upper end of a wall: two lines that meet at its corners.
/// let mut map = Grid::filled(GridLayout::new(9, 9, 1.0, Se2::default())?, CellState::Free);
/// for y in 0..8 {
///     map.set(Cell::new(4, y), CellState::Occupied);
/// }
/// let (start, goal, mut path) = (Se2::new(0.5, 5.5, 0.0), Se2::new(8.5, 5.5, 0.0), Path::new());
/// let outcome =
///     Anya::new(GridPlannerParams::default())?.plan_into(&Costmap::from_map(&map), &start, &goal, &mut path)?;
/// let length = 1.0 + 2.0 * 3.5_f64.hypot(2.5);
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - length).abs() < 1e-12));
/// assert_eq!(path.len(), 4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Anya {
    params: GridPlannerParams,
    space: GridSpace,
    runs: Runs,
    parts: Parts,
    search: Search,
    /// From the goal back to the start.
    way: Vec<Point>,
    /// The path's, in metres.
    positions: Vec<Vector2<f64>>,
}

impl Anya {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        check::non_negative("start_tolerance", params.start_tolerance)?;
        check::non_negative("goal_tolerance", params.goal_tolerance)?;
        // What its paths can reach is what steps over edges can.
        let steps = GridParams { connectivity: Connectivity::Four, corner_rule: CornerRule::Never, ..params.grid };
        let space = GridSpace::new(steps)?;
        if space.is_weighted() {
            return Err(Error::UniformCostsOnly { planner: "Anya", cost_weight: params.grid.cost_weight });
        }
        let (runs, parts, search) = Default::default();
        Ok(Self { params, space, runs, parts, search, way: Vec::new(), positions: Vec::new() })
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &GridPlannerParams {
        &self.params
    }

    /// Writes the way of the last search, and says how long it is, in cells.
    fn write(
        &mut self,
        layout: &GridLayout,
        (start, goal): (&Se2, &Se2),
        at_goal: bool,
        path: &mut Path,
    ) -> Result<f64, PlanError> {
        let to_map = |p: &Point| layout.to_map(&Vector2::new(0.5 * f64::from(p.x), 0.5 * f64::from(p.y)));
        let length = self.way.windows(2).map(|pair| 0.5 * pair[0].distance(pair[1])).sum();
        let last = self.way.first().map(to_map);
        // The centre of the goal's cell is the end if the goal lies elsewhere, within its tolerance.
        let same_cell = last.and_then(|p| layout.cell_at(&p)) == layout.cell_at(&goal.translation());
        let end = (at_goal && same_cell).then_some(*goal);
        self.positions.clear();
        self.positions.push(start.translation());
        // A pose that is nearer than this to the centre of its cell is there.
        let same = 1e-9 * layout.resolution();
        let more = self.way.iter().rev().map(to_map).chain(end.map(|pose| pose.translation()));
        for point in more {
            if self.positions.last().is_none_or(|last| (point - last).norm() > same) {
                self.positions.push(point);
            }
        }
        if end.is_some() && self.positions.len() > 1 {
            self.positions.pop();
        }
        for (index, position) in self.positions.iter().enumerate() {
            let goal_position = end.map(|pose| pose.translation());
            let rotation = match self.positions.get(index + 1).copied().or(goal_position) {
                _ if index == 0 => start.rotation(),
                Some(next) => So2::from_direction(next.x - position.x, next.y - position.y),
                None => goal.rotation(),
            };
            path.push(PathPoint { pose: Se2::from_parts(*position, rotation), gear: Gear::Forward })?;
        }
        if let Some(goal) = end {
            path.push(PathPoint { pose: goal, gear: Gear::Forward })?;
        }
        Ok(length)
    }
}

impl GlobalPlanner for Anya {
    /// Asks every [`Limits::CANCEL_INTERVAL`] expansions.
    fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        path.clear();
        let layout = *costmap.layout();
        self.space.update(costmap);
        self.runs.update(&self.space);
        let tolerances = Tolerances { start: self.params.start_tolerance, goal: self.params.goal_tolerance };
        let no_path = |reason, expansions| Ok(PlanOutcome::NoPath { reason, expansions });
        let ends = match endpoints(&self.space, &layout, (start, goal), tolerances)? {
            Ok(ends) => ends,
            Err(reason) => return no_path(reason, 0),
        };
        let joined_goal =
            |parts: &Parts, space: &GridSpace| parts.joined_goal(space, ends, goal, self.params.goal_tolerance);
        let Some(mut last) = joined_goal(&self.parts, &self.space) else {
            return no_path(NoPathReason::Disconnected, 0);
        };
        let mut limits = Limits { budget: self.params.max_expansions, cancel: Some(cancelled) };
        let from = self.space.cell(ends.start);
        let mut end = self.search.run(&self.runs, (from, self.space.cell(last)), &mut limits);
        let mut expansions = self.search.expansions;
        if end == Err(NoPathReason::Disconnected) {
            self.parts.label(&self.space);
            let instead = joined_goal(&self.parts, &self.space).filter(|&node| node != last);
            let Some(node) = instead else { return no_path(NoPathReason::Disconnected, expansions) };
            last = node;
            limits.budget = limits.budget.saturating_sub(expansions);
            end = self.search.run(&self.runs, (from, self.space.cell(last)), &mut limits);
            expansions += self.search.expansions;
        }
        if end == Err(NoPathReason::Disconnected) {
            return no_path(NoPathReason::Disconnected, expansions);
        }
        self.search.way_back_into(&mut self.way);
        let length = self.write(&layout, (start, goal), end.is_ok(), path)?;
        match end {
            Ok(()) => Ok(PlanOutcome::Found { cost: length * layout.resolution(), expansions }),
            Err(reason) => no_path(reason, expansions),
        }
    }
}
