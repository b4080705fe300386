//! Controllers and path trackers: nanoseconds per update.

use agv_control::{
    margin::FrequencySweep,
    pid::{AntiWindup, Pid, PidParams, VelocityPid},
    plant::StandIn,
    step_response::PidGains,
    track::{PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams},
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

/// A recorded approach to the set-point, update by update: what counts is the controller, not the plant that it waits for.
/// The peer is the `pid` crate, whose gains have `dt` in them, without filter, anti-windup by clamping the integral.
fn pid(c: &mut Criterion) {
    const DT: f64 = 0.01;
    let measurements: Vec<f64> = (0..1000).map(|k| 1.2 * (1.0 - (-DT * f64::from(k)).exp())).collect();
    let params = PidParams {
        proportional: 1.0,
        integral: 0.5,
        derivative: 0.1,
        output_min: -10.0,
        output_max: 10.0,
        ..PidParams::default()
    };
    let limited = PidParams {
        filter_time: 0.02,
        output_rate: 50.0,
        output_max: 1.5,
        anti_windup: AntiWindup::BackCalculation { tracking_time: 0.5 },
        ..params
    };
    let mut peer = pid::Pid::<f64>::new(1.0, 10.0);
    peer.p(params.proportional, 1e9).i(params.integral * DT, 1e9).d(params.derivative / DT, 1e9);
    // The same outputs, so that the same is timed.
    let mut ours = Pid::new(params).expect("good parameters");
    for &measurement in &measurements {
        let output = ours.update(1.0, measurement, DT).expect("finite");
        assert!((output - peer.next_control_output(measurement).output).abs() < 1e-9);
    }
    let mut group = c.benchmark_group("pid/update");
    group.throughput(Throughput::Elements(measurements.len() as u64));
    for (name, params) in [("plain", params), ("filtered_limited", limited)] {
        let mut pid = Pid::new(params).expect("good parameters");
        group.bench_function(name, |b| {
            b.iter(|| {
                let run = |&y: &f64| pid.update(1.0, y, DT).expect("finite");
                black_box(&measurements).iter().map(run).sum::<f64>()
            });
        });
    }
    let mut velocity = VelocityPid::new(params).expect("good parameters");
    group.bench_function("velocity", |b| {
        b.iter(|| {
            let run = |&y: &f64| velocity.update(1.0, y, DT).expect("finite");
            black_box(&measurements).iter().map(run).sum::<f64>()
        });
    });
    group.bench_function("pid_crate", |b| {
        b.iter(|| black_box(&measurements).iter().map(|&y| peer.next_control_output(y).output).sum::<f64>());
    });
    group.finish();
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
        let sweep =
            FrequencySweep::new(&plant.plant().expect("good plant"), test.params().dt, test.params().filter_time)
                .expect("good plant");
        group
            .bench_function("margins", |b| b.iter(|| gains.iter().map(|&g| sweep.margins(g).sensitivity).sum::<f64>()));
        group.bench_function("batch", |b| b.iter(|| test.cost_batch(black_box(&gains), &mut costs)));
        group.finish();
    }
}

criterion_group!(benches, pid, step_test, trackers);
criterion_main!(benches);
