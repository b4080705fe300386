//! Laws of grid search on random small grids, against a relaxation to the fixed point in floating point (Bellman–Ford) that
//! shares nothing with the library but the rules in words.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Costmap, Grid, GridLayout, cost};
use agv_core::nalgebra::Vector2;
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, NoPathReason, PlanOutcome};
use agv_plan::grid::{
    AStar, AStarParams, Bidirectional, Connectivity, CornerRule, DStarLite, Dijkstra, GridHeuristic, GridParams,
    GridPlannerParams, GridSpace, Jps, JpsPlus, UnknownCells,
};
use proptest::prelude::*;

fn passable(costmap: &Costmap, grid: &GridParams, cell: Cell) -> Option<f64> {
    let seen = match (costmap.cost(cell)?, grid.unknown) {
        (cost::UNKNOWN, UnknownCells::AtCost(stand_in)) => stand_in,
        (value, _) => value,
    };
    (seen <= cost::MAX_NON_OBSTACLE).then(|| f64::from(seen))
}

/// Cost of a step, if the rules allow it.
fn step_cost(costmap: &Costmap, grid: &GridParams, a: Cell, b: Cell) -> Option<f64> {
    let (from, to) = (passable(costmap, grid, a)?, passable(costmap, grid, b)?);
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let diagonal = dx != 0 && dy != 0;
    if diagonal {
        let free = |c| usize::from(passable(costmap, grid, c).is_some());
        let sides = free(Cell::new(a.x, b.y)) + free(Cell::new(b.x, a.y));
        let needed = match grid.corner_rule {
            CornerRule::Never => 2,
            CornerRule::OneFree => 1,
            CornerRule::Free => 0,
        };
        if grid.connectivity == Connectivity::Four || sides < needed {
            return None;
        }
    }
    let length = f64::from(dx * dx + dy * dy).sqrt();
    Some(length * (1.0 + grid.cost_weight * 0.5 * (from + to) / 252.0))
}

/// Costs from `start` to all cells.
fn bellman_ford(costmap: &Costmap, grid: &GridParams, start: Cell) -> Vec<f64> {
    let layout = costmap.layout();
    let mut costs = vec![f64::INFINITY; layout.len()];
    if passable(costmap, grid, start).is_some() {
        costs[layout.index(start).unwrap()] = 0.0;
    }
    loop {
        let mut changed = false;
        for i in 0..layout.len() {
            let a = layout.cell(i);
            for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)] {
                let b = Cell::new(a.x + dx, a.y + dy);
                let Some(step) = step_cost(costmap, grid, a, b) else { continue };
                let j = layout.index(b).unwrap();
                if costs[i] + step < costs[j] - 1e-9 {
                    costs[j] = costs[i] + step;
                    changed = true;
                }
            }
        }
        if !changed {
            return costs;
        }
    }
}

fn grids() -> impl Strategy<Value = (Costmap, GridParams)> {
    let cell = prop_oneof![6 => Just(0_u8), 3 => Just(cost::LETHAL), 1 => Just(cost::UNKNOWN), 2 => 0_u8..=253];
    let rules = prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)];
    let unknown = prop_oneof![Just(UnknownCells::Blocked), (0_u8..=253).prop_map(UnknownCells::AtCost)];
    let weight = prop_oneof![2 => Just(0.0), 1 => 0.0..50.0_f64];
    (1_usize..14, 1_usize..12).prop_flat_map(move |(width, height)| {
        let costs = proptest::collection::vec(cell.clone(), width * height);
        let parts = (costs, rules.clone(), unknown.clone(), weight.clone(), any::<bool>());
        parts.prop_map(move |(costs, corner_rule, unknown, cost_weight, four)| {
            let layout = GridLayout::new(width, height, 0.5, Se2::new(1.0, -2.0, 0.3)).unwrap();
            let connectivity = if four { Connectivity::Four } else { Connectivity::Eight };
            let params = GridParams { connectivity, corner_rule, unknown, cost_weight };
            (Costmap::from_costs(Grid::new(layout, costs).unwrap()), params)
        })
    })
}

/// What the planners must say, by brute force.
fn expected(costmap: &Costmap, grid: &GridParams, start: Cell, goal: Cell) -> Result<f64, NoPathReason> {
    if passable(costmap, grid, start).is_none() {
        return Err(NoPathReason::StartBlocked);
    }
    if passable(costmap, grid, goal).is_none() {
        return Err(NoPathReason::GoalBlocked);
    }
    let cost = bellman_ford(costmap, grid, start)[costmap.layout().index(goal).unwrap()];
    if cost.is_finite() { Ok(cost * costmap.layout().resolution()) } else { Err(NoPathReason::Disconnected) }
}

fn pose(costmap: &Costmap, cell: Cell, (u, v): (f64, f64)) -> Se2 {
    let p = costmap.layout().to_map(&Vector2::new(f64::from(cell.x) + u, f64::from(cell.y) + v));
    Se2::new(p.x, p.y, 0.7)
}

