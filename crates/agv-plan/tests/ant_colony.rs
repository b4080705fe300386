//! Ant colonies and sparrows on random maps: every path is one, none is shorter than the shortest, and no thread shows.

use agv_core::compute::{Par, Seed};
use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Connectivity, CornerRule, Costmap, Grid, GridLayout, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, NoPathReason, PlanOutcome, laws};
use agv_plan::aco::{
    AntColony, Colony, ColonyParams, DeadEnd, Deposit, GoalDistance, Greed, Schedule, Sight, TrailLimits,
};
use agv_plan::grid::{
    DIAGONAL, GridParams, GridPlannerParams, GridSolver, GridSpace, Limits, Potential, STRAIGHT, SearchEnd, Step,
};
use proptest::prelude::*;
use rand::RngExt;

/// A small colony of each kind.
fn kinds() -> Vec<ColonyParams> {
    let small = |params| ColonyParams { ants: 10, iterations: 8, ..params };
    vec![
        small(ColonyParams::aco()),
        small(ColonyParams::with_transition()),
        small(ColonyParams::with_heuristic()),
        small(ColonyParams::iaco()),
        small(ColonyParams::refined()),
        small(ColonyParams { sight: Sight::goal(GoalDistance::CubeRoot), restart_after: 2, ..ColonyParams::refined() }),
        small(ColonyParams { deposit: Deposit::BestWay { period: 3 }, dead_end: DeadEnd::Die, ..ColonyParams::iaco() }),
        small(ColonyParams { sight: Sight::to_goal(), greed: Greed::Constant(0.5), ..ColonyParams::aco() }),
    ]
}

fn space_of(width: usize, costs: Vec<u8>, connectivity: Connectivity, corner_rule: CornerRule) -> GridSpace {
    let layout = GridLayout::new(width, costs.len() / width, 1.0, Se2::default()).unwrap();
    let mut space = GridSpace::new(GridParams { connectivity, corner_rule, ..Default::default() }).unwrap();
    space.update(&Costmap::from_costs(Grid::new(layout, costs).unwrap()));
    space
}

proptest! {
    /// Ways are chains of open steps that visit no cell twice, cost what they say, and are found where there are any.
    #[test]
    fn ways_are_valid_and_none_beats_the_optimum(
        costs in proptest::collection::vec(prop_oneof![3 => Just(cost::FREE), 1 => Just(cost::LETHAL)], 120),
        corner_rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
        connectivity in prop_oneof![1 => Just(Connectivity::Four), 3 => Just(Connectivity::Eight)],
        (start, goal, seed) in (0_u32..120, 0_u32..120, any::<u64>()),
    ) {
        let space = space_of(12, costs, connectivity, corner_rule);
        prop_assume!(space.is_passable(start) && space.is_passable(goal));
        let mut potential = Potential::default();
        potential.compute(&space, goal).unwrap();
        let optimum = potential.distance(start);
        for params in kinds() {
            let mut colony = Colony::new(params, Seed(seed)).unwrap();
            let result = colony.search(&space, start, goal, &mut Limits::none());
            let mut way = Vec::new();
            colony.way_into(&space, goal, &mut way);
            match (result.end, optimum) {
                (SearchEnd::Goal { node, cost }, Some(optimum)) => {
                    prop_assert_eq!(node, goal);
                    prop_assert_eq!((way.first(), way.last()), (Some(&start), Some(&goal)));
                    let mut sum = 0;
                    for pair in way.windows(2) {
                        let (a, b) = (space.cell(pair[0]), space.cell(pair[1]));
                        prop_assert_eq!(a.x.abs_diff(b.x).max(a.y.abs_diff(b.y)), 1);
                        let step = Step::towards(b.x - a.x, b.y - a.y);
                        prop_assert!(space.mask(pair[0]) & step.bit() != 0, "{:?} {:?}", a, b);
                        sum += if step.is_diagonal() { DIAGONAL } else { STRAIGHT };
                    }
                    let mut seen = way.clone();
                    seen.sort_unstable();
                    seen.dedup();
                    prop_assert_eq!(seen.len(), way.len());
                    prop_assert_eq!((sum, colony.cost(goal)), (cost, Some(cost)));
                    prop_assert!(colony.run().length.unwrap() >= optimum - 1e-5);
                    prop_assert!((space.path_cost(&way) - colony.run().length.unwrap()).abs() < 1e-9);
                }
                // An ant that dies in dead ends may not arrive where there is a way.
                (SearchEnd::Budget, Some(_)) => prop_assert_eq!(params.dead_end, DeadEnd::Die),
                (SearchEnd::Exhausted, None) => prop_assert!(way.is_empty()),
                (end, optimum) => prop_assert!(false, "{end:?} {optimum:?}"),
            }
            // What each iteration says of itself is in order.
            let mut least = f64::INFINITY;
            for iteration in colony.history() {
                least = least.min(iteration.best);
                prop_assert_eq!(iteration.best_so_far, least);
                prop_assert!(iteration.best <= iteration.mean + 1e-9 && iteration.mean <= iteration.worst + 1e-9);
                prop_assert!(params.dead_end == DeadEnd::Die || iteration.arrived == params.ants);
            }
        }
    }
}

