//! What the planners on grids say when there is no plain answer: tolerances, budgets, cancelling, bad input.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Costmap, Grid, GridLayout, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome};
use agv_plan::Error;
use agv_plan::grid::{
    AStar, AStarParams, Anya, Bidirectional, Connectivity, DStarLite, Dijkstra, GridHeuristic, GridParams, GridPlanner,
    GridPlannerParams, GridSolver, GridSpace, Jps, JpsPlus, LazyThetaStar, Limits, Octile, Offset, SearchEnd,
    ThetaStar, UnknownCells, Workspace,
};

/// A room of 40 x 30 cells of 0.1 m, parted by a wall of column 20.
fn parted() -> Costmap {
    let layout = GridLayout::new(40, 30, 0.1, Se2::default()).unwrap();
    let mut grid = Grid::filled(layout, cost::FREE);
    for y in 0..30 {
        grid.set(Cell::new(20, y), cost::LETHAL);
    }
    Costmap::from_costs(grid)
}

fn plan(params: AStarParams, start: (f64, f64), goal: (f64, f64)) -> (Result<PlanOutcome, PlanError>, Path) {
    let mut path = Path::from_positions(&[agv_core::nalgebra::Vector2::zeros()]).unwrap();
    let mut planner = AStar::new(params).unwrap();
    let (start, goal) = (Se2::new(start.0, start.1, 0.5), Se2::new(goal.0, goal.1, -0.5));
    (planner.plan_into(&parted(), &start, &goal, &mut path), path)
}

fn reason(outcome: &Result<PlanOutcome, PlanError>) -> Option<NoPathReason> {
    match outcome {
        Ok(PlanOutcome::NoPath { reason, .. }) => Some(*reason),
        _ => None,
    }
}

#[test]
fn reasons_are_told_apart() {
    let (free, wall, beyond) = ((0.55, 1.05), (2.05, 1.05), (3.05, 1.05));
    for (start, goal, why) in [
        (wall, free, NoPathReason::StartBlocked),
        (free, wall, NoPathReason::GoalBlocked),
        (free, beyond, NoPathReason::Disconnected),
    ] {
        let (outcome, path) = plan(AStarParams::default(), start, goal);
        assert_eq!(reason(&outcome), Some(why));
        assert!(path.is_empty());
    }
}

#[test]
fn tolerances_move_start_and_goal_to_where_the_vehicle_can_stand() {
    let params = AStarParams { start_tolerance: 0.15, goal_tolerance: 0.15, ..Default::default() };
    // The start stands in the wall, nearer to its left side.
    let (outcome, path) = plan(params, (2.02, 1.05), (0.55, 1.05));
    assert!(matches!(outcome, Ok(PlanOutcome::Found { cost, .. }) if (cost - 1.4).abs() < 1e-9), "{outcome:?}");
    assert_eq!(path.points()[0].pose.x(), 2.02);
    assert!((path.points()[1].pose.x() - 1.95).abs() < 1e-9);
    // The goal stands in the wall, nearer to its left side.
    let (outcome, path) = plan(params, (0.55, 1.05), (2.02, 1.05));
    assert!(matches!(outcome, Ok(PlanOutcome::Found { cost, .. }) if (cost - 1.4).abs() < 1e-9), "{outcome:?}");
    let last = path.points()[path.len() - 1].pose;
    assert!((last.x() - 1.95).abs() < 1e-9 && (last.yaw() + 0.5).abs() < 1e-9);
    // The goal is free but beyond the wall: what can be reached within its tolerance will do.
    let wide = AStarParams { goal_tolerance: 0.25, ..Default::default() };
    let (outcome, path) = plan(wide, (0.55, 1.05), (2.15, 1.05));
    assert!(matches!(outcome, Ok(PlanOutcome::Found { .. })), "{outcome:?}");
    assert!((path.points()[path.len() - 1].pose.x() - 1.95).abs() < 1e-9);
    assert_eq!(reason(&plan(params, (0.55, 1.05), (2.25, 1.05)).0), Some(NoPathReason::Disconnected));
}

