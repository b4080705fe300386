//! Grid planners and what shortens their paths.

use crate::{counter, scenes};
use agv_nav::core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    grid::{
        Cell, CellState, CollisionParams, Costmap, Footprint, Inflation, InflationParams, LocalMap, LocalMapParams,
        ObstacleMap, cost,
    },
    kinematics::MotionLimits,
    nalgebra::Vector2,
    obstacle::MovingObstacle,
    path::Path,
    roles::{GlobalPlanner, LocalPlanRequest, LocalPlanner, PlanOutcome, VehicleState},
};
use agv_nav::plan::{
    aco::{AntColony, ColonyParams, SparrowParams, SparrowSearch},
    dwa::{Dwa, DwaParams},
    grid::{
        AStar, AStarParams, Anya, Bidirectional, Components, Connectivity, DStarLite, Dijkstra, GridParams,
        GridPlannerParams, GridSpace, Jps, JpsPlus, LazyThetaStar, Potential, ThetaStar,
    },
    hybrid::{HybridAStar, HybridAStarParams},
    mppi::{Mppi, MppiParams},
    smooth::{CurvatureSmoother, CurvatureSmootherParams, KeyNodes, LineOfSightParams, PathSmoother, TautString},
};

/// The room inflated, and the same with another pillar.
fn costmaps() -> [Costmap; 2] {
    let mut changed = scenes::room();
    changed.set(Cell::new(90, 50), CellState::Occupied);
    let mut inflation = Inflation::new(InflationParams::default()).unwrap();
    [scenes::room(), changed].map(|map| inflation.inflate(&map).unwrap())
}

fn corners() -> [Se2; 2] {
    [Se2::new(0.6, 0.6, 0.0), Se2::new(7.4, 4.4, 0.0)]
}

fn grids() -> impl Iterator<Item = GridParams> {
    let of = |(connectivity, cost_weight)| GridParams { connectivity, cost_weight, ..Default::default() };
    [(Connectivity::Eight, 0.0), (Connectivity::Four, 0.0), (Connectivity::Eight, 2.0)].into_iter().map(of)
}

#[test]
fn grid_planners() {
    let costmaps = costmaps();
    let mut parted = costmaps[0].clone();
    for y in 0..102 {
        parted.set(Cell::new(80, y), cost::LETHAL);
    }
    for grid in grids() {
        let (guided, params) =
            (AStarParams { grid, ..Default::default() }, GridPlannerParams { grid, ..Default::default() });
        let mut planners: Vec<Box<dyn GlobalPlanner>> = vec![
            Box::new(AStar::new(guided).unwrap()),
            Box::new(Dijkstra::new(params).unwrap()),
            Box::new(Bidirectional::new(guided).unwrap()),
            Box::new(DStarLite::new(params).unwrap()),
        ];
        if grid.cost_weight == 0.0 {
            planners.push(Box::new(Jps::new(params).unwrap()));
            planners.push(Box::new(JpsPlus::new(params).unwrap()));
            planners.push(Box::new(Anya::new(params).unwrap()));
            planners.push(Box::new(ThetaStar::new(params).unwrap()));
            planners.push(Box::new(LazyThetaStar::new(params).unwrap()));
            let colony = ColonyParams { ants: 10, iterations: 5, ..ColonyParams::refined() };
            planners.push(Box::new(AntColony::new(params, colony, Seed(1)).unwrap()));
            let sparrows = SparrowParams { sparrows: 10, iterations: 5, ..SparrowParams::improved() };
            planners.push(Box::new(SparrowSearch::new(params, sparrows, Seed(1)).unwrap()));
        }
        for mut planner in planners {
            let mut path = Path::new();
            let mut run = |costmap: &Costmap, start: &Se2, goal: &Se2, is_joined: bool| {
                let outcome = planner.plan_into(costmap, start, goal, &mut path);
                assert_eq!(matches!(outcome, Ok(PlanOutcome::Found { .. })), is_joined, "{outcome:?}");
            };
            // Both maps, both ways, and no way: the open list, the path and the labels have had their sizes.
            let [start, goal] = corners();
            let mut round = || {
                for costmap in &costmaps {
                    run(costmap, &start, &goal, true);
                    run(costmap, &goal, &start, true);
                }
                run(&parted, &start, &goal, false);
            };
            round();
            assert_eq!(counter::count(round), 0, "{grid:?}");
        }
    }
}

/// A wall that comes and goes before a vehicle that drives to and fro.
#[test]
fn replanning() {
    let [mut costmap, _] = costmaps();
    let mut planner = DStarLite::new(GridPlannerParams::default()).unwrap();
    let ([start, goal], mut path) = (corners(), Path::new());
    let mut round = || {
        for (value, x) in [(254, 0.6), (0, 1.2), (254, 1.8), (0, 1.2)] {
            costmap.settle();
            for y in 10..70 {
                costmap.set(Cell::new(60, y), value);
            }
            planner.plan_into(&costmap, &Se2::new(x, start.y(), 0.0), &goal, &mut path).unwrap();
        }
    };
    for _ in 0..3 {
        round();
    }
    assert_eq!(counter::count(round), 0);
}

