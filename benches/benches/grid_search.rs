//! Grid search: microseconds and nanoseconds per expansion, on the query sets W (warehouse), D (brc202d) and C (Berlin).
//!
//! Where the shared data is not there, a synthetic warehouse stands in. The first lines printed give expansions and
//! nanoseconds per expansion (each query's best of three); criterion then times a whole set, throughput in expansions.
#![allow(missing_docs, reason = "criterion's macros declare a function")]

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, PlanOutcome};
use agv_plan::grid::{
    AStar, AStarParams, Bidirectional, GridHeuristic, GridParams, GridPlannerParams, GridSpace, Heuristic, Jps,
    LazyThetaStar, Limits, Octile, Offset, Potential, SearchEnd, Step, ThetaStar, Workspace, Zero,
};
use agv_support::movingai::{Query, read_map, read_scenario};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::{hint::black_box, path::PathBuf, time::Instant};

struct Set {
    name: &'static str,
    costmap: Costmap,
    space: GridSpace,
    queries: Vec<Query>,
}

fn sets() -> Vec<Set> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/gridplan"));
    let files = [("W", "warehouse-20-40-10-2-2"), ("D", "brc202d"), ("C", "Berlin_1_1024")];
    let mut sets: Vec<Set> = files
        .into_iter()
        .filter_map(|(name, map)| {
            let costmap = Costmap::from_map(&read_map(folder.join(format!("movingai/{map}.map.gz"))).ok()?);
            let queries = read_scenario(folder.join(format!("bench/{name}.scen.gz"))).ok()?;
            Some(set(name, costmap, queries))
        })
        .collect();
    if sets.is_empty() {
        sets.push(synthetic());
    }
    sets
}

fn set(name: &'static str, costmap: Costmap, queries: Vec<Query>) -> Set {
    let mut space = GridSpace::new(GridParams::default()).unwrap();
    space.update(&costmap);
    Set { name, costmap, space, queries }
}

/// Blocks of racks with aisles of two cells, 340 x 164 as the public warehouse; optima by Dijkstra.
fn synthetic() -> Set {
    let layout = GridLayout::new(340, 164, 1.0, Se2::default()).unwrap();
    let rack = |c: Cell| c.x % 14 >= 2 && c.y % 4 >= 2 && (10..330).contains(&c.x) && (4..160).contains(&c.y);
    let state = |i| if rack(layout.cell(i)) { CellState::Occupied } else { CellState::Free };
    let costmap = Costmap::from_map(&Grid::new(layout, (0..layout.len()).map(state).collect()).unwrap());
    let free: Vec<Cell> = (0..layout.len()).map(|i| layout.cell(i)).filter(|&c| !rack(c)).collect();
    let pick = |k: usize| free[k * 7919 % free.len()];
    let size = (layout.width(), layout.height());
    let query = |k: usize| Query {
        bucket: 0,
        map: "synthetic".into(),
        size,
        start: pick(2 * k),
        goal: pick(2 * k + 1),
        optimal_length: f64::NAN,
    };
    let queries = (0..200).map(query).collect();
    let mut set = set("synthetic", costmap, queries);
    let mut workspace = Workspace::default();
    for i in 0..set.queries.len() {
        let query = set.queries[i].clone();
        search(&set.space, &mut workspace, &Zero, &query);
        let mut way = Vec::new();
        workspace.trace_into(&set.space.uniform(), set.space.node(query.goal).unwrap(), &mut way);
        set.queries[i].optimal_length = set.space.path_cost(&way);
    }
    set
}

fn search(space: &GridSpace, workspace: &mut Workspace<Step>, heuristic: &impl Heuristic, query: &Query) -> (u32, u64) {
    let (start, goal) = (space.node(query.start).unwrap(), space.node(query.goal).unwrap());
    let result = workspace.search(&space.uniform(), heuristic, start, |n| n == goal, &mut Limits::none());
    match result.end {
        SearchEnd::Goal { cost, .. } => (cost, result.expansions),
        _ => (u32::MAX, result.expansions),
    }
}

