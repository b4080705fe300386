//! Controllers and path trackers: nanoseconds per update.

use agv_control::{
    margin::FrequencySweep,
    pid::{AntiWindup, Pid, PidParams, VelocityPid},
    plant::StandIn,
    step_response::PidGains,
    track::{
        Lqr, LqrParams, Mpc, MpcParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams, Stanley,
        StanleyParams,
    },
};
use agv_core::{
    geometry::Twist2,
    kinematics::MotionLimits,
    nalgebra::Vector2,
    path::Path,
    roles::{Controller, PathTracker, TrackStatus, VehicleState},
};
use criterion::{
    BatchSize, BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main, measurement::WallTime,
};
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

/// A figure of eight of 1000 points, driven from end to end: the progress search is amortised over the cycles. The states are those
/// of a drive before, so that only commands are timed.
fn trackers(c: &mut Criterion) {
    let positions: Vec<_> = (0..1000)
        .map(|i| f64::from(i) / 999.0 * std::f64::consts::TAU)
        .map(|t| Vector2::new(3.0 * t.sin(), 3.0 * t.sin() * t.cos()))
        .collect();
    let path = Path::from_positions(&positions).expect("finite");
    let mut group = c.benchmark_group("track/eight_1000");
    follow(&mut group, "pure_pursuit", &path, PurePursuit::new(PurePursuitParams::default()).expect("good parameters"));
    follow(&mut group, "stanley", &path, Stanley::new(StanleyParams::default()).expect("good parameters"));
    follow(&mut group, "pid", &path, PidTracker::new(PidTrackerParams::default()).expect("good parameters"));
    follow(&mut group, "lqr", &path, Lqr::new(LqrParams::default()).expect("good parameters"));
    for horizon in [10, 20, 30] {
        let mpc = Mpc::new(MpcParams { horizon, ..MpcParams::default() }).expect("good parameters");
        follow(&mut group, &format!("mpc/{horizon}"), &path, mpc);
    }
    group.finish();
}

fn follow<T: PathTracker + Clone>(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, path: &Path, mut tracker: T) {
    const DT: f64 = 0.02;
    let limits = MotionLimits::default();
    tracker.set_path(path).expect("a path");
    // Computes the speeds, as the first command on every path does.
    let mut state = VehicleState::new(path.points()[0].pose, Twist2::new(0.5, 0.0, 0.0));
    tracker.command(&state, &limits, DT).expect("good state");
    let (mut drive, mut states) = (tracker.clone(), Vec::new());
    loop {
        let command = drive.command(&state, &limits, DT).expect("good state");
        states.push(state);
        state = state.after(&command.motion, DT);
        match command.status {
            TrackStatus::Arrived => break,
            status => assert_eq!(status, TrackStatus::Tracking),
        }
        assert!(command.cross_track_error.abs() < 0.05);
    }
    group.throughput(Throughput::Elements(states.len() as u64));
    group.bench_function(name, |b| {
        let run = |tracker: &mut T| {
            for state in &states {
                black_box(tracker.command(state, &limits, DT).expect("good state"));
            }
        };
        b.iter_batched_ref(|| tracker.clone(), run, BatchSize::SmallInput);
    });
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
