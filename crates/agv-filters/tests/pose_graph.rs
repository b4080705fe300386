//! Pose graphs: against dense least squares, and on worlds whose truth is known.
#![expect(clippy::disallowed_types, reason = "the dense reference")]

use agv_core::{
    Error,
    compute::Seed,
    geometry::{LieGroup, Se2, Se3},
    metrics::chi_square_quantile,
    nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6},
    solve::RobustKernel,
};
use agv_filters::graph::{PoseGraph, PoseGraphSolver, PoseGraphSolverParams, PoseId, Prior, Relation, RigidMotion};
use rand::RngExt;
use rand_distr::StandardNormal;

/// A drive in rounds, with relations to the round before: the truth, the graph that odometry would start from, and what each
/// relation's noise was drawn with.
fn rounds<G: LieGroup>(seed: u64, step: &G, poses: usize, round: usize, sigma: &G::Tangent) -> (Vec<G>, PoseGraph<G>) {
    let mut stream = Seed(seed).stream(0, 0);
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
    graph.add_pose(G::identity()).unwrap();
    for i in 1..poses {
        truth.push(truth[i - 1].compose(step));
        let measured = noisy(&truth[i - 1].between(&truth[i]));
        let guess = graph.poses()[i - 1].compose(&measured);
        let (id, last) = (graph.add_pose(guess).unwrap(), PoseId(i as u32 - 1));
        graph.add_relation(Relation::new(last, id, measured, information)).unwrap();
        if i >= round {
            let before = PoseId((i - round) as u32);
            let measured = noisy(&truth[before.index()].between(&truth[i]));
            graph.add_relation(Relation::new(before, id, measured, information)).unwrap();
        }
    }
    (truth, graph)
}

fn solver<G: LieGroup>() -> PoseGraphSolver<G> {
    PoseGraphSolver::new(PoseGraphSolverParams::default()).unwrap()
}

/// Residuals of all relations, whitened, as a function of the poses but the first.
fn dense_residuals(graph: &PoseGraph<Se2>, poses: &[Se2]) -> DVector<f64> {
    let rows = graph.relations().iter().flat_map(|relation| {
        let predicted = poses[relation.from.index()].between(&poses[relation.to.index()]);
        let error: Vector3<f64> = relation.from_from_to.between(&predicted).log();
        let root = relation.information.cholesky().unwrap().l().transpose();
        (root * error).as_slice().to_vec()
    });
    DVector::from_iterator(3 * graph.relations().len(), rows)
}

/// Gauss–Newton with numeric derivatives on dense matrices, and the covariance at its end.
fn dense(graph: &PoseGraph<Se2>) -> (Vec<Se2>, DMatrix<f64>) {
    let mut poses = graph.poses().to_vec();
    let unknowns = 3 * (poses.len() - 1);
    let moved = |poses: &[Se2], step: &DVector<f64>| -> Vec<Se2> {
        let tail = poses[1..].iter().enumerate();
        let tail = tail.map(|(i, pose)| pose.plus(&Vector3::new(step[3 * i], step[3 * i + 1], step[3 * i + 2])));
        std::iter::once(poses[0]).chain(tail).collect()
    };
    let mut hessian = DMatrix::zeros(unknowns, unknowns);
    for _ in 0..20 {
        let here = dense_residuals(graph, &poses);
        let column = |i: usize| {
            let mut step = DVector::zeros(unknowns);
            step[i] = 1e-6;
            (dense_residuals(graph, &moved(&poses, &step)) - dense_residuals(graph, &moved(&poses, &-step))) / 2e-6
        };
        let jacobian = DMatrix::from_columns(&(0..unknowns).map(column).collect::<Vec<_>>());
        hessian = jacobian.transpose() * &jacobian;
        let step = -hessian.clone().cholesky().unwrap().solve(&(jacobian.transpose() * here));
        poses = moved(&poses, &step);
    }
    (poses, hessian.cholesky().unwrap().inverse())
}