fn all_planners(params: GridPlannerParams) -> Vec<(&'static str, Box<dyn GlobalPlanner>)> {
    let GridPlannerParams { grid, start_tolerance, goal_tolerance, max_expansions } = params;
    let guided = |heuristic| AStarParams { grid, heuristic, start_tolerance, goal_tolerance, max_expansions };
    let both_ends = |heuristic| Bidirectional::new(guided(heuristic)).unwrap();
    vec![
        ("A*", Box::new(AStar::new(guided(GridHeuristic::Exact)).unwrap())),
        ("Dijkstra", Box::new(Dijkstra::new(params).unwrap())),
        ("bidirectional A*", Box::new(both_ends(GridHeuristic::Exact))),
        ("bidirectional Dijkstra", Box::new(both_ends(GridHeuristic::Zero))),
        ("JPS", Box::new(Jps::new(params).unwrap())),
        ("JPS+", Box::new(JpsPlus::new(params).unwrap())),
        ("D* Lite", Box::new(DStarLite::new(params).unwrap())),
        ("Anya", Box::new(Anya::new(params).unwrap())),
        ("Theta*", Box::new(ThetaStar::new(params).unwrap())),
        ("Lazy Theta*", Box::new(LazyThetaStar::new(params).unwrap())),
    ]
}

#[test]
fn every_planner_ends_within_the_goal_tolerance_or_says_why_not() {
    let (start, beyond, beside) = (Se2::new(0.55, 1.05, 0.5), Se2::new(2.15, 1.05, 0.0), Se2::new(2.02, 1.45, 0.0));
    let tolerant = GridPlannerParams { start_tolerance: 0.3, goal_tolerance: 0.25, ..Default::default() };
    let mut path = Path::new();
    for (name, mut planner) in all_planners(tolerant) {
        for (from, to, end) in [(&start, &beyond, 1.95), (&start, &beside, 1.95), (&beside, &start, 0.55)] {
            // Twice: what the first query left is forgotten.
            for _ in 0..2 {
                let outcome = planner.plan_into(&parted(), from, to, &mut path);
                assert!(matches!(outcome, Ok(PlanOutcome::Found { .. })), "{name}: {outcome:?}");
                assert_eq!(path.points()[0].pose, *from, "{name}");
                assert!((path.points()[path.len() - 1].pose.x() - end).abs() < 1e-9, "{name}: {path:?}");
            }
        }
    }
    for (name, mut planner) in all_planners(GridPlannerParams::default()) {
        let outcome = planner.plan_into(&parted(), &start, &beyond, &mut path);
        assert_eq!(reason(&outcome), Some(NoPathReason::Disconnected), "{name}");
        assert!(path.is_empty(), "{name}");
    }
}

/// A goal that cannot be reached, with a tolerance: whatever the budget, the nearest end or the budget's, never "no way".
#[test]
fn a_budget_is_not_taken_for_a_goal_out_of_reach() {
    let (start, beyond) = (Se2::new(0.55, 1.05, 0.5), Se2::new(2.15, 1.05, 0.0));
    let mut path = Path::new();
    for budget in (0..60).chain((60..1500).step_by(37)) {
        let tolerant = GridPlannerParams { goal_tolerance: 0.25, max_expansions: budget, ..Default::default() };
        for (name, mut planner) in all_planners(tolerant) {
            // The second query knows the parts of the map, if the first one had the budget to find that they are apart.
            for _ in 0..2 {
                match planner.plan_into(&parted(), &start, &beyond, &mut path).unwrap() {
                    PlanOutcome::Found { cost, expansions } => {
                        assert!(cost > 1.4 - 1e-9 && expansions <= budget, "{name}, {budget}");
                        assert!((path.points()[path.len() - 1].pose.x() - 1.95).abs() < 1e-9, "{name}, {budget}");
                    }
                    other => {
                        let end = PlanOutcome::NoPath { reason: NoPathReason::Budget, expansions: budget };
                        assert_eq!(other, end, "{name}, {budget}");
                        assert_eq!(path.points()[0].pose, start, "{name}, {budget}");
                    }
                }
            }
        }
    }
}

/// As above, cancelled at any question.
#[test]
fn a_cancel_is_not_taken_for_a_goal_out_of_reach() {
    let layout = GridLayout::new(200, 160, 0.1, Se2::default()).unwrap();
    let mut map = Costmap::from_costs(Grid::filled(layout, cost::FREE));
    for y in 0..160 {
        map.set(Cell::new(100, y), cost::LETHAL);
    }
    let params = GridPlannerParams { goal_tolerance: 0.5, ..Default::default() };
    let zero = AStarParams { heuristic: GridHeuristic::Zero, goal_tolerance: 0.5, ..Default::default() };
    for last in 1..40 {
        cancelled_at(last, &map, Dijkstra::new(params).unwrap());
        cancelled_at(last, &map, DStarLite::new(params).unwrap());
        cancelled_at(last, &map, Bidirectional::new(zero).unwrap());
    }
}

