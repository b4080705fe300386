//! Grid search: microseconds and nanoseconds per expansion, on the query sets W (warehouse), D (brc202d) and C (Berlin).
//!
//! Where the shared data is not there, a synthetic warehouse stands in. The first lines printed give expansions and
//! nanoseconds per expansion (each query's best of several), ours and those of the crates `pathfinding` and `grid_pathfinding`;
//! criterion then times a part of a set, throughput in expansions.
#![allow(missing_docs, reason = "criterion's macros declare a function")]

mod peers;
mod sets;

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CellState, CornerRule, DistanceTransform, Grid, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, PlanOutcome};
use agv_plan::grid::{
    AStar, AStarParams, Bidirectional, DStarLite, Dijkstra, GridHeuristic, GridParams, GridPlannerParams, GridSpace,
    Heuristic, Jps, JpsPlus, LazyThetaStar, Limits, Octile, Offset, Potential, SearchEnd, Step, ThetaStar, Workspace,
    Zero,
};
use agv_support::movingai::Query;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use sets::{Set, sets};
use std::{hint::black_box, time::Instant};

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

/// Each `stride`-th query, best of several: microseconds mean and median, and nanoseconds per expansion.
fn report(set: &Set, (what, stride): (&str, usize), mut solve: impl FnMut(&Query) -> u64) {
    let (mut times, mut expansions) = (Vec::new(), 0);
    for query in set.queries.iter().step_by(stride) {
        let mut best = f64::INFINITY;
        for round in 0..if stride > 1 { 3 } else { 7 } {
            let begin = Instant::now();
            let expanded = black_box(solve(query));
            best = best.min(begin.elapsed().as_secs_f64() * 1e6);
            expansions += if round == 0 { expanded } else { 0 };
        }
        times.push(best);
    }
    times.sort_by(f64::total_cmp);
    let total: f64 = times.iter().sum();
    let mean = total / times.len() as f64;
    let per_expansion = if expansions > 0 { total * 1e3 / expansions as f64 } else { f64::NAN };
    eprintln!(
        "{} {what}: mean {mean:.1} us, median {:.1} us, {expansions} expansions, {per_expansion:.1} ns per expansion, {} queries",
        set.name,
        times[times.len() / 2],
        times.len(),
    );
}

/// Slow ones answer every so-manieth query.
const SAMPLE: usize = 10;