#[test]
fn a_small_graph_is_solved_as_by_dense_least_squares() {
    let (_, mut graph) = rounds(3, &Se2::new(1.0, 0.1, 0.7), 20, 9, &Vector3::new(0.05, 0.05, 0.02));
    let (reference, covariance) = dense(&graph);
    let mut params = PoseGraphSolverParams::default();
    params.descent.cost_tolerance = 1e-14;
    let mut solver = PoseGraphSolver::new(params).unwrap();
    let report = solver.optimize(&mut graph).unwrap();
    assert!(report.termination.converged());
    for (pose, reference) in graph.poses().iter().zip(&reference) {
        assert!(pose.minus(reference).norm() < 1e-5, "{:?}", pose.minus(reference));
    }
    for pose in [1, 7, 19] {
        let ours = solver.covariance(PoseId(pose)).unwrap();
        let first = 3 * (pose as usize - 1);
        let theirs = covariance.fixed_view::<3, 3>(first, first).into_owned();
        assert!((ours - theirs).norm() < 1e-3 * theirs.norm(), "{ours} {theirs}");
    }
    assert_eq!(solver.covariance(PoseId(0)), Some(Matrix3::zeros()), "the first pose stays");
    assert_eq!(solver.covariance(PoseId(20)), None);
}

/// Twice the least cost of a graph with `m` measured and `n` sought numbers has the chi-square distribution of `m - n` degrees, and
/// poses are off by what their covariance says.
fn costs_and_errors_are_those_of_the_noise<G: LieGroup>(step: &G, sigma: &G::Tangent) {
    let (mut squares, mut errors, seeds) = (0.0, 0.0, 20);
    let mut freedom = 0;
    for seed in 0..seeds {
        let (truth, mut graph) = rounds(seed, step, 120, 17, sigma);
        freedom = G::DOF * (graph.relations().len() - (graph.poses().len() - 1));
        let mut solver = solver();
        let report = solver.optimize(&mut graph).unwrap();
        assert!(report.termination.converged(), "{report:?}");
        squares += 2.0 * report.cost;
        let covariance = solver.covariance(PoseId(60)).unwrap();
        let error = truth[60].between(&graph.poses()[60]).log();
        let weighted = G::inverse_of(&covariance).unwrap() * error;
        errors += G::tangent_slice(&error).iter().zip(G::tangent_slice(&weighted)).map(|(a, b)| a * b).sum::<f64>();
    }
    // One in a thousand on each side.
    let within = |value: f64, freedom: usize| {
        let quantile = |p| chi_square_quantile(freedom as f64, p).unwrap();
        assert!(value > quantile(0.001) && value < quantile(0.999), "{value} of {freedom} degrees");
    };
    within(squares, seeds as usize * freedom);
    within(errors, seeds as usize * G::DOF);
}

#[test]
fn costs_and_errors_in_the_plane_are_those_of_the_noise() {
    costs_and_errors_are_those_of_the_noise(&Se2::new(1.0, 0.0, 0.37), &Vector3::new(0.03, 0.02, 0.01));
}

#[test]
fn costs_and_errors_in_space_are_those_of_the_noise() {
    let step = Se3::exp(&Vector6::new(1.0, 0.0, 0.05, 0.01, 0.02, 0.37));
    costs_and_errors_are_those_of_the_noise(&step, &Vector6::new(0.03, 0.02, 0.02, 0.004, 0.005, 0.01));
}

