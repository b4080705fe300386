//! Group operations, beside nalgebra's isometries where they offer the same.

use agv_core::geometry::{LieGroup, Se2, Se3};
use agv_core::nalgebra::{Isometry2, Isometry3, Vector3, Vector6};
use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

const COUNT: usize = 1024;

/// Tangents that are neither tiny nor aligned with an axis.
fn wave(i: usize, k: usize) -> f64 {
    (1.0 + 0.7 * i as f64 + 2.3 * k as f64).sin()
}

fn planar() -> Vec<Vector3<f64>> {
    (0..COUNT).map(|i| Vector3::from_fn(|k, _| wave(i, k))).collect()
}

fn spatial() -> Vec<Vector6<f64>> {
    (0..COUNT).map(|i| Vector6::from_fn(|k, _| wave(i, k))).collect()
}

/// Composes pair by pair, so that the throughput is measured, not the latency of a chain.
fn compose(c: &mut Criterion) {
    let mut group = c.benchmark_group("geometry/compose");
    group.throughput(Throughput::Elements(COUNT as u64));
    let se2: Vec<Se2> = planar().iter().map(Se2::exp).collect();
    let isometry2: Vec<Isometry2<f64>> = se2.iter().map(|p| (*p).into()).collect();
    assert!((Se2::from(isometry2[0] * isometry2[1]).minus(&(se2[0] * se2[1]))).norm() < 1e-12);
    let se3: Vec<Se3> = spatial().iter().map(Se3::exp).collect();
    let isometry3: Vec<Isometry3<f64>> = se3.iter().map(|p| (*p).into()).collect();
    assert!((Se3::from(isometry3[0] * isometry3[1]).minus(&(se3[0] * se3[1]))).norm() < 1e-12);

    macro_rules! pairs {
        ($name:literal, $poses:expr, $op:expr) => {
            group.bench_function($name, |b| {
                let mut out = $poses.clone();
                b.iter(|| {
                    for (o, w) in out.iter_mut().zip(black_box(&$poses).windows(2)) {
                        *o = $op(&w[0], &w[1]);
                    }
                    black_box(&mut out);
                });
            });
        };
    }
    pairs!("Se2", se2, |a: &Se2, b: &Se2| a.compose(b));
    pairs!("nalgebra Isometry2", isometry2, |a: &Isometry2<f64>, b: &Isometry2<f64>| a * b);
    pairs!("Se3", se3, |a: &Se3, b: &Se3| a.compose(b));
    pairs!("nalgebra Isometry3", isometry3, |a: &Isometry3<f64>, b: &Isometry3<f64>| a * b);
    group.finish();
}

fn calculus(c: &mut Criterion) {
    let mut group = c.benchmark_group("geometry/calculus");
    group.throughput(Throughput::Elements(COUNT as u64));
    macro_rules! each {
        ($name:literal, $inputs:expr, $op:expr) => {
            let inputs = $inputs;
            group.bench_function($name, |b| {
                b.iter_batched_ref(
                    || inputs.iter().map($op).collect::<Vec<_>>(),
                    |out| out.iter_mut().zip(black_box(&inputs)).for_each(|(o, i)| *o = $op(i)),
                    BatchSize::LargeInput,
                );
            });
        };
    }
    each!("Se2 exp", planar(), Se2::exp);
    each!("Se2 log", planar().iter().map(Se2::exp).collect::<Vec<_>>(), Se2::log);
    each!("Se2 left Jacobian", planar(), Se2::left_jacobian);
    each!("Se2 left Jacobian inverse", planar(), Se2::left_jacobian_inverse);
    each!("Se3 exp", spatial(), Se3::exp);
    each!("Se3 log", spatial().iter().map(Se3::exp).collect::<Vec<_>>(), Se3::log);
    each!("Se3 left Jacobian", spatial(), Se3::left_jacobian);
    each!("Se3 left Jacobian inverse", spatial(), Se3::left_jacobian_inverse);
    group.finish();
}

criterion_group!(benches, compose, calculus);
criterion_main!(benches);