/// A room of 40 x 30 cells of 0.1 m with clutter, and a wall whose door can be shut.
fn room(door: bool) -> Costmap {
    let layout = GridLayout::new(40, 30, 0.1, Se2::default()).unwrap();
    let mut grid = Grid::filled(layout, cost::FREE);
    for k in 0..60 {
        grid.set(Cell::new(2 + k * 17 % 36, 2 + k * 11 % 26), cost::LETHAL);
    }
    for y in 0..30 {
        let open = door && (12..=14).contains(&y);
        for x in 19..=21 {
            grid.set(Cell::new(x, y), if open || x != 20 { cost::FREE } else { cost::LETHAL });
        }
    }
    Costmap::from_costs(grid)
}

fn start() -> Se2 {
    Se2::new(0.08, 0.05, 0.3)
}

fn goal() -> Se2 {
    Se2::new(3.92, 2.93, -1.0)
}

#[test]
fn the_planner_keeps_the_laws_of_its_role() {
    for params in kinds().into_iter().filter(|params| params.dead_end == DeadEnd::Retreat) {
        let mut planner = AntColony::new(GridPlannerParams::default(), params, Seed(3)).unwrap();
        assert_eq!(laws::global_planner(&mut planner, &room(true), &start(), &goal()), Ok(()), "{params:?}");
    }
}

#[test]
fn threads_and_earlier_queries_do_not_show() {
    for params in kinds() {
        let plan = |par, queries| {
            let mut planner =
                AntColony::new(GridPlannerParams::default(), params, Seed(7)).unwrap().with_parallelism(par);
            let mut path = Path::new();
            let mut outcome = None;
            for _ in 0..queries {
                // The last query is always that from start to goal in the open room.
                planner.plan_into(&room(false), &goal(), &Se2::new(3.0, 0.1, 0.0), &mut path).unwrap();
                outcome = Some(planner.plan_into(&room(true), &start(), &goal(), &mut path).unwrap());
            }
            (outcome, path, planner.solver().history().to_vec())
        };
        let reference = plan(Par::Seq, 1);
        for (par, queries) in [(Par::threads(2), 1), (Par::threads(4), 1), (Par::Seq, 2), (Par::threads(2), 3)] {
            assert_eq!(plan(par, queries), reference);
        }
    }
}

#[test]
fn seeds_differ() {
    let history = |seed| {
        let params = ColonyParams { iterations: 5, ..ColonyParams::aco() };
        let mut planner = AntColony::new(GridPlannerParams::default(), params, Seed(seed)).unwrap();
        planner.plan_into(&room(true), &start(), &goal(), &mut Path::new()).unwrap();
        planner.solver().history().to_vec()
    };
    assert_ne!(history(1), history(2));
}