/// Samples along the straight lines of the path lie in cells that may be entered.
fn assert_clear(costmap: &Costmap, grid: &GridParams, path: &Path) -> Result<(), TestCaseError> {
    for pair in path.points().windows(2) {
        let (a, b) = (pair[0].pose.translation(), pair[1].pose.translation());
        for k in 1..40 {
            let point = a + (b - a) * (f64::from(k) / 40.0);
            let p = costmap.layout().to_grid(&point);
            // On a line between cells, rounding decides the cell.
            if (p.x - p.x.round()).abs() < 1e-6 || (p.y - p.y.round()).abs() < 1e-6 {
                continue;
            }
            let cell = costmap.layout().cell_at(&point).unwrap();
            prop_assert!(passable(costmap, grid, cell).is_some(), "{:?} at {:?}", cell, point);
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// All heuristics, both planners, one instance for several maps and queries: the brute-force cost, or its reason.
    #[test]
    fn planners_are_optimal(
        (one, grid) in grids(),
        (other, _) in grids(),
        picks in proptest::collection::vec((any::<bool>(), any::<u32>(), any::<u32>()), 4),
        inside in ((0.05..0.95_f64, 0.05..0.95_f64), (0.05..0.95_f64, 0.05..0.95_f64)),
    ) {
        let mut heuristics = vec![GridHeuristic::Exact, GridHeuristic::Octile, GridHeuristic::Euclidean, GridHeuristic::Zero];
        if grid.connectivity == Connectivity::Four {
            heuristics.push(GridHeuristic::Manhattan);
        }
        let planner = |heuristic| AStar::new(AStarParams { grid, heuristic, ..Default::default() }).unwrap();
        let mut planners: Vec<Box<dyn GlobalPlanner>> =
            heuristics.into_iter().map(|h| Box::new(planner(h)) as Box<dyn GlobalPlanner>).collect();
        planners.push(Box::new(Dijkstra::new(GridPlannerParams { grid, ..Default::default() }).unwrap()));
        planners.push(Box::new(DStarLite::new(GridPlannerParams { grid, ..Default::default() }).unwrap()));
        for heuristic in [GridHeuristic::Exact, GridHeuristic::Zero] {
            let params = AStarParams { grid, heuristic, ..Default::default() };
            planners.push(Box::new(Bidirectional::new(params).unwrap()));
        }
        if grid.cost_weight == 0.0 {
            planners.push(Box::new(Jps::new(GridPlannerParams { grid, ..Default::default() }).unwrap()));
            planners.push(Box::new(JpsPlus::new(GridPlannerParams { grid, ..Default::default() }).unwrap()));
        }
        for (first, s, g) in picks {
            let costmap = if first { &one } else { &other };
            let layout = *costmap.layout();
            let (start, goal) = (layout.cell(s as usize % layout.len()), layout.cell(g as usize % layout.len()));
            let want = expected(costmap, &grid, start, goal);
            let (from, to) = (pose(costmap, start, inside.0), pose(costmap, goal, inside.1));
            for planner in &mut planners {
                let mut path = Path::new();
                match (planner.plan_into(costmap, &from, &to, &mut path).unwrap(), want) {
                    (PlanOutcome::Found { cost, .. }, Ok(best)) => {
                        // Weighted steps are rounded to 1/985 of a cell each.
                        let slack = if grid.cost_weight > 0.0 { 1e-3 * best } else { 0.0 } + 1e-9;
                        prop_assert!((cost - best).abs() <= slack, "{} for {}", cost, best);
                        prop_assert_eq!(path.points()[0].pose, from);
                        prop_assert_eq!(path.points()[path.len() - 1].pose, to);
                        if grid.corner_rule != CornerRule::Free {
                            assert_clear(costmap, &grid, &path)?;
                        }
                    }
                    (PlanOutcome::NoPath { reason, .. }, Err(why)) => {
                        prop_assert_eq!(reason, why);
                        prop_assert!(path.is_empty());
                    }
                    (got, want) => prop_assert!(false, "{:?} for {:?}", got, want),
                }
            }
        }
    }

    /// A space that follows a changing costmap is the space that is built anew.
    #[test]
    fn updates_equal_a_fresh_space(
        (costmap, grid) in grids(),
        edits in proptest::collection::vec((any::<u32>(), any::<u8>()), 0..6),
    ) {
        let mut space = GridSpace::new(grid).unwrap();
        space.update(&costmap);
        let mut costs = costmap.costs().to_vec();
        for (at, value) in &edits {
            let index = *at as usize % costs.len();
            costs[index] = *value;
        }
        let edited = Costmap::from_costs(Grid::new(*costmap.layout(), costs).unwrap());
        let changed = space.update(&edited);
        prop_assert!(changed <= edits.len());
        prop_assert_eq!(space.update(&edited), 0);
        let mut fresh = GridSpace::new(grid).unwrap();
        fresh.update(&edited);
        for node in 0..edited.layout().len() as u32 {
            prop_assert_eq!(space.mask(node), fresh.mask(node));
            prop_assert_eq!(space.is_passable(node), fresh.is_passable(node));
        }
    }
}