fn cancelled_at<S: GridSolver>(last: u32, map: &Costmap, mut planner: GridPlanner<S>) {
    let (start, beyond, mut path) = (Se2::new(0.55, 8.05, 0.0), Se2::new(10.35, 8.05, 0.0), Path::new());
    for _ in 0..2 {
        let mut asked = 0;
        let mut cancel = || {
            asked += 1;
            asked == last
        };
        let outcome = planner.plan_with_cancel(map, &start, &beyond, &mut path, &mut cancel).unwrap();
        if asked == last {
            assert_eq!(reason(&Ok(outcome)), Some(NoPathReason::Cancelled), "{last}");
        } else {
            assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - 9.4).abs() < 1e-9), "{outcome:?}");
        }
        assert_eq!(path.points()[0].pose, start);
    }
}

#[test]
fn every_planner_leaves_the_best_path_so_far() {
    let (start, goal) = (Se2::new(0.15, 0.15, 0.0), Se2::new(3.95, 2.85, 0.0));
    let mut map = parted();
    map.set(Cell::new(20, 0), cost::FREE);
    let mut path = Path::new();
    for budget in [0, 1] {
        for (name, mut planner) in all_planners(GridPlannerParams { max_expansions: budget, ..Default::default() }) {
            let outcome = planner.plan_into(&map, &start, &goal, &mut path).unwrap();
            assert_eq!(outcome, PlanOutcome::NoPath { reason: NoPathReason::Budget, expansions: budget }, "{name}");
            assert_eq!(path.points()[0].pose.translation(), start.translation(), "{name}");
        }
    }
    for (name, mut planner) in all_planners(GridPlannerParams::default()) {
        let outcome = planner.plan_into(&map, &start, &goal, &mut path);
        assert!(matches!(outcome, Ok(PlanOutcome::Found { .. })), "{name}: {outcome:?}");
    }
}

/// Between the first whole way and the proof that none is better, the budget leaves the whole way.
#[test]
fn a_whole_way_that_is_known_is_the_best_so_far() {
    let (start, goal) = (Se2::new(0.15, 0.15, 0.0), Se2::new(3.95, 2.85, 0.0));
    let mut map = parted();
    for y in [0, 15, 29] {
        map.set(Cell::new(20, y), cost::FREE);
    }
    for heuristic in [GridHeuristic::Exact, GridHeuristic::Zero] {
        let (mut path, mut whole) = (Path::new(), 0);
        for max_expansions in 0.. {
            let params = AStarParams { heuristic, max_expansions, ..Default::default() };
            let outcome = Bidirectional::new(params).unwrap().plan_into(&map, &start, &goal, &mut path).unwrap();
            let at_goal = path.points()[path.len() - 1].pose == goal;
            assert!(at_goal || whole == 0, "{heuristic:?}: a whole way was known before {max_expansions}");
            if matches!(outcome, PlanOutcome::Found { .. }) {
                break;
            }
            assert_eq!(reason(&Ok(outcome)), Some(NoPathReason::Budget));
            whole += u32::from(at_goal);
        }
        assert!(whole > 0, "{heuristic:?}");
    }
}

/// Corridors that lie to and fro, 90 000 cells of 51 times their length: more than the integers of the search can count.
#[test]
fn a_way_too_long_to_be_counted_is_not_said_to_be_none() {
    let layout = GridLayout::new(600, 300, 0.1, Se2::default()).unwrap();
    let mut map = Costmap::from_costs(Grid::filled(layout, cost::MAX_NON_OBSTACLE));
    for y in (1..300).step_by(2) {
        for x in 0..599 {
            map.set(Cell::new(if y % 4 == 1 { x } else { x + 1 }, y), cost::LETHAL);
        }
    }
    let (start, goal) = (Se2::new(0.05, 0.05, 0.0), Se2::new(0.05, 29.85, 0.0));
    let grid = GridParams { cost_weight: GridParams::MAX_COST_WEIGHT, ..Default::default() };
    let guided = AStarParams { grid, ..Default::default() };
    let params = GridPlannerParams { grid, ..Default::default() };
    let planners: [(_, Box<dyn GlobalPlanner>); 4] = [
        ("A*", Box::new(AStar::new(guided).unwrap())),
        ("Dijkstra", Box::new(Dijkstra::new(params).unwrap())),
        ("bidirectional", Box::new(Bidirectional::new(guided).unwrap())),
        ("D* Lite", Box::new(DStarLite::new(params).unwrap())),
    ];
    for (name, mut planner) in planners {
        let outcome = planner.plan_into(&map, &start, &goal, &mut Path::new());
        assert_eq!(reason(&outcome), Some(NoPathReason::Budget), "{name}: {outcome:?}");
    }
}

