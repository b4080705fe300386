//! The stated optima of public `MovingAI` scenarios (Sturtevant 2012; Stern et al. 2019), where the data lies beside the
//! repository.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Costmap};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, PlanOutcome};
use agv_plan::grid::{
    AStarParams, Bidirectional, BucketQueue, DStarLite, Dijkstra, GridParams, GridPlannerParams, GridSpace, HeapQueue,
    Heuristic, Jps, JpsPlus, Limits, Octile, Offset, OpenList, SearchEnd, Step, Workspace, Zero,
};
use agv_support::movingai::{Query, read_map, read_scenario};
use std::path::PathBuf;

/// Map, scenario, and every how-manieth query is asked.
const SETS: [(&str, &str, usize); 9] = [
    ("arena.map.gz", "arena.map.scen.gz", 1),
    ("den312d.map.gz", "den312d.map.scen.gz", 1),
    ("warehouse-10-20-10-2-1.map.gz", "warehouse-10-20-10-2-1-random-1.scen.gz", 1),
    ("warehouse-20-40-10-2-2.map.gz", "warehouse-20-40-10-2-2-even-1.scen.gz", 1),
    ("maze-128-128-2.map.gz", "maze-128-128-2-random-1.scen.gz", 1),
    ("random-32-32-20.map.gz", "random-32-32-20-random-1.scen.gz", 1),
    ("brc202d.map.gz", "brc202d.map.scen.gz", 15),
    ("maze512-8-0.map.gz", "maze512-8-0.map.scen.gz", 60),
    ("Berlin_1_1024.map.gz", "Berlin_1_1024.map.scen.gz", 80),
];

fn data(file: &str) -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/gridplan/movingai")).join(file)
}

fn solve<Q: OpenList>(
    (space, workspace): (&GridSpace, &mut Workspace<Step, Q>),
    heuristic: &impl Heuristic,
    query: &Query,
    way: &mut Vec<u32>,
) -> f64 {
    let (start, goal) = (space.node(query.start).unwrap(), space.node(query.goal).unwrap());
    let view = space.uniform();
    let result = workspace.search(&view, heuristic, start, |node| node == goal, &mut Limits::none());
    assert!(matches!(result.end, SearchEnd::Goal { node, .. } if node == goal));
    workspace.trace_into(&view, goal, way);
    assert_eq!((way.first(), way.last()), (Some(&start), Some(&goal)));
    space.path_cost(way)
}

/// Every step joins neighbours and passes no corner, read from the costmap itself.
fn assert_drivable(costmap: &Costmap, space: &GridSpace, way: &[u32]) {
    for pair in way.windows(2) {
        let (a, b) = (space.cell(pair[0]), space.cell(pair[1]));
        assert_eq!((a.x - b.x).abs().max((a.y - b.y).abs()), 1);
        for cell in [a, b, Cell::new(a.x, b.y), Cell::new(b.x, a.y)] {
            assert!(costmap.is_traversable(cell), "{cell:?}");
        }
    }
}

#[test]
fn all_queries_reach_their_stated_optimum() {
    let mut asked = 0;
    for (map, scenario, every) in SETS {
        if !data(map).exists() {
            eprintln!("{map}: not there, skipped");
            continue;
        }
        let costmap = Costmap::from_map(&read_map(data(map)).unwrap());
        let queries = read_scenario(data(scenario)).unwrap();
        let mut space = GridSpace::new(GridParams::default()).unwrap();
        space.update(&costmap);
        let (mut workspace, mut way) = (Workspace::<Step, BucketQueue>::default(), Vec::new());
        let mut heap_workspace = Workspace::<Step, HeapQueue>::default();
        let width = costmap.layout().width() as u32;
        for (number, query) in queries.iter().enumerate().step_by(every) {
            let octile = Octile(Offset::new(width, query.goal));
            let cost = solve((&space, &mut workspace), &octile, query, &mut way);
            assert!(
                (cost - query.optimal_length).abs() < 1e-2,
                "{scenario} {number}: {cost} for {}",
                query.optimal_length
            );
            assert_drivable(&costmap, &space, &way);
            // The slower combinations on a part of them: exactly the same cost.
            if number % (8 * every) == 0 {
                let dijkstra = solve((&space, &mut workspace), &Zero, query, &mut way);
                let heap = solve((&space, &mut heap_workspace), &octile, query, &mut way);
                assert!((dijkstra - cost).abs() < 1e-9 && (heap - cost).abs() < 1e-9, "{scenario} {number}");
            }
            asked += 1;
        }
    }
    eprintln!("{asked} queries");
}

/// The others that promise the shortest way, through their role, on fewer queries.
#[test]
fn every_planner_reaches_the_stated_optima() {
    let params = GridPlannerParams::default();
    // Some search the map from end to end.
    let mut planners: Vec<(&str, usize, Box<dyn GlobalPlanner>)> = vec![
        ("JPS", 1, Box::new(Jps::new(params).unwrap())),
        ("JPS+", 1, Box::new(JpsPlus::new(params).unwrap())),
        ("Dijkstra", 10, Box::new(Dijkstra::new(params).unwrap())),
        ("bidirectional", 10, Box::new(Bidirectional::new(AStarParams::default()).unwrap())),
        ("D* Lite", 40, Box::new(DStarLite::new(params).unwrap())),
    ];
    for (map, scenario, every) in SETS {
        if !data(map).exists() {
            eprintln!("{map}: not there, skipped");
            continue;
        }
        let costmap = Costmap::from_map(&read_map(data(map)).unwrap());
        let queries = read_scenario(data(scenario)).unwrap();
        let pose = |cell| {
            let centre = costmap.layout().center(cell);
            Se2::new(centre.x, centre.y, 0.0)
        };
        let mut path = Path::new();
        for (name, share, planner) in &mut planners {
            for (number, query) in queries.iter().enumerate().step_by(every * *share) {
                let outcome = planner.plan_into(&costmap, &pose(query.start), &pose(query.goal), &mut path).unwrap();
                let PlanOutcome::Found { cost, .. } = outcome else {
                    panic!("{name}, {scenario} {number}: {outcome:?}")
                };
                let want = query.optimal_length * costmap.layout().resolution();
                assert!((cost - want).abs() < 1e-2, "{name}, {scenario} {number}: {cost} for {want}");
                assert!((path.length() - cost).abs() < 1e-6, "{name}, {scenario} {number}");
            }
        }
    }
}