fn octile(set: &Set, query: &Query) -> Octile {
    Octile(Offset::new(set.costmap.layout().width() as u32, query.goal))
}

fn pose(cell: Cell) -> Se2 {
    Se2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5, 0.0)
}

/// `pathfinding`'s A* with the same integers, heuristic and corner rule.
fn peer(space: &GridSpace, query: &Query) -> Option<u32> {
    let (start, goal) = (space.node(query.start)?, space.node(query.goal)?);
    let width = space.layout()?.width() as u32;
    let octile = Octile(Offset::new(width, query.goal));
    let successors = |&node: &u32| {
        let mask = space.mask(node);
        Step::ALL.into_iter().filter(move |step| mask & step.bit() != 0).map(move |step| {
            let stride = (step.dx() as u32).wrapping_add((step.dy() as u32).wrapping_mul(width));
            let cost = if step.is_diagonal() { agv_plan::grid::DIAGONAL } else { agv_plan::grid::STRAIGHT };
            (node.wrapping_add(stride), cost)
        })
    };
    pathfinding::directed::astar::astar(&start, successors, |&n| octile.estimate(n), |&n| n == goal).map(|r| r.1)
}

/// Best of three per query: microseconds mean and median, and nanoseconds per expansion.
fn report(set: &Set, what: &str, mut solve: impl FnMut(&Query) -> u64) {
    let (mut times, mut expansions) = (Vec::new(), 0);
    for query in &set.queries {
        let mut best = f64::INFINITY;
        for round in 0..3 {
            let begin = Instant::now();
            let expanded = solve(query);
            best = best.min(begin.elapsed().as_secs_f64() * 1e6);
            expansions += if round == 0 { expanded } else { 0 };
        }
        times.push(best);
    }
    times.sort_by(f64::total_cmp);
    let total: f64 = times.iter().sum();
    eprintln!(
        "{} {what}: mean {:.1} us, median {:.1} us, {} expansions, {:.1} ns per expansion",
        set.name,
        total / times.len() as f64,
        times[times.len() / 2],
        expansions,
        total * 1e3 / expansions as f64
    );
}