#[test]
fn what_nothing_joins_is_known_without_a_search() {
    let (start, beyond) = (Se2::new(0.55, 1.05, 0.5), Se2::new(3.05, 1.05, 0.0));
    for (name, mut planner) in all_planners(GridPlannerParams::default()) {
        let (mut map, mut path) = (parted(), Path::new());
        let mut ask = |map: &Costmap| planner.plan_into(map, &start, &beyond, &mut path).unwrap();
        let apart = |outcome| matches!(outcome, PlanOutcome::NoPath { reason: NoPathReason::Disconnected, .. });
        let first = ask(&map);
        let searched = !matches!(first, PlanOutcome::NoPath { expansions: 0, .. });
        assert!(apart(first) && searched, "{name}: {first:?}");
        assert_eq!(ask(&map), PlanOutcome::NoPath { reason: NoPathReason::Disconnected, expansions: 0 }, "{name}");
        // A door opens and closes.
        map.set(Cell::new(20, 7), cost::FREE);
        assert!(matches!(ask(&map), PlanOutcome::Found { .. }), "{name}");
        map.set(Cell::new(20, 7), cost::LETHAL);
        assert!(apart(ask(&map)), "{name}");
    }
}

#[test]
fn planners_of_lengths_take_no_cost_weight() {
    let params =
        GridPlannerParams { grid: GridParams { cost_weight: 1.0, ..Default::default() }, ..Default::default() };
    let said = |error: Option<Error>| matches!(error, Some(Error::UniformCostsOnly { cost_weight: 1.0, .. }));
    assert!(
        said(Jps::new(params).err())
            && said(JpsPlus::new(params).err())
            && said(Anya::new(params).err())
            && said(ThetaStar::new(params).err())
            && said(LazyThetaStar::new(params).err())
    );
    for bad in [-1.0, f64::NAN] {
        let params = GridPlannerParams { goal_tolerance: bad, ..Default::default() };
        assert!(Jps::new(params).is_err() && ThetaStar::new(params).is_err() && LazyThetaStar::new(params).is_err());
        assert!(Bidirectional::new(AStarParams { start_tolerance: bad, ..Default::default() }).is_err());
    }
    let manhattan = AStarParams { heuristic: GridHeuristic::Manhattan, ..Default::default() };
    assert!(Bidirectional::new(manhattan).is_err());
}

#[test]
fn a_budget_ends_with_the_best_path_so_far() {
    let (start, goal) = ((0.15, 0.15), (1.85, 2.85));
    let (full, _) = plan(AStarParams::default(), start, goal);
    let Ok(PlanOutcome::Found { expansions: needed, .. }) = full else { panic!("{full:?}") };
    assert!(matches!(
        plan(AStarParams { max_expansions: needed, ..Default::default() }, start, goal).0,
        Ok(PlanOutcome::Found { .. })
    ));
    let mut last = f64::INFINITY;
    for budget in [0, 1, needed / 2, needed - 1] {
        for heuristic in [GridHeuristic::Exact, GridHeuristic::Zero] {
            let (outcome, path) =
                plan(AStarParams { max_expansions: budget, heuristic, ..Default::default() }, start, goal);
            assert_eq!(outcome, Ok(PlanOutcome::NoPath { reason: NoPathReason::Budget, expansions: budget }));
            assert_eq!((path.points()[0].pose.x(), path.points()[0].pose.y()), start);
            let end = path.points()[path.len() - 1].pose;
            if heuristic == GridHeuristic::Exact {
                let left = (end.x() - goal.0).hypot(end.y() - goal.1);
                assert!(left <= last, "{left} after {last}");
                last = left;
            }
        }
    }
    assert!(last < 0.2, "{last}");
}

#[test]
fn a_callback_cancels() {
    let layout = GridLayout::new(300, 300, 0.1, Se2::default()).unwrap();
    let costmap = Costmap::from_costs(Grid::filled(layout, cost::FREE));
    let mut planner = Dijkstra::new(GridPlannerParams::default()).unwrap();
    let (start, goal, mut path) = (Se2::new(15.0, 15.0, 0.0), Se2::new(29.0, 29.0, 0.0), Path::new());
    let mut asked = 0;
    let mut cancel = || {
        asked += 1;
        asked == 5
    };
    let outcome = planner.plan_with_cancel(&costmap, &start, &goal, &mut path, &mut cancel).unwrap();
    assert_eq!(
        outcome,
        PlanOutcome::NoPath { reason: NoPathReason::Cancelled, expansions: 5 * Limits::CANCEL_INTERVAL }
    );
    let end = path.points()[path.len() - 1].pose;
    assert!(end.x() > 16.0 && end.y() > 16.0, "the reached cell nearest to the goal: {end:?}");
    assert!(matches!(planner.plan_into(&costmap, &start, &goal, &mut path), Ok(PlanOutcome::Found { .. })));
}