#[test]
fn reasons_and_tolerances() {
    let plan = |costmap: &Costmap, planner: GridPlannerParams, start: Se2, goal: Se2| {
        let colony = ColonyParams { ants: 6, iterations: 4, ..ColonyParams::iaco() };
        let mut path = Path::new();
        let mut planner = AntColony::new(planner, colony, Seed(1)).unwrap();
        let outcome = planner.plan_into(costmap, &start, &goal, &mut path);
        (outcome, path)
    };
    let strict = GridPlannerParams::default();
    let (start, goal) = (self::start(), self::goal());
    let wall = Se2::new(2.05, 0.55, 0.0);
    let why = |outcome| match outcome {
        Ok(PlanOutcome::NoPath { reason, .. }) => Some(reason),
        _ => None,
    };
    assert_eq!(why(plan(&room(false), strict, start, goal).0), Some(NoPathReason::Disconnected));
    assert_eq!(why(plan(&room(true), strict, wall, goal).0), Some(NoPathReason::StartBlocked));
    assert_eq!(why(plan(&room(true), strict, start, wall).0), Some(NoPathReason::GoalBlocked));
    assert!(plan(&room(true), strict, start, Se2::new(9.0, 1.0, 0.0)).0.is_err());
    assert!(plan(&room(true), strict, Se2::new(f64::NAN, 1.0, 0.0), goal).0.is_err());
    // Behind the closed wall, what lies nearest to the goal on this side will do.
    let tolerant = GridPlannerParams { goal_tolerance: 3.0, ..strict };
    let (outcome, path) = plan(&room(false), tolerant, start, Se2::new(2.35, 1.55, 0.0));
    assert!(matches!(outcome, Ok(PlanOutcome::Found { .. })));
    assert!(path.points()[path.len() - 1].pose.x() < 2.0);
    // A budget of no steps still sends one iteration of ants.
    let (outcome, _) = plan(&room(true), GridPlannerParams { max_expansions: 0, ..strict }, start, goal);
    assert!(matches!(outcome, Ok(PlanOutcome::Found { .. })));
}

#[test]
fn cancelling_keeps_what_was_found() {
    let mut planner = AntColony::new(GridPlannerParams::default(), ColonyParams::aco(), Seed(1)).unwrap();
    let (mut path, mut asked) = (Path::new(), 0);
    let mut cancel = || {
        asked += 1;
        // The search for a way asks once, the ants after each iteration.
        asked == 4
    };
    let outcome = planner.plan_with_cancel(&room(true), &start(), &goal(), &mut path, &mut cancel).unwrap();
    assert!(matches!(outcome, PlanOutcome::Found { .. }));
    assert_eq!(planner.solver().history().len(), 3);
}

#[test]
fn refined_colonies_find_the_optimum_before_the_others_and_stop_when_patience_ends() {
    let length = |params: ColonyParams| {
        let mut planner = AntColony::new(GridPlannerParams::default(), params, Seed(5)).unwrap();
        match planner.plan_into(&room(true), &start(), &goal(), &mut Path::new()).unwrap() {
            PlanOutcome::Found { cost, .. } => cost,
            outcome => panic!("{outcome:?}"),
        }
    };
    let mut optimum = agv_plan::grid::Dijkstra::new(GridPlannerParams::default()).unwrap();
    let optimum = match optimum.plan_into(&room(true), &start(), &goal(), &mut Path::new()).unwrap() {
        PlanOutcome::Found { cost, .. } => cost,
        outcome => panic!("{outcome:?}"),
    };
    assert!((length(ColonyParams::refined()) - optimum).abs() < 1e-9);
    let refined = length(ColonyParams::refined());
    assert!(length(ColonyParams::iaco()) < 1.03 * refined && length(ColonyParams::aco()) > refined);
    // With patience the run ends early.
    let patient = ColonyParams { patience: 5, iterations: 1000, ..ColonyParams::refined() };
    let mut planner = AntColony::new(GridPlannerParams::default(), patient, Seed(5)).unwrap();
    planner.plan_into(&room(true), &start(), &goal(), &mut Path::new()).unwrap();
    let run = planner.solver().run();
    assert_eq!(run.iterations, run.converged + 5);
}

