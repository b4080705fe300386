//! Pose graphs, from a guess by their relations to the minimum: the Intel log where the shared data is present, a city, a torus and a
//! sphere; and the Intel log once more as a front end solves it, anew from where it is at each of its closures.
//!
//! Throughput is in relations. The answers are checked in `crates/agv-filters/tests/pose_graph_worlds.rs`; here that they converge.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2},
};
use agv_filters::graph::{PoseGraph, PoseGraphSolver, PoseGraphSolverParams, RigidMotion};
use agv_support::{
    g2o::{self, G2o, G2oPose},
    graphs,
};
use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};

fn solver<G: RigidMotion>() -> PoseGraphSolver<G> {
    PoseGraphSolver::new(PoseGraphSolverParams::default()).expect("sound")
}

fn solve<G: RigidMotion + G2oPose>(c: &mut Criterion, name: &str, file: G2o<G>) {
    let (graph, _) = file.into_graph().expect("sound");
    let mut group = c.benchmark_group(format!("pose_graph/{name}"));
    group.sample_size(20).throughput(Throughput::Elements(graph.relations().len() as u64));
    let (mut solver, mut solved) = (solver(), graph.clone());
    assert!(solver.initialize(&mut solved).expect("sound"));
    let guess = solved.clone();
    let report = solver.optimize(&mut solved).expect("sound");
    assert!(report.termination.converged());
    println!("{name}: {} steps, sum of squares {}", report.iterations, 2.0 * report.cost);
    group.bench_function("guess", |b| {
        b.iter_batched_ref(|| graph.clone(), |g| solver.initialize(g), BatchSize::LargeInput);
    });
    group.bench_function("optimise", |b| {
        b.iter_batched_ref(|| guess.clone(), |g| solver.optimize(g), BatchSize::LargeInput);
    });
    // All that a first closure costs: the order of elimination, a guess and the descent.
    group.bench_function("from nothing", |b| {
        b.iter_batched_ref(
            || (graph.clone(), self::solver()),
            |(graph, solver)| (solver.initialize(graph), solver.optimize(graph)),
            BatchSize::LargeInput,
        );
    });
    group.finish();
}

/// A drive as it comes: poses where odometry leads, and a descent at each closure.
fn grow(whole: &PoseGraph<Se2>, by_pose: &[Vec<usize>], solver: &mut PoseGraphSolver<Se2>) -> PoseGraph<Se2> {
    let mut graph = PoseGraph::new();
    graph.add_pose(whole.poses()[0]).expect("finite");
    for sights in &by_pose[1..] {
        for (i, relation) in sights.iter().map(|i| &whole.relations()[*i]).enumerate() {
            if i == 0 {
                graph.add_pose(graph.poses()[relation.from.index()].compose(&relation.from_from_to)).expect("finite");
            }
            graph.add_relation(*relation).expect("sound");
            if i > 0 {
                solver.optimize(&mut graph).expect("finite");
            }
        }
    }
    graph
}

fn pose_graph(c: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/slam2d/INTEL_posegraph.g2o.gz");
    if let Ok(file) = g2o::read::<Se2>(path) {
        let (whole, _) = file.clone().into_graph().expect("sound");
        solve(c, "intel", file);
        let mut by_pose = vec![Vec::new(); whole.poses().len()];
        for (i, relation) in whole.relations().iter().enumerate() {
            by_pose[relation.from.index().max(relation.to.index())].push(i);
        }
        let mut group = c.benchmark_group("pose_graph/intel");
        group.sample_size(10).throughput(Throughput::Elements(whole.relations().len() as u64));
        let mut solver = solver();
        assert_eq!(grow(&whole, &by_pose, &mut solver).poses().len(), whole.poses().len());
        group.bench_function("growing", |b| b.iter(|| grow(&whole, &by_pose, &mut solver)));
        group.finish();
    }
    solve(c, "city", graphs::manhattan(Seed(1)).graph);
    solve(c, "torus", graphs::torus(Seed(1)).graph);
    solve(c, "sphere", graphs::sphere(Seed(1)).graph);
}

criterion_group!(benches, pose_graph);
criterion_main!(benches);
