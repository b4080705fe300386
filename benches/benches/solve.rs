//! Small solvers, beside nalgebra's dense Cholesky and the interior point method of clarabel.

#![expect(clippy::disallowed_types, reason = "the dense reference")]

use agv_core::geometry::{LieGroup, Se2};
use agv_core::nalgebra::{DMatrix, DVector, Vector2, Vector3};
use agv_core::solve::{
    BandedCholesky, BandedMatrix, Bound, LeastSquares, LevenbergMarquardt, LevenbergMarquardtParams, NormalEquations,
    QuadraticOutcome, QuadraticParams, QuadraticSolver, QuadraticVectors,
};
use clarabel::{
    algebra::CscMatrix,
    solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus},
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// The size of an elastic band: 100 poses of four unknowns, each tied to its neighbours.
const UNKNOWNS: usize = 400;
const HALF_BANDWIDTH: usize = 10;

fn band() -> BandedMatrix {
    let mut matrix = BandedMatrix::new(UNKNOWNS, HALF_BANDWIDTH);
    for column in 0..UNKNOWNS {
        for row in column..UNKNOWNS.min(column + HALF_BANDWIDTH + 1) {
            let value = if row == column { 12.0 } else { ((row * 7 + column) as f64).sin() };
            *matrix.entry(row, column).expect("inside the band") = value;
        }
    }
    matrix
}

fn banded(c: &mut Criterion) {
    let mut group = c.benchmark_group("solve/factor and solve, 400 unknowns");
    group.throughput(Throughput::Elements(UNKNOWNS as u64));
    let mut matrix = band();
    let rhs: Vec<f64> = (0..UNKNOWNS).map(|i| (i as f64).cos()).collect();
    let dense = DMatrix::from_fn(UNKNOWNS, UNKNOWNS, |i, j| matrix.entry(i.max(j), i.min(j)).map_or(0.0, |v| *v));
    let expected = dense.clone().cholesky().expect("diagonally dominant").solve(&DVector::from_column_slice(&rhs));

    let (mut factor, mut x) = (BandedCholesky::new(), rhs.clone());
    let mut solve = |x: &mut Vec<f64>| {
        x.copy_from_slice(&rhs);
        factor.factor(black_box(&matrix)).expect("positive definite");
        factor.solve(x).expect("factored");
    };
    solve(&mut x);
    assert!((DVector::from_column_slice(&x) - &expected).norm() < 1e-10);
    group.bench_function("banded, half bandwidth 10", |b| b.iter(|| solve(&mut x)));
    group.sample_size(20);
    group.bench_function("nalgebra dense", |b| {
        b.iter(|| black_box(&dense).clone().cholesky().map(|f| f.solve(&expected)));
    });
    group.finish();
}

/// The pose that maps 100 points onto 100 others.
struct Correspondences(Vec<(Vector2<f64>, Vector2<f64>)>);

impl LeastSquares<3> for Correspondences {
    type State = Se2;

    fn linearize(&mut self, pose: &Se2, normal: &mut NormalEquations<3>) {
        for (target, source) in &self.0 {
            normal.add(&(pose.act(source) - target), &pose.act_jacobians(source).0, 1.0);
        }
    }

    fn cost(&mut self, pose: &Se2) -> f64 {
        self.0.iter().map(|(target, source)| 0.5 * (pose.act(source) - target).norm_squared()).sum()
    }

    fn retract(&self, pose: &Se2, step: &Vector3<f64>) -> Se2 {
        pose.plus(step)
    }
}

fn levenberg_marquardt(c: &mut Criterion) {
    let truth = Se2::new(0.4, -0.2, 0.3);
    let point = |i: usize| Vector2::new((0.37 * i as f64).sin() * 5.0, (0.91 * i as f64).cos() * 5.0);
    let noise = |i: usize| Vector2::new((12.9 * i as f64).sin(), (78.2 * i as f64).sin()) * 0.01;
    let mut problem = Correspondences((0..100).map(|i| (truth.act(&point(i)) + noise(i), point(i))).collect());
    let solver = LevenbergMarquardt::new(LevenbergMarquardtParams::default()).expect("defaults are valid");
    let found = solver.minimize(&mut problem, Se2::default()).expect("finite");
    assert!(found.converged() && found.state.minus(&truth).norm() < 0.01);
    let mut group = c.benchmark_group("solve/Levenberg–Marquardt");
    group.throughput(Throughput::Elements(100));
    group.bench_function("SE(2) from 100 points", |b| {
        b.iter(|| solver.minimize(black_box(&mut problem), Se2::default()));
    });
    group.finish();
}