#[test]
fn false_closures_do_not_bend_a_robust_graph() {
    let sigma = Vector3::new(0.02, 0.02, 0.01);
    let kernel = RobustKernel::GemanMcClure { scale: 5.0 };
    let worst = |robust: bool| {
        let (truth, mut graph) = rounds(5, &Se2::new(1.0, 0.0, 0.37), 120, 17, &sigma);
        for (from, to) in [(3, 60), (20, 95), (40, 111), (8, 77)] {
            let false_closure = Relation::new(PoseId(from), PoseId(to), Se2::default(), Matrix3::identity() * 2500.0);
            let kernel = if robust { kernel } else { RobustKernel::Square };
            graph.add_relation(false_closure.with_kernel(kernel)).unwrap();
        }
        solver().optimize(&mut graph).unwrap();
        truth.iter().zip(graph.poses()).map(|(t, p)| (t.translation() - p.translation()).norm()).fold(0.0, f64::max)
    };
    let (plain, robust) = (worst(false), worst(true));
    assert!(plain > 1.0 && robust < 0.2, "{plain} {robust}");
}

/// Among 174 closures 90 false ones, each by itself: the poses are nearly those of a graph without them, for either bounded kernel,
/// where wide kernels come first.
#[test]
fn many_false_closures_are_found_by_stages() {
    let (scale, sigma) = (4.0, Vector3::new(0.05, 0.05, 0.02));
    let kernels = [RobustKernel::GemanMcClure { scale }, RobustKernel::DynamicCovarianceScaling { scale }];
    for (seed, kernel) in [(1, kernels[0]), (2, kernels[1]), (3, kernels[0]), (4, kernels[1])] {
        let (_, mut clean) = rounds(seed, &Se2::new(1.0, 0.0, 0.05), 300, 126, &sigma);
        let mut spoilt = PoseGraph::new();
        for pose in clean.poses() {
            spoilt.add_pose(*pose).unwrap();
        }
        for relation in clean.relations() {
            let odometry = relation.to.0 == relation.from.0 + 1;
            let kernel = if odometry { RobustKernel::Square } else { kernel };
            spoilt.add_relation(relation.with_kernel(kernel)).unwrap();
        }
        let mut stream = Seed(seed).stream(5, 0);
        for _ in 0..90 {
            let (from, to) = (stream.random_range(0..140), stream.random_range(150..300));
            let measured = Se2::new(
                stream.random_range(-9.0..9.0),
                stream.random_range(-9.0..9.0),
                stream.random_range(-3.0..3.0),
            );
            let relation = Relation::new(PoseId(from), PoseId(to), measured, clean.relations()[0].information);
            spoilt.add_relation(relation.with_kernel(kernel)).unwrap();
        }
        solver().optimize(&mut clean).unwrap();
        let report = solver().optimize_graduated(&mut spoilt).unwrap();
        assert!(report.termination.converged(), "{report:?}");
        let off = clean.poses().iter().zip(spoilt.poses()).map(|(a, b)| (a.translation() - b.translation()).norm());
        let worst = off.fold(0.0, f64::max);
        assert!(worst < 0.3, "{seed}: {worst}");
    }
}

/// How one pose lies to another does not depend on which pose of the graph stays.
fn relations_are_as_certain_whatever_stays<G: LieGroup>(step: &G, sigma: &G::Tangent) {
    let (_, mut graph) = rounds(4, step, 40, 17, sigma);
    let mut solver = solver();
    solver.optimize(&mut graph).unwrap();
    let pairs = [(5, 30), (30, 5), (0, 20), (20, 0), (12, 12)].map(|(from, to)| (PoseId(from), PoseId(to)));
    let ours = pairs.map(|(from, to)| solver.relative_covariance(&graph, from, to).unwrap());
    for ((from, to), ours) in pairs.into_iter().zip(ours) {
        graph.hold(from).unwrap();
        solver.optimize(&mut graph).unwrap();
        let reference = solver.covariance(to).unwrap();
        graph.release(from).unwrap();
        let most = G::matrix_slice(&reference).iter().fold(1e-9, |m: f64, v| m.max(v.abs()));
        let off = G::matrix_slice(&(ours - reference)).iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        assert!(off < 1e-4 * most, "{from:?} {to:?}: {ours:?} {reference:?}");
    }
    assert_eq!(solver.relative_covariance(&graph, PoseId(0), PoseId(40)), None);
}