/// The others that play the role; each with the same lengths as A*, or shorter ones.
fn planners() -> [(&'static str, Box<dyn GlobalPlanner>); 5] {
    let (params, zero) = (GridPlannerParams::default(), GridHeuristic::Zero);
    let bidirectional = |heuristic| Bidirectional::new(AStarParams { heuristic, ..Default::default() }).unwrap();
    [
        ("bidirectional A*", Box::new(bidirectional(GridHeuristic::Exact))),
        ("bidirectional Dijkstra", Box::new(bidirectional(zero))),
        ("JPS", Box::new(Jps::new(params).unwrap())),
        ("Theta*", Box::new(ThetaStar::new(params).unwrap())),
        ("Lazy Theta*", Box::new(LazyThetaStar::new(params).unwrap())),
    ]
}

/// Work per cell of the map: the full potential, a space built anew, and one that finds its map unchanged.
fn report_map_work(set: &Set) {
    let goal = set.space.node(set.queries[0].goal).unwrap();
    let free = (0..set.costmap.layout().len() as u32).filter(|&node| set.space.is_passable(node)).count() as f64;
    let cells = set.costmap.layout().len() as f64;
    let best = |work: &mut dyn FnMut()| {
        let time = |work: &mut dyn FnMut()| {
            let begin = Instant::now();
            work();
            begin.elapsed().as_secs_f64() * 1e9
        };
        (0..7).map(|_| time(work)).fold(f64::INFINITY, f64::min)
    };
    let (mut potential, mut same) = (Potential::default(), set.space.clone());
    let field = best(&mut || potential.compute(&set.space, goal).unwrap());
    let build = best(&mut || {
        let mut space = GridSpace::new(GridParams::default()).unwrap();
        black_box(space.update(&set.costmap));
    });
    let compare = best(&mut || {
        black_box(same.update(&set.costmap));
    });
    eprintln!(
        "{} potential {:.1} ns per free cell; space built {:.2}, compared {:.3} ns per cell",
        set.name,
        field / free,
        build / cells,
        compare / cells
    );
}

fn bench(c: &mut Criterion) {
    for set in sets() {
        let mut workspace = Workspace::default();
        let mut planner = AStar::new(AStarParams::default()).unwrap();
        let mut path = Path::new();
        // Answers first: ours, the role's, the peer's and the stated ones agree.
        let mut expansions = 0;
        for (number, query) in set.queries.iter().enumerate() {
            let (cost, expanded) = search(&set.space, &mut workspace, &octile(&set, query), query);
            expansions += expanded;
            let outcome = planner.plan_into(&set.costmap, &pose(query.start), &pose(query.goal), &mut path).unwrap();
            let PlanOutcome::Found { cost: metres, .. } = outcome else { panic!("{outcome:?}") };
            assert!((metres - query.optimal_length).abs() < 1e-2, "{number}");
            if number % 10 == 0 {
                assert_eq!(peer(&set.space, query), Some(cost), "{number}");
            }
        }
        for (what, mut planner) in planners() {
            for query in set.queries.iter().step_by(20) {
                let outcome =
                    planner.plan_into(&set.costmap, &pose(query.start), &pose(query.goal), &mut path).unwrap();
                let PlanOutcome::Found { cost, .. } = outcome else { panic!("{outcome:?}") };
                let is_shorter = what.contains("Theta") && cost < query.optimal_length;
                assert!(is_shorter || (cost - query.optimal_length).abs() < 1e-2, "{what}: {cost}");
            }
        }
        report(&set, "A*", |q| search(&set.space, &mut workspace, &octile(&set, q), q).1);
        report(&set, "Dijkstra", |q| search(&set.space, &mut workspace, &Zero, q).1);
        report(&set, "A* as GlobalPlanner", |q| {
            match planner.plan_into(&set.costmap, &pose(q.start), &pose(q.goal), &mut path) {
                Ok(PlanOutcome::Found { expansions, .. }) => expansions,
                _ => 0,
            }
        });

        for (what, mut planner) in planners() {
            report(&set, what, |q| match planner.plan_into(&set.costmap, &pose(q.start), &pose(q.goal), &mut path) {
                Ok(PlanOutcome::Found { expansions, .. }) => expansions,
                _ => 0,
            });
        }

        report_map_work(&set);

        // Whole sets in criterion; every tenth query keeps the slow peers' share of the time bearable.
        let sample: Vec<&Query> = set.queries.iter().step_by(10).collect();
        let mut group = c.benchmark_group(format!("grid_search/{}", set.name));
        group.sample_size(10);
        let count = |h: &dyn Fn(&Query) -> u64| sample.iter().map(|q| h(q)).sum::<u64>();
        let mut fresh = Workspace::default();
        let expanded: u64 = sample.iter().map(|q| search(&set.space, &mut fresh, &octile(&set, q), q).1).sum();
        group.throughput(Throughput::Elements(expanded));
        group.bench_function("astar", |b| {
            b.iter(|| sample.iter().map(|q| search(&set.space, &mut workspace, &octile(&set, q), q).1).sum::<u64>());
        });
        group.bench_function("pathfinding_astar", |b| {
            b.iter(|| count(&|q| u64::from(black_box(peer(&set.space, q)).is_some())));
        });
        let expanded: u64 = sample.iter().map(|q| search(&set.space, &mut fresh, &Zero, q).1).sum();
        group.throughput(Throughput::Elements(expanded));
        group.bench_function("dijkstra", |b| {
            b.iter(|| sample.iter().map(|q| search(&set.space, &mut workspace, &Zero, q).1).sum::<u64>());
        });
        group.finish();
        assert!(expansions > 0);
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
