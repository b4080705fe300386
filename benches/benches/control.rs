//! Controllers and path trackers: nanoseconds per update.

use agv_control::{
    pid::{Pid, PidParams},
    plant::StandIn,
    step_response::PidGains,
    track::{PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams},
};
use agv_core::{
    geometry::Twist2,
    kinematics::TwistLimits,
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
    let limits = TwistLimits::default();
    let start = VehicleState { map_from_base: path.points()[0].pose, twist: Twist2::new(1.0, 0.0, 0.0) };
    let drive = |tracker: &mut dyn PathTracker| {
        let mut state = start;
        for _ in 0..CYCLES {
            let command = tracker.command(&state, &limits, 0.02).expect("good state");
            state.map_from_base = state.map_from_base * command.twist.integrate(0.02);
            state.twist = command.twist;
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

/// Costs of PID gains on the stand-in plants: what a swarm of 20 particles asks for in each iteration.
fn step_test(c: &mut Criterion) {
    for plant in StandIn::ALL {
        let test = plant.step_test().expect("good plant");
        let gains: Vec<PidGains> = (0..24)
            .map(|i| f64::from(i) / 23.0 * plant.greatest_gain())
            .map(|gain| PidGains { proportional: gain, integral: 0.1 * gain, derivative: 0.2 * gain })
            .collect();
        let mut costs = vec![0.0; gains.len()];
        test.cost_batch(&gains, &mut costs).expect("as many costs");
        for (gains, cost) in gains.iter().zip(&costs) {
            assert_eq!(test.cost(*gains).to_bits(), cost.to_bits());
        }
        let mut group = c.benchmark_group(format!("step_test/{}", plant.name()));
        group.throughput(Throughput::Elements(gains.len() as u64));
        group.bench_function("single", |b| b.iter(|| gains.iter().map(|&gains| test.cost(gains)).sum::<f64>()));
        group.bench_function("batch", |b| b.iter(|| test.cost_batch(black_box(&gains), &mut costs)));
        group.finish();
    }
}

criterion_group!(benches, pid, step_test, trackers);
criterion_main!(benches);