#[test]
fn relations_are_as_certain_whatever_stays_in_the_plane_and_in_space() {
    relations_are_as_certain_whatever_stays(&Se2::new(1.0, 0.0, 0.37), &Vector3::new(0.03, 0.02, 0.01));
    let step = Se3::exp(&Vector6::new(1.0, 0.0, 0.05, 0.01, 0.02, 0.37));
    relations_are_as_certain_whatever_stays(&step, &Vector6::new(0.03, 0.02, 0.02, 0.004, 0.005, 0.01));
}

#[test]
fn what_nothing_ties_stays_and_what_is_held_too() {
    let unit = Matrix3::identity();
    let mut graph = PoseGraph::new();
    let ids: Vec<_> = (0..6).map(|i| graph.add_pose(Se2::new(f64::from(i), 0.5, 0.1)).unwrap()).collect();
    // A pair, a pose by itself, and three poses of which the middle one is held and the last has a prior.
    graph.add_relation(Relation::new(ids[1], ids[0], Se2::new(-2.0, 0.0, 0.0), unit)).unwrap();
    graph.add_relation(Relation::new(ids[3], ids[4], Se2::new(1.0, 0.0, 0.0), unit)).unwrap();
    graph.add_relation(Relation::new(ids[4], ids[5], Se2::new(1.0, 0.0, 0.0), unit)).unwrap();
    graph.hold(ids[4]).unwrap();
    graph.add_prior(Prior::new(ids[5], Se2::new(7.0, 0.0, 0.0), unit)).unwrap();
    let before = graph.poses().to_vec();
    let mut solver = solver();
    assert!(solver.optimize(&mut graph).unwrap().termination.converged());
    for still in [0, 2, 4] {
        assert_eq!(graph.poses()[still], before[still]);
    }
    assert!(graph.poses()[1].between(&graph.poses()[0]).minus(&Se2::new(-2.0, 0.0, 0.0)).norm() < 1e-6);
    let last = graph.poses()[5].x();
    assert!(last > 5.5 && last < 6.5, "between its relation and its prior: {last}");
    // Nothing at all is no fault.
    assert!(solver.optimize(&mut PoseGraph::new()).unwrap().termination.converged());
}

/// What is known of no pose's heading is no covariance.
#[test]
fn what_is_not_determined_has_no_covariance() {
    let mut graph = PoseGraph::new();
    let ids = [0.0, 1.0, 2.0].map(|x| graph.add_pose(Se2::new(x, 0.0, 0.0)).unwrap());
    for pair in ids.windows(2) {
        graph.add_relation(Relation::new(pair[0], pair[1], Se2::new(1.0, 0.0, 0.0), Matrix3::identity())).unwrap();
    }
    let place = Matrix3::from_diagonal(&Vector3::new(100.0, 100.0, 0.0));
    graph.add_prior(Prior::new(ids[0], Se2::default(), place)).unwrap();
    let mut solver = solver();
    assert_eq!(solver.covariance(ids[0]), None, "nothing was optimised yet");
    solver.optimize(&mut graph).unwrap();
    assert_eq!(solver.covariance(ids[2]), None);
    graph.add_prior(Prior::new(ids[2], Se2::new(2.0, 0.0, 0.0), place)).unwrap();
    solver.optimize(&mut graph).unwrap();
    let covariance = solver.covariance(ids[2]).unwrap();
    assert_eq!(covariance, covariance.transpose());
}