/// The planners that play the role, each with the same lengths as A*, or shorter ones; and every how-manieth query they answer.
fn planners() -> [(&'static str, usize, Box<dyn GlobalPlanner>); 8] {
    let (params, zero) = (GridPlannerParams::default(), GridHeuristic::Zero);
    let bidirectional = |heuristic| Bidirectional::new(AStarParams { heuristic, ..Default::default() }).unwrap();
    [
        ("A* as GlobalPlanner", 1, Box::new(AStar::new(AStarParams::default()).unwrap())),
        ("JPS", 1, Box::new(Jps::new(params).unwrap())),
        ("JPS+", 1, Box::new(JpsPlus::new(params).unwrap())),
        ("Dijkstra as GlobalPlanner", SAMPLE, Box::new(Dijkstra::new(params).unwrap())),
        ("bidirectional A*", SAMPLE, Box::new(bidirectional(GridHeuristic::Exact))),
        ("bidirectional Dijkstra", SAMPLE, Box::new(bidirectional(zero))),
        ("Theta*", 5 * SAMPLE, Box::new(ThetaStar::new(params).unwrap())),
        ("Lazy Theta*", 5 * SAMPLE, Box::new(LazyThetaStar::new(params).unwrap())),
    ]
}

/// A vehicle on its way, a cell of which is blocked and freed again ahead of it: replanning against planning anew.
fn report_replanning(set: &Set) {
    let params = GridPlannerParams::default();
    let (mut lite, mut anew) = (DStarLite::new(params).unwrap(), AStar::new(AStarParams::default()).unwrap());
    let (mut costmap, mut path, mut again) = (set.costmap.clone(), Path::new(), Path::new());
    let (mut times, mut expansions, mut events) = ([0.0; 2], [0; 2], 0);
    for query in set.queries.iter().step_by(5 * SAMPLE) {
        let (goal, mut here) = (pose(query.goal), pose(query.start));
        lite.plan_into(&costmap, &here, &goal, &mut path).unwrap();
        for _ in 0..5 {
            let ahead = path.points()[(path.len() - 1).min(6)].pose;
            let on_the_way = costmap.layout().cell_at(&path.points()[path.len() / 2].pose.translation()).unwrap();
            here = if path.len() > 8 { ahead } else { here };
            for value in [cost::LETHAL, cost::FREE] {
                costmap.settle();
                costmap.set(on_the_way, value);
                let planners: [&mut dyn GlobalPlanner; 2] = [&mut lite, &mut anew];
                let mut answers = [f64::NAN; 2];
                for (k, planner) in planners.into_iter().enumerate() {
                    let begin = Instant::now();
                    let outcome =
                        planner.plan_into(&costmap, &here, &goal, if k == 0 { &mut path } else { &mut again });
                    times[k] += begin.elapsed().as_secs_f64() * 1e6;
                    match outcome.unwrap() {
                        PlanOutcome::Found { expansions: n, cost } => {
                            expansions[k] += n;
                            answers[k] = cost;
                        }
                        PlanOutcome::NoPath { expansions: n, .. } => expansions[k] += n,
                        _ => {}
                    }
                }
                let [a, b] = answers;
                assert!((a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-6, "{a} for {b}");
                events += 1;
            }
            if path.len() < 3 {
                break;
            }
        }
    }
    let count = f64::from(events);
    eprintln!(
        "{} replanning, a change: D* Lite {:.1} us, {:.0} expansions; A* {:.1} us, {:.0} expansions",
        set.name,
        times[0] / count,
        expansions[0] as f64 / count,
        times[1] / count,
        expansions[1] as f64 / count
    );
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
        (0..15).map(|_| time(work)).fold(f64::INFINITY, f64::min)
    };
    let (mut potential, mut same) = (Potential::default(), set.space.clone());
    let field = best(&mut || potential.compute(&set.space, goal).unwrap());
    let build = best(&mut || {
        let mut space = GridSpace::new(GridParams::default()).unwrap();
        black_box(space.update(&set.costmap));
    });
    let states = (0..set.costmap.layout().len() as u32)
        .map(|n| if set.space.is_passable(n) { CellState::Free } else { CellState::Occupied });
    let map = Grid::new(*set.costmap.layout(), states.collect()).unwrap();
    let mut transform = DistanceTransform::default();
    let mut distances = transform.compute(&map).unwrap();
    let distance = best(&mut || transform.compute_into(&map, &mut distances).unwrap());
    // Equal costs in another object have to be compared.
    let copy = set.costmap.clone();
    let (copies, mut turn) = ([&copy, &set.costmap], 0);
    let compare = best(&mut || {
        black_box(same.update(copies[turn]));
        turn = 1 - turn;
    });
    eprintln!(
        "{} potential {:.1} ns per free cell; distances {:.1}, space built {:.2}, compared {:.3} ns per cell",
        set.name,
        field / free,
        distance / cells,
        build / cells,
        compare / cells
    );
}

/// Jump point search by the one rule of corners that `grid_pathfinding` knows, both on the same queries.
fn report_jumps(set: &Set) {
    let grid = GridParams { corner_rule: CornerRule::Free, ..Default::default() };
    let mut jps = Jps::new(GridPlannerParams { grid, ..Default::default() }).unwrap();
    let (jumps, mut path) = (peers::jump_grid(set), Path::new());
    let (mut longer, mut asked) = (0, 0);
    for query in set.queries.iter().step_by(SAMPLE) {
        let outcome = jps.plan_into(&set.costmap, &pose(query.start), &pose(query.goal), &mut path).unwrap();
        let PlanOutcome::Found { cost, .. } = outcome else { panic!("{outcome:?}") };
        let length = peers::jump_length(&jumps, query).unwrap();
        assert!(length >= cost - 1e-6, "{length} for {cost}");
        asked += 1;
        // It counts a diagonal as 99/70 of a straight step.
        longer += usize::from(length > cost * (1.0 + 1e-4));
    }
    eprintln!("{} grid_pathfinding's paths are longer than ours in {longer} of {asked} queries", set.name);
    report(set, ("JPS, corners free", SAMPLE), |q| {
        black_box(jps.plan_into(&set.costmap, &pose(q.start), &pose(q.goal), &mut path)).map_or(0, |_| 0)
    });
    report(set, ("grid_pathfinding JPS, corners free", SAMPLE), |q| {
        black_box(peers::jump(&jumps, q));
        0
    });
}

fn bench(c: &mut Criterion) {
    for set in sets() {
        let mut workspace = Workspace::default();
        let mut path = Path::new();
        // Answers first: ours, the peer's and the stated ones agree.
        for query in set.queries.iter().step_by(SAMPLE) {
            let (cost, _) = search(&set.space, &mut workspace, &octile(&set, query), query);
            assert_eq!(peers::astar(&set.space, query), Some(cost));
        }
        report(&set, ("A*", 1), |q| search(&set.space, &mut workspace, &octile(&set, q), q).1);
        for (what, stride, mut planner) in planners() {
            for query in set.queries.iter().step_by(stride) {
                let outcome =
                    planner.plan_into(&set.costmap, &pose(query.start), &pose(query.goal), &mut path).unwrap();
                let PlanOutcome::Found { cost, .. } = outcome else { panic!("{outcome:?}") };
                let is_shorter = what.contains("Theta") && cost < query.optimal_length;
                assert!(is_shorter || (cost - query.optimal_length).abs() < 1e-2, "{what}: {cost}");
            }
            report(&set, (what, stride), |q| {
                match planner.plan_into(&set.costmap, &pose(q.start), &pose(q.goal), &mut path) {
                    Ok(PlanOutcome::Found { expansions, .. }) => expansions,
                    _ => 0,
                }
            });
        }
        // The peers on a part of the queries, and ours on the same.
        report(&set, ("A* on the peers' queries", SAMPLE), |q| {
            search(&set.space, &mut workspace, &octile(&set, q), q).1
        });
        // Of the others' expansions nothing is known, or they say nothing.
        report(&set, ("pathfinding A*", SAMPLE), |q| {
            black_box(peers::astar(&set.space, q));
            0
        });
        report_jumps(&set);
        report_replanning(&set);
        report_map_work(&set);

        // Whole sets in criterion; every tenth query keeps the slow peers' share of the time bearable.
        let sample: Vec<&Query> = set.queries.iter().step_by(SAMPLE).collect();
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
            b.iter(|| count(&|q| u64::from(black_box(peers::astar(&set.space, q)).is_some())));
        });
        let expanded: u64 = sample.iter().map(|q| search(&set.space, &mut fresh, &Zero, q).1).sum();
        group.throughput(Throughput::Elements(expanded));
        group.bench_function("dijkstra", |b| {
            b.iter(|| sample.iter().map(|q| search(&set.space, &mut workspace, &Zero, q).1).sum::<u64>());
        });
        group.finish();
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
