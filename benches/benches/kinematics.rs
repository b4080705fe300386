//! Wheels to twists and back, the clamps, and exact arcs beside Euler steps.

use agv_core::{
    geometry::{LieGroup, Se2, Twist2},
    kinematics::{DifferentialDrive, DifferentialParams, Kinematics, Mecanum, MecanumParams, TwistLimits, euler_step},
    odometry::{EncoderParams, RotTransRot, WheelNoise, WheelOdometry},
    time::Stamp,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn round_trips<K: Kinematics>(vehicle: &K, twists: &[Twist2]) -> f64 {
    twists.iter().filter_map(|t| vehicle.inverse(black_box(t)).ok()).map(|w| vehicle.forward(&w).vx).sum()
}

fn kinematics(c: &mut Criterion) {
    let twists: Vec<Twist2> =
        (0..1000).map(|i| Twist2::new(f64::from(i % 37) * 0.1 - 1.0, 0.0, f64::from(i % 23) * 0.1 - 1.1)).collect();
    let drive = DifferentialDrive::new(DifferentialParams::default()).expect("sound parameters");
    let carrier = Mecanum::new(MecanumParams::default()).expect("sound parameters");
    let limits = TwistLimits::default();
    let sum: f64 = twists.iter().map(|t| t.vx).sum();
    assert!((round_trips(&drive, &twists) - sum).abs() < 1e-9 && (round_trips(&carrier, &twists) - sum).abs() < 1e-9);
    let mut group = c.benchmark_group("kinematics");
    group.throughput(Throughput::Elements(twists.len() as u64));
    group.bench_function("differential_round_trip", |b| b.iter(|| round_trips(&drive, &twists)));
    group.bench_function("mecanum_round_trip", |b| b.iter(|| round_trips(&carrier, &twists)));
    group.bench_function("clamp_step", |b| {
        let step = |now: Twist2, target| limits.step(&now, black_box(target), 0.05).unwrap_or(Twist2::ZERO);
        b.iter(|| twists.iter().fold(Twist2::ZERO, step));
    });
    group.bench_function("arc", |b| {
        b.iter(|| twists.iter().fold(Se2::default(), |pose, t| pose.compose(&black_box(t).integrate(0.05))));
    });
    group.bench_function("euler", |b| {
        b.iter(|| twists.iter().fold(Se2::default(), |pose, t| euler_step(&pose, black_box(t), 0.05)));
    });
}

fn odometry(c: &mut Criterion) {
    let drive = DifferentialDrive::new(DifferentialParams::default()).expect("sound parameters");
    let odometry =
        WheelOdometry::new(drive, EncoderParams::default(), WheelNoise::default()).expect("sound parameters");
    let mut group = c.benchmark_group("odometry");
    group.throughput(Throughput::Elements(1));
    let (start, end) = (Stamp::default(), Stamp::from_seconds(0.02));
    group.bench_function("increment", |b| b.iter(|| odometry.increment(start, end, black_box(&[0.1, 0.12]), &[])));
    let motion = Se2::new(0.1, 0.01, 0.05);
    group.bench_function("rot_trans_rot", |b| b.iter(|| RotTransRot::from_motion(black_box(&motion)).to_motion()));
}

criterion_group!(benches, kinematics, odometry);
criterion_main!(benches);