/// A vehicle that returns to a line at 1 m/s, condensed: each stage has an acceleration and a yaw rate; offset and speed
/// are bounded, tyres hold a polygon of both inputs, the yaw rate changes so much a stage.
struct Cycle {
    hessian: Vec<f64>,
    rows: Vec<f64>,
    gradient: Vec<f64>,
    row_limits: Vec<(f64, f64)>,
    limits: Vec<(f64, f64)>,
}

/// Row kinds: offset, speed, two sides of the polygon, change of the yaw rate.
const ROWS: usize = 5;

impl Cycle {
    fn new(stages: usize, [offset, heading, speed, rate]: [f64; 4]) -> Self {
        let (dt, n) = (0.1, 2 * stages);
        let mut rows = DMatrix::zeros(n, ROWS * stages); // a row per column, as they lie in memory
        let mut row_limits = vec![(0.0, 0.0); ROWS * stages];
        let mut errors = DVector::zeros(2 * stages);
        for k in 0..stages {
            let [y, v, outer, inner, turn] = [0, 1, 2, 3, 4].map(|kind| kind * stages + k);
            for j in 0..=k {
                rows[(2 * j, v)] = dt;
                rows[(2 * j + 1, y)] = dt * dt * ((k - j) as f64 + 0.5);
            }
            (errors[k], errors[stages + k]) = (offset + heading * dt * (k + 1) as f64, speed - 1.0);
            row_limits[y] = (-1.0 - errors[k], 1.0 - errors[k]);
            row_limits[v] = (-speed, 1.1 - speed);
            for (row, sign) in [(outer, 1.0), (inner, -1.0)] {
                (rows[(2 * k, row)], rows[(2 * k + 1, row)]) = (1.0, 0.8 * sign);
                row_limits[row] = (-0.7, 0.7);
            }
            rows[(2 * k + 1, turn)] = 1.0;
            if k > 0 {
                rows[(2 * k - 1, turn)] = -1.0;
            }
            let before = if k > 0 { 0.0 } else { rate };
            row_limits[turn] = (before - 0.2, before + 0.2);
        }
        let prediction = rows.columns(0, 2 * stages);
        let hessian = prediction * prediction.transpose() + DMatrix::identity(n, n) * 1e-3;
        let gradient = (prediction * errors).as_slice().to_vec();
        let limits = (0..n).map(|i| if i % 2 == 0 { (-0.5, 0.5) } else { (-0.8, 0.8) }).collect();
        Self { hessian: hessian.as_slice().to_vec(), rows: rows.as_slice().to_vec(), gradient, row_limits, limits }
    }

    fn solve(&self, solver: &mut QuadraticSolver) -> QuadraticOutcome {
        let split = |limits: &[(f64, f64)]| -> (Vec<f64>, Vec<f64>) { limits.iter().copied().unzip() };
        let ((lower, upper), (row_lower, row_upper)) = (split(&self.limits), split(&self.row_limits));
        solver.set_matrices(&self.hessian, &self.rows).expect("convex");
        let (lower, upper, row_lower, row_upper) = (&lower[..], &upper[..], &row_lower[..], &row_upper[..]);
        let vectors = QuadraticVectors { gradient: &self.gradient, lower, upper, row_lower, row_upper };
        solver.solve(&vectors).expect("finite")
    }

    /// The same, for a solver whose constraints are `A x ≤ b`.
    fn peer(&self) -> (CscMatrix<f64>, CscMatrix<f64>, Vec<f64>) {
        let (n, m) = (self.gradient.len(), self.row_limits.len());
        let normals = DMatrix::from_fn(n + m, n, |i, j| match i.checked_sub(n) {
            None => f64::from(u8::from(i == j)),
            Some(row) => self.rows[row * n + j],
        });
        let entries = |i: usize| (0..n).map(move |j| (i, j));
        let (upper, lower) = ((0..n + m).flat_map(entries), (0..n + m).flat_map(entries));
        let filled = |(i, j): &(usize, usize)| normals[(*i, *j)] != 0.0;
        let triplets: Vec<(usize, usize, f64)> = (upper.filter(filled).map(|(i, j)| (i, j, normals[(i, j)])))
            .chain(lower.filter(filled).map(|(i, j)| (n + m + i, j, -normals[(i, j)])))
            .collect();
        let [i, j] = [0, 1].map(|k| triplets.iter().map(|t| if k == 0 { t.0 } else { t.1 }).collect());
        let constraints = CscMatrix::new_from_triplets(2 * (n + m), n, i, j, triplets.iter().map(|t| t.2).collect());
        let all = || self.limits.iter().chain(&self.row_limits);
        let bounds = all().map(|l| l.1).chain(all().map(|l| -l.0)).collect();
        let half: Vec<(usize, usize)> = (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).collect();
        let values = half.iter().map(|(i, j)| self.hessian[i * n + j]).collect();
        let (i, j) = half.into_iter().unzip();
        (CscMatrix::new_from_triplets(n, n, i, j, values), constraints, bounds)
    }
}

