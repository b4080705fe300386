//! Controllers and path trackers: nanoseconds per update.

use agv_control::{
    pid::{Pid, PidParams},
    track::{Lqr, LqrParams, Mpc, MpcParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams},
};
use agv_core::{
    geometry::Twist2,
    kinematics::MotionLimits,
    nalgebra::Vector2,
    path::Path,
    roles::{Controller, PathTracker, VehicleState},
};
use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn pid(c: &mut Criterion) {
    let params = PidParams {
        integral: 0.5,
        derivative: 0.1,
        filter_time: 0.02,
        output_min: -1.0,
        output_max: 1.0,
        ..PidParams::default()
    };
    let mut pid = Pid::new(params).expect("good parameters");
    let mut measurement = 0.0;
    c.bench_function("pid/update", |b| {
        b.iter(|| {
            measurement += 0.01 * (pid.update(black_box(1.0), measurement, 0.01).expect("finite") - measurement);
        });
    });
}

/// A figure of eight of 1000 points, driven as far as 200 cycles lead: the progress search is amortised over them.
fn trackers(c: &mut Criterion) {
    const CYCLES: u32 = 200;
    let positions: Vec<_> = (0..1000)
        .map(|i| f64::from(i) / 999.0 * std::f64::consts::TAU)
        .map(|t| Vector2::new(3.0 * t.sin(), 3.0 * t.sin() * t.cos()))
        .collect();
    let path = Path::from_positions(&positions).expect("finite");
    let limits = MotionLimits::default();
    let start = VehicleState::new(path.points()[0].pose, Twist2::new(1.0, 0.0, 0.0));
    let drive = |tracker: &mut dyn PathTracker| {
        let mut state = start;
        for _ in 0..CYCLES {
            let command = tracker.command(&state, &limits, 0.02).expect("good state");
            state = state.after(&command.motion, 0.02);
        }
        state
    };
    let mut group = c.benchmark_group("track/eight_1000");
    group.throughput(Throughput::Elements(u64::from(CYCLES)));
    let mut pure_pursuit = PurePursuit::new(PurePursuitParams::default()).expect("good parameters");
    pure_pursuit.set_path(&path).expect("a path");
    group.bench_function("pure_pursuit", |b| {
        b.iter_batched_ref(|| pure_pursuit.clone(), |tracker| drive(tracker), BatchSize::SmallInput);
    });
    let mut pid = PidTracker::new(PidTrackerParams::default()).expect("good parameters");
    pid.set_path(&path).expect("a path");
    group.bench_function("pid", |b| {
        b.iter_batched_ref(|| pid.clone(), |tracker| drive(tracker), BatchSize::SmallInput);
    });
    group.finish();
}

/// The optimal trackers on an S with aisle corners, where limits bind: a whole drive, per command.
fn optimal(c: &mut Criterion) {
    const CYCLES: u32 = 200;
    let positions: Vec<_> =
        (0..400).map(|i| 0.02 * f64::from(i)).map(|s| Vector2::new(s, 0.6 * (1.0 - (2.0 * s).cos()))).collect();
    let path = Path::from_positions(&positions).expect("finite");
    let limits = MotionLimits::default();
    let start = VehicleState::new(path.points()[0].pose, Twist2::ZERO);
    let drive = |tracker: &mut dyn PathTracker| {
        let mut state = start;
        for _ in 0..CYCLES {
            let command = tracker.command(&state, &limits, 0.02).expect("good state");
            state = state.after(&command.motion, 0.02);
        }
        state
    };
    let mut group = c.benchmark_group("track/optimal");
    group.throughput(Throughput::Elements(u64::from(CYCLES)));
    let mut lqr = Lqr::new(LqrParams::default()).expect("good parameters");
    lqr.set_path(&path).expect("a path");
    group.bench_function("lqr", |b| {
        b.iter_batched_ref(|| lqr.clone(), |tracker| drive(tracker), BatchSize::SmallInput);
    });
    for horizon in [10, 20, 30] {
        let mut mpc = Mpc::new(MpcParams { horizon, ..MpcParams::default() }).expect("good parameters");
        mpc.set_path(&path).expect("a path");
        group.bench_function(format!("mpc/{horizon}"), |b| {
            b.iter_batched_ref(|| mpc.clone(), |tracker| drive(tracker), BatchSize::SmallInput);
        });
    }
    group.finish();
}

criterion_group!(benches, pid, trackers, optimal);
criterion_main!(benches);