/// 50 x 50 cells from corner to corner, a fifth and a quarter of them blocked, no corner cut: IACO as printed arrives with every
/// seed, in the mean within 3 % of the shortest path. (On 160 runs it was 0.9 ± 0.1 %.)
#[test]
fn iaco_keeps_within_three_percent_of_the_optimum() {
    const WIDTH: usize = 50;
    let (start, goal) = ((WIDTH * (WIDTH - 1)) as u32, WIDTH as u32 - 1);
    let mut ratios = Vec::new();
    for (density, map) in [(0.2, 0), (0.2, 1), (0.25, 0), (0.25, 1)] {
        // The first map of the stream on which the corners are joined.
        let mut stream = Seed(map).stream(0, (100.0 * density) as u64);
        let (space, optimum) = loop {
            let blocked = |_| if stream.random::<f64>() < density { cost::LETHAL } else { cost::FREE };
            let costs = (0..WIDTH * WIDTH).map(blocked).collect();
            let space = space_of(WIDTH, costs, Connectivity::Eight, CornerRule::Never);
            let mut potential = Potential::default();
            if space.is_passable(start)
                && potential.compute(&space, goal).is_ok()
                && let Some(optimum) = potential.distance(start)
            {
                break (space, optimum);
            }
        };
        for seed in 0..3 {
            let mut colony = Colony::new(ColonyParams::iaco(), Seed(seed)).unwrap();
            colony.search(&space, start, goal, &mut Limits::none());
            ratios.push(colony.run().length.unwrap() / optimum);
        }
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    assert!(mean <= 1.03, "{mean}: {ratios:?}");
}

#[test]
fn bad_parameters_are_named() {
    let good = ColonyParams::iaco();
    let flat = Schedule::constant;
    let nan = f64::NAN;
    for (name, params) in [
        ("ants", ColonyParams { ants: 0, ..good }),
        ("ants", ColonyParams { ants: usize::MAX, ..good }),
        ("iterations", ColonyParams { iterations: 0, ..good }),
        ("alpha", ColonyParams { alpha: flat(-1.0), ..good }),
        ("alpha", ColonyParams { alpha: Schedule::linear(0.5, nan), ..good }),
        ("beta", ColonyParams { beta: flat(f64::INFINITY), ..good }),
        ("exponent", ColonyParams { beta: Schedule { exponent: 0.0, ..good.beta }, ..good }),
        ("evaporation", ColonyParams { evaporation: 0.0, ..good }),
        ("evaporation", ColonyParams { evaporation: 1.0, ..good }),
        ("quantity", ColonyParams { quantity: nan, ..good }),
        ("initial", ColonyParams { initial: 0.0, ..good }),
        ("q0", ColonyParams { greed: Greed::Constant(1.1), ..good }),
        ("q0", ColonyParams { greed: Greed::Fading(nan), ..good }),
        (
            "distance",
            ColonyParams {
                sight: Sight::Goal { distance: -1.0, direction: 0.3, reading: GoalDistance::Plain },
                ..good
            },
        ),
        (
            "sum",
            ColonyParams { sight: Sight::Goal { distance: 0.0, direction: 0.0, reading: GoalDistance::Plain }, ..good },
        ),
        ("threshold", ColonyParams { deposit: Deposit::Graded { threshold: 2.0 }, ..good }),
        ("pheromone floor", ColonyParams { limits: TrailLimits::Fixed { floor: 0.0, ceiling: 1.0 }, ..good }),
        ("pheromone ceiling", ColonyParams { limits: TrailLimits::Fixed { floor: 1.0, ceiling: 0.5 }, ..good }),
        ("span", ColonyParams { limits: TrailLimits::MaxMin { ants_worth: 1.0, span: 0.5 }, ..good }),
        ("ants_worth", ColonyParams { limits: TrailLimits::MaxMin { ants_worth: nan, span: 5.0 }, ..good }),
    ] {
        let error = Colony::new(params, Seed(0)).unwrap_err().to_string();
        assert!(error.starts_with(name), "{error}");
    }
    let weighted =
        GridPlannerParams { grid: GridParams { cost_weight: 1.0, ..Default::default() }, ..Default::default() };
    assert!(AntColony::new(weighted, good, Seed(0)).is_err());
}
