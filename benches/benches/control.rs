//! Controllers and path trackers: nanoseconds per update.

use agv_control::{
    pid::{Pid, PidParams},
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

criterion_group!(benches, pid, trackers);
criterion_main!(benches);
