//! Pose graphs, from a guess by their relations to the minimum: rounds in the plane and in space.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Se3},
    nalgebra::{Vector3, Vector6},
};
use agv_filters::graph::{PoseGraph, PoseGraphSolver, PoseGraphSolverParams, PoseId, Relation, RigidMotion};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::RngExt;
use rand_distr::StandardNormal;

const POSES: usize = 2000;

/// A drive of 2000 poses in rounds of 50, each related to the one before and to that of the round before.
fn rounds<G: LieGroup>(step: &G, sigma: &G::Tangent) -> PoseGraph<G> {
    let mut stream = Seed(1).stream(0, 0);
    let mut noisy = |truth: &G| {
        let draws: Vec<f64> =
            G::tangent_slice(sigma).iter().map(|s| s * stream.sample::<f64, _>(StandardNormal)).collect();
        truth.plus(&G::tangent_from_slice(&draws))
    };
    let mut diagonal = vec![0.0; G::DOF * G::DOF];
    for (i, s) in G::tangent_slice(sigma).iter().enumerate() {
        diagonal[i * (G::DOF + 1)] = 1.0 / (s * s);
    }
    let information = G::matrix_from_slice(&diagonal);
    let (mut truth, mut graph) = (vec![G::identity()], PoseGraph::new());
    graph.add_pose(G::identity()).expect("finite");
    for i in 1..POSES {
        truth.push(truth[i - 1].compose(step));
        let measured = noisy(&truth[i - 1].between(&truth[i]));
        let id = graph.add_pose(graph.poses()[i - 1].compose(&measured)).expect("finite");
        graph.add_relation(Relation::new(PoseId(i as u32 - 1), id, measured, information)).expect("sound");
        if let Some(before) = i.checked_sub(50) {
            let measured = noisy(&truth[before].between(&truth[i]));
            graph.add_relation(Relation::new(PoseId(before as u32), id, measured, information)).expect("sound");
        }
    }
    graph
}

fn solve<G: RigidMotion>(c: &mut Criterion, name: &str, graph: &PoseGraph<G>) {
    let mut group = c.benchmark_group(format!("pose_graph/{name}"));
    group.sample_size(20).throughput(Throughput::Elements(graph.relations().len() as u64));
    let mut solver = PoseGraphSolver::new(PoseGraphSolverParams::default()).expect("sound");
    let mut solved = graph.clone();
    assert!(solver.initialize(&mut solved).expect("sound"));
    let guess = solved.clone();
    let report = solver.optimize(&mut solved).expect("sound");
    assert!(report.termination.converged());
    println!("{name}: {} iterations, cost {}", report.iterations, report.cost);
    group.bench_function("guess", |b| {
        b.iter_batched_ref(|| graph.clone(), |g| solver.initialize(g), criterion::BatchSize::LargeInput)
    });
    group.bench_function("optimise", |b| {
        b.iter_batched_ref(|| guess.clone(), |g| solver.optimize(g), criterion::BatchSize::LargeInput)
    });
    group.finish();
}

fn pose_graph(c: &mut Criterion) {
    solve(c, "2000 poses in the plane", &rounds(&Se2::new(1.0, 0.0, 0.1257), &Vector3::new(0.03, 0.02, 0.005)));
    let step = Se3::exp(&Vector6::new(1.0, 0.0, 0.02, 0.0, 0.0, 0.1257));
    solve(c, "2000 poses in space", &rounds(&step, &Vector6::new(0.03, 0.02, 0.02, 0.004, 0.005, 0.005)));
}

criterion_group!(benches, pose_graph);
criterion_main!(benches);