#[test]
fn a_solver_serves_graphs_that_grow() {
    let sigma = Vector3::new(0.03, 0.03, 0.01);
    let (_, whole) = rounds(9, &Se2::new(1.0, 0.0, 0.37), 60, 17, &sigma);
    let (mut grown, mut solver) = (PoseGraph::new(), solver());
    for (i, pose) in whole.poses().iter().enumerate() {
        // Where the graph that was corrected so far says that odometry leads.
        let guess =
            whole.relations().iter().find(|r| r.to.index() == i && r.from.index() + 1 == i).map_or(*pose, |r| {
                let poses: &[Se2] = grown.poses();
                poses[i - 1].compose(&r.from_from_to)
            });
        grown.add_pose(guess).unwrap();
        whole.relations().iter().filter(|r| r.to.index() == i).for_each(|r| grown.add_relation(*r).unwrap());
        solver.optimize(&mut grown).unwrap();
    }
    let mut at_once = whole;
    solver.optimize(&mut at_once).unwrap();
    for (a, b) in grown.poses().iter().zip(at_once.poses()) {
        assert!(a.minus(b).norm() < 1e-3, "{:?}", a.minus(b));
    }
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    let mut graph = PoseGraph::new();
    assert!(matches!(graph.add_pose(Se2::new(f64::NAN, 0.0, 0.0)), Err(Error::NotFinite { name: "pose", .. })));
    let (a, b) = (graph.add_pose(Se2::default()).unwrap(), graph.add_pose(Se2::default()).unwrap());
    let unit = Matrix3::identity();
    let absent = PoseId(7);
    for relation in [
        Relation::new(a, absent, Se2::default(), unit),
        Relation::new(absent, b, Se2::default(), unit),
        Relation::new(a, a, Se2::default(), unit),
        Relation::new(a, b, Se2::new(f64::INFINITY, 0.0, 0.0), unit),
        Relation::new(a, b, Se2::default(), -unit),
        Relation::new(a, b, Se2::default(), unit * f64::NAN),
        Relation::new(a, b, Se2::default(), unit).with_kernel(RobustKernel::Huber { scale: 0.0 }),
    ] {
        assert!(graph.add_relation(relation).is_err(), "{relation:?}");
    }
    assert!(graph.add_prior(Prior::new(absent, Se2::default(), unit)).is_err());
    assert!(graph.add_prior(Prior::new(a, Se2::default(), -unit)).is_err());
    assert!(graph.release(absent).is_err() && graph.set_pose(absent, Se2::default()).is_err());
    assert!(graph.set_pose(a, Se2::new(0.0, 0.0, f64::NAN)).is_err() && graph.poses()[0] == Se2::default());
    assert!(graph.hold(absent).is_err() && graph.relations().is_empty() && graph.priors().is_empty());
    let mut params = PoseGraphSolverParams::default();
    params.descent.initial_damping = f64::NAN;
    assert!(PoseGraphSolver::<Se2>::new(params).is_err());
    for graduation in [1.0, 0.0, f64::NAN, f64::INFINITY] {
        let params = PoseGraphSolverParams { graduation, ..Default::default() };
        assert!(matches!(PoseGraphSolver::<Se2>::new(params), Err(Error::OutOfRange { name: "graduation", .. })));
    }
    // Residuals that overflow: an error, and the poses stay.
    graph.add_relation(Relation::new(a, b, Se2::new(1e200, 0.0, 0.0), unit)).unwrap();
    let before = graph.clone();
    let mut solver = solver();
    assert!(solver.optimize(&mut graph).is_err() && solver.optimize_graduated(&mut graph).is_err());
    assert_eq!((&graph, solver.covariance(b)), (&before, None));
}

#[cfg(feature = "serde")]
#[test]
fn stored_graphs_are_checked_and_go_on_bit_by_bit() {
    let (_, mut graph) =
        rounds(2, &Se3::exp(&Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.4)), 40, 15, &Vector6::repeat(0.02));
    graph.hold(PoseId(3)).unwrap();
    graph.add_prior(Prior::new(PoseId(5), graph.poses()[5], nalgebra::Matrix6::identity())).unwrap();
    let text = serde_json::to_string(&graph).unwrap();
    let mut again: PoseGraph<Se3> = serde_json::from_str(&text).unwrap();
    assert_eq!(again, graph);
    solver().optimize(&mut graph).unwrap();
    solver().optimize(&mut again).unwrap();
    assert_eq!(again, graph);
    let damaged = text.replacen("\"to\":1,", "\"to\":99,", 1);
    assert_ne!(damaged, text);
    assert!(serde_json::from_str::<PoseGraph<Se3>>(&damaged).is_err());
}