/// The programmes that a controller meets on its way, and the iterations that it needs for them.
fn drive(stages: usize) -> (Vec<Cycle>, usize) {
    let [mut y, mut heading, mut v, mut rate] = [0.6, 0.0, 0.6, 0.0];
    let mut solver = controller(stages);
    let mut iterations = 0;
    let cycles = (0..20)
        .map(|_| {
            let cycle = Cycle::new(stages, [y, heading, v, rate]);
            shift(&mut solver, stages);
            let outcome = cycle.solve(&mut solver);
            assert!(outcome.solved() && outcome.primal_residual < 1e-9 && outcome.dual_residual < 1e-9, "{outcome:?}");
            iterations += outcome.iterations;
            rate = solver.solution()[1];
            y += 0.1 * heading + 0.005 * rate;
            heading += 0.1 * rate;
            v += 0.1 * solver.solution()[0];
            cycle
        })
        .collect();
    (cycles, iterations)
}

fn controller(stages: usize) -> QuadraticSolver {
    QuadraticSolver::new(2 * stages, ROWS * stages, QuadraticParams::default()).expect("defaults are valid")
}

/// Moves the working set on by a stage.
fn shift(solver: &mut QuadraticSolver, stages: usize) {
    let mut set: Vec<Bound> = solver.working_set().to_vec();
    let (inputs, rows) = set.split_at_mut(2 * stages);
    inputs.copy_within(2.., 0);
    rows.chunks_exact_mut(stages).for_each(|kind| kind.copy_within(1.., 0));
    solver.warm_start(&set).expect("of its size");
}

fn quadratic(c: &mut Criterion) {
    for stages in [10, 20, 30] {
        let (cycles, iterations) = drive(stages);
        let mut solver = controller(stages);
        let mut cold_iterations = 0;
        let settings = DefaultSettingsBuilder::default().verbose(false).build().expect("valid");
        let peers: Vec<_> = cycles.iter().map(|cycle| (cycle, cycle.peer())).collect();
        let peer = |(cycle, (hessian, constraints, bounds)): &(&Cycle, (CscMatrix, CscMatrix, Vec<f64>))| {
            let cones = [NonnegativeConeT(bounds.len())];
            let mut peer = DefaultSolver::new(hessian, &cycle.gradient, constraints, bounds, &cones, settings.clone())
                .expect("valid");
            peer.solve();
            peer
        };
        for case in &peers {
            solver.cold_start();
            let (ours, theirs) = (case.0.solve(&mut solver), peer(case));
            cold_iterations += ours.iterations;
            assert_eq!(theirs.solution.status, SolverStatus::Solved);
            assert!((ours.cost - theirs.solution.obj_val).abs() < 1e-6, "{} {}", ours.cost, theirs.solution.obj_val);
        }
        println!(
            "{stages} stages, 20 cycles: {cold_iterations} iterations from cold starts, {iterations} from shifted"
        );
        let mut group = c.benchmark_group(format!("solve/quadratic programme, {stages} stages of two inputs"));
        group.throughput(Throughput::Elements(cycles.len() as u64));
        group.sample_size(20);
        group.bench_function("20 cycles, cold", |b| {
            b.iter(|| {
                for cycle in black_box(&cycles) {
                    solver.cold_start();
                    black_box(cycle.solve(&mut solver));
                }
            });
        });
        group.bench_function("20 cycles, from the shifted working set", |b| {
            b.iter(|| {
                solver.cold_start();
                for cycle in black_box(&cycles) {
                    shift(&mut solver, stages);
                    black_box(cycle.solve(&mut solver));
                }
            });
        });
        group.bench_function("20 cycles, clarabel", |b| {
            b.iter(|| black_box(&peers).iter().for_each(|case| drop(peer(case))));
        });
        group.finish();
    }
}

criterion_group!(benches, banded, levenberg_marquardt, quadratic);
criterion_main!(benches);