#[test]
fn bad_poses_are_refused_with_an_empty_path() {
    let free = (0.55, 1.05);
    for bad in [(-0.01, 1.0), (4.01, 1.0), (1.0, 3.5), (1e300, 0.0)] {
        let (outcome, path) = plan(AStarParams::default(), bad, free);
        assert!(matches!(outcome, Err(PlanError::StartOutside { x, y }) if (x, y) == bad), "{outcome:?}");
        assert!(path.is_empty());
        let (outcome, path) = plan(AStarParams::default(), free, bad);
        assert!(matches!(outcome, Err(PlanError::GoalOutside { x, y }) if (x, y) == bad), "{outcome:?}");
        assert!(path.is_empty());
    }
    for bad in [(f64::NAN, 1.0), (1.0, f64::INFINITY)] {
        for (start, goal) in [(bad, free), (free, bad)] {
            let (outcome, path) = plan(AStarParams::default(), start, goal);
            assert!(matches!(outcome, Err(PlanError::Invalid(_))), "{outcome:?}");
            assert!(path.is_empty());
        }
    }
}

#[test]
fn bad_parameters_are_refused() {
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(AStar::new(AStarParams { start_tolerance: bad, ..Default::default() }).is_err());
        assert!(AStar::new(AStarParams { goal_tolerance: bad, ..Default::default() }).is_err());
        assert!(Dijkstra::new(GridPlannerParams { goal_tolerance: bad, ..Default::default() }).is_err());
    }
    for cost_weight in [-0.1, 50.1, f64::NAN, f64::INFINITY] {
        assert!(GridSpace::new(GridParams { cost_weight, ..Default::default() }).is_err());
    }
    let manhattan = AStarParams { heuristic: GridHeuristic::Manhattan, ..Default::default() };
    assert_eq!(AStar::new(manhattan).err(), Some(Error::InconsistentHeuristic { heuristic: "Manhattan" }));
    let four = GridParams { connectivity: Connectivity::Four, ..Default::default() };
    assert!(AStar::new(AStarParams { grid: four, ..manhattan }).is_ok());
}

#[test]
fn a_huge_tolerance_is_bounded_by_the_map() {
    let params = AStarParams { start_tolerance: f64::MAX, goal_tolerance: f64::MAX, ..Default::default() };
    assert!(matches!(plan(params, (0.55, 1.05), (3.5, 1.05)).0, Ok(PlanOutcome::Found { .. })));
}

#[test]
fn parts_take_empty_spaces_and_strange_nodes() {
    let mut workspace: Workspace<_> = Workspace::default();
    let mut space = GridSpace::new(GridParams { unknown: UnknownCells::AtCost(255), ..Default::default() }).unwrap();
    let octile = Octile(Offset::new(0, Cell::new(0, 0)));
    let result = workspace.search(&space.uniform(), &octile, 0, |_| true, &mut Limits::none());
    assert_eq!(result.end, SearchEnd::Exhausted);
    space.update(&parted());
    let result = workspace.search(&space.uniform(), &octile, u32::MAX, |_| true, &mut Limits::none());
    assert_eq!((result.end, result.expansions), (SearchEnd::Exhausted, 0));
    let mut way = vec![1, 2, 3];
    workspace.trace_into(&space.uniform(), 7, &mut way);
    assert!(way.is_empty());
    assert_eq!((space.mask(u32::MAX), space.is_passable(u32::MAX), space.path_cost(&[])), (0, false, 0.0));
}

/// Stamps are 16 bits wide: what a search reached 65 536 searches ago must not look reached.
#[test]
fn old_searches_are_forgotten_when_the_stamps_start_anew() {
    let mut space = GridSpace::new(GridParams::default()).unwrap();
    space.update(&parted());
    let mut workspace: Workspace<_> = Workspace::default();
    workspace.search(&space.uniform(), &agv_plan::grid::Zero, 0, |_| false, &mut Limits::none());
    assert!(workspace.cost(41).is_some());
    for round in 0..70_000 {
        let result = workspace.search(&space.uniform(), &agv_plan::grid::Zero, 0, |n| n == 0, &mut Limits::none());
        assert_eq!(result.end, SearchEnd::Goal { node: 0, cost: 0 });
        assert_eq!(workspace.cost(41), None, "{round}");
    }
}
