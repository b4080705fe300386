//! Pose graphs on which the literature compares solvers: they end at the minimum that another program found.
//!
//! That program is a Gauss-Newton iteration with numeric derivatives in scipy, run until the sum of squares stood still to thirteen
//! digits, from the poses of the files.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2},
};
use agv_filters::graph::{PoseGraph, PoseGraphSolver, PoseGraphSolverParams, RigidMotion};
use agv_support::{
    g2o::{self, G2o, G2oPose},
    graphs,
};
use std::path::Path;

/// Solves from the relations alone and compares the sum of squares with the reference.
fn reaches<G: RigidMotion + G2oPose>(file: G2o<G>, reference: f64, most_steps: usize) -> PoseGraph<G> {
    let (mut graph, _) = file.into_graph().unwrap();
    let mut solver = PoseGraphSolver::new(PoseGraphSolverParams::default()).unwrap();
    assert!(solver.initialize(&mut graph).unwrap());
    let report = solver.optimize(&mut graph).unwrap();
    assert!(report.termination.converged() && report.iterations <= most_steps, "{report:?}");
    assert!((2.0 * report.cost / reference - 1.0).abs() < 1e-6, "{} {reference}", 2.0 * report.cost);
    graph
}

fn intel() -> Option<G2o<Se2>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/slam2d/INTEL_posegraph.g2o.gz");
    if !path.exists() {
        eprintln!("skipped: the shared data is not present");
        return None;
    }
    Some(g2o::read(path).unwrap())
}

/// 1228 poses and 256 closures, spoilt by the drive's odometry.
#[test]
fn the_graph_of_the_intel_log_closes() {
    if let Some(file) = intel() {
        reaches(file, 215.838_121_148_131_68, 15);
    }
}

#[test]
fn the_torus_closes() {
    reaches(graphs::torus(Seed(1)).graph, 5_614.184_391_444_88, 15);
}

#[test]
fn the_sphere_closes() {
    reaches(graphs::sphere(Seed(1)).graph, 14_474.943_786_233_984, 15);
}

#[test]
fn the_city_closes() {
    let world = graphs::manhattan(Seed(1));
    let graph = reaches(world.graph, 3_327.424_221_988_638, 15);
    let errors =
        graph.poses().iter().zip(&world.truth).map(|(a, b)| (a.translation() - b.translation()).norm_squared());
    let rmse = (errors.sum::<f64>() / world.truth.len() as f64).sqrt();
    assert!(rmse < 0.5, "{rmse}");
}

/// As a front end does it: a pose where odometry leads, and at every closure the whole graph again from where it is.
#[test]
fn a_graph_that_grows_ends_where_it_would_at_once() {
    let Some(file) = intel() else { return };
    let (whole, _) = file.into_graph().unwrap();
    let (mut graph, mut steps, mut closures) = (PoseGraph::new(), 0, 0);
    let mut solver = PoseGraphSolver::new(PoseGraphSolverParams::default()).unwrap();
    graph.add_pose(whole.poses()[0]).unwrap();
    for to in 1..whole.poses().len() {
        let mut sights = whole.relations().iter().filter(|r| r.to.index().max(r.from.index()) == to).peekable();
        let odometry = sights.peek().unwrap();
        let guess = graph.poses()[odometry.from.index()].compose(&odometry.from_from_to);
        graph.add_pose(guess).unwrap();
        for (i, relation) in sights.enumerate() {
            graph.add_relation(*relation).unwrap();
            if i > 0 {
                let report = solver.optimize(&mut graph).unwrap();
                assert!(report.termination.converged(), "{report:?}");
                (steps, closures) = (steps + report.iterations, closures + 1);
            }
        }
    }
    let report = solver.optimize(&mut graph).unwrap();
    assert!((2.0 * report.cost / 215.838_121_148_131_68 - 1.0).abs() < 1e-6, "{report:?}");
    assert!(steps < 8 * closures, "{steps} steps for {closures} closures");
}