#[test]
fn potential_and_components() {
    let costmaps = costmaps();
    for grid in grids() {
        let mut space = GridSpace::new(grid).unwrap();
        let (mut potential, mut components) = (Potential::default(), Components::default());
        let mut run = |costmap: &Costmap| {
            space.update(costmap);
            let goal = space.node(Cell::new(150, 90)).unwrap();
            potential.compute(&space, goal).unwrap();
            space.components_into(&mut components);
            assert!(potential.distance(space.node(Cell::new(12, 12)).unwrap()).is_some());
        };
        costmaps.iter().for_each(&mut run);
        assert_eq!(counter::count(|| costmaps.iter().for_each(&mut run)), 0, "{grid:?}");
    }
}

/// Two queries for a vehicle that steers, one of them through a gap that leaves it 5 cm on either side.
#[test]
fn hybrid_a_star() {
    let mut map = scenes::room();
    for y in (0..102).filter(|y| !(48..56).contains(y)) {
        map.set(Cell::new(80, y), CellState::Occupied);
    }
    let costmap = Costmap::from_map(&map);
    let footprint = Footprint::rectangle(-0.15, 0.4, 0.3).unwrap();
    let mut planner = HybridAStar::new(HybridAStarParams::for_turning_radius(0.5).unwrap(), footprint).unwrap();
    let ([start, goal], mut path) = (corners(), Path::new());
    let mut round = || {
        for (from, to) in [(&start, &goal), (&goal, &start)] {
            let outcome = planner.plan_into(&costmap, from, to, &mut path);
            assert!(matches!(outcome, Ok(PlanOutcome::Found { .. })), "{outcome:?}");
        }
    };
    // Twice: buffers change places between two queries.
    round();
    round();
    assert_eq!(counter::count(round), 0);
}

#[test]
fn smoothers() {
    let [costmap, _] = costmaps();
    let (mut path, mut smooth) = (Path::new(), Path::new());
    let mut planner = AStar::new(AStarParams::default()).unwrap();
    let [start, goal] = corners();
    planner.plan_into(&costmap, &start, &goal, &mut path).unwrap();
    let sight = LineOfSightParams::default();
    let smoothers: [Box<dyn PathSmoother>; 2] =
        [Box::new(KeyNodes::new(sight).unwrap()), Box::new(TautString::new(sight).unwrap())];
    for mut smoother in smoothers {
        let mut run = || smoother.smooth_into(&costmap, &path, &mut smooth).unwrap();
        run();
        assert_eq!(counter::count(run), 0);
        assert!(smooth.len() < path.len());
    }
    let obstacles = ObstacleMap::new(&scenes::room(), CollisionParams::default(), Some(1.0)).unwrap();
    let mut smoother = CurvatureSmoother::new(CurvatureSmootherParams::default()).unwrap();
    let footprint = Footprint::circle(0.2).unwrap();
    let mut run = || assert!(smoother.smooth_into(&obstacles, &footprint, &path, &mut smooth).is_ok());
    run();
    assert_eq!(counter::count(run), 0);
}

#[test]
fn the_dynamic_window() {
    let outline = Footprint::rectangle(-0.2, 0.3, 0.4).unwrap();
    drives_without_allocating(&mut Dwa::new(DwaParams::for_footprint(&outline)).unwrap());
}

#[test]
fn the_path_integral() {
    let outline = Footprint::rectangle(-0.2, 0.3, 0.4).unwrap();
    drives_without_allocating(&mut Mppi::new(MppiParams::for_footprint(&outline), Seed(1)).unwrap());
}

/// Drives among people on a map that changes; none of it allocates the third time.
fn drives_without_allocating(planner: &mut dyn LocalPlanner) {
    let mut changed = scenes::room();
    changed.set(Cell::new(90, 50), CellState::Occupied);
    let costmaps = [scenes::room(), changed].map(|map| Costmap::from_map(&map));
    let mut map = LocalMap::new(&costmaps[0], LocalMapParams::default()).unwrap();
    let path = Path::from_positions(&[Vector2::new(0.6, 0.6), Vector2::new(3.5, 2.0)]).unwrap();
    let limits = MotionLimits::default();
    let person = [MovingObstacle::new(Vector2::new(3.0, 0.5), Vector2::new(0.0, 0.3), 0.2).unwrap()];
    let mut round = || {
        let mut state = VehicleState::new(Se2::new(0.6, 0.6, 0.0), Twist2::ZERO);
        for cycle in 0..60 {
            map.update(&costmaps[cycle / 10 % 2]).unwrap();
            let request =
                LocalPlanRequest { state, path: &path, map: &map, obstacles: &person, limits: &limits, dt: 0.1 };
            state = state.after(&planner.command(request).unwrap().motion, 0.1);
        }
        state
    };
    let first = round();
    assert_ne!(first.map_from_base, Se2::new(0.6, 0.6, 0.0));
    round();
    let again = || {
        round();
    };
    assert_eq!(counter::count(again), 0);
}