/// Whatever the poses were: without noise the guess is the truth, and with noise the descent from it ends where that from the truth
/// ends.
fn guesses_do_not_depend_on_the_poses<G: RigidMotion>(step: &G, sigma: &G::Tangent) {
    for (scale, seed) in [(0.0, 1), (1.0, 2), (1.0, 3)] {
        let noise = *sigma * scale + *sigma * 1e-6;
        let (truth, graph) = rounds(seed, step, 80, 17, &noise);
        let descend = |poses: &mut dyn FnMut(usize) -> G, guess: bool| {
            let mut other = PoseGraph::new();
            for i in 0..truth.len() {
                other.add_pose(poses(i)).unwrap();
            }
            graph.relations().iter().for_each(|relation| other.add_relation(*relation).unwrap());
            other.add_prior(Prior::new(PoseId(11), truth[11], G::identity_matrix() * 1e4)).unwrap();
            let mut solver = solver();
            assert!(!guess || solver.initialize(&mut other).unwrap());
            let guessed = other.clone();
            assert!(solver.optimize(&mut other).unwrap().termination.converged());
            (guessed, other)
        };
        let mut stream = Seed(seed).stream(7, 0);
        let mut anywhere = |_| {
            let entries: Vec<f64> = (0..G::DOF).map(|_| stream.random_range(-3.0..3.0)).collect();
            G::exp(&G::tangent_from_slice(&entries))
        };
        let (guessed, ours) = descend(&mut anywhere, true);
        let (_, reference) = descend(&mut |i| truth[i], false);
        for (i, pose) in ours.poses().iter().enumerate() {
            let off = |other: &G| G::tangent_slice(&pose.minus(other)).iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            assert!(off(&reference.poses()[i]) < 1e-3, "{seed} {i}: {pose:?}");
            assert!(scale > 0.0 || off(&guessed.poses()[i]) < 1e-5, "{i}");
        }
    }
}

#[test]
fn guesses_do_not_depend_on_the_poses_in_the_plane_or_in_space() {
    guesses_do_not_depend_on_the_poses(&Se2::new(1.0, 0.0, 0.37), &Vector3::new(0.03, 0.02, 0.01));
    let step = Se3::exp(&Vector6::new(1.0, 0.0, 0.05, 0.01, 0.02, 0.37));
    guesses_do_not_depend_on_the_poses(&step, &Vector6::new(0.03, 0.02, 0.02, 0.004, 0.005, 0.01));
}

/// A pose that was added is as if it had not been, and all that was said of it.
#[test]
fn a_pose_that_is_popped_leaves_nothing() {
    let (_, mut graph) = rounds(3, &Se2::new(1.0, 0.0, 0.3), 12, 5, &Vector3::new(0.02, 0.02, 0.01));
    let before = graph.clone();
    let id = graph.add_pose(Se2::new(1.0, 2.0, 0.3)).unwrap();
    graph.hold(id).unwrap();
    graph.add_relation(Relation::new(PoseId(2), id, Se2::default(), Matrix3::identity())).unwrap();
    graph.add_relation(Relation::new(id, PoseId(4), Se2::default(), Matrix3::identity())).unwrap();
    graph.add_prior(Prior::new(id, Se2::default(), Matrix3::identity())).unwrap();
    assert_eq!(graph.pop_pose(), Some(Se2::new(1.0, 2.0, 0.3)));
    assert_eq!(graph, before);
    solver().optimize(&mut graph).unwrap();
    assert_eq!(PoseGraph::<Se2>::new().pop_pose(), None);
}
