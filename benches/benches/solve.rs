//! Small solvers, beside nalgebra's dense Cholesky.

#![expect(clippy::disallowed_types, reason = "the dense reference")]

use agv_core::geometry::{LieGroup, Se2};
use agv_core::nalgebra::{DMatrix, DVector, Vector2, Vector3};
use agv_core::solve::{
    BandedCholesky, BandedMatrix, LeastSquares, LevenbergMarquardt, LevenbergMarquardtParams, NormalEquations,
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

criterion_group!(benches, banded, levenberg_marquardt);
criterion_main!(benches);
