//! The fusion filter: cost of a message that comes in order, and of poses that come 100 ms late.

use agv_core::{
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    nalgebra::{Matrix3, Vector3},
    odometry::OdometryIncrement,
    roles::PoseBelief,
    sensors::{ImuSample, PoseObservation},
    time::Stamp,
};
use agv_filters::fusion::{FusionFilter, FusionParams, Measurement, SourceId, SourceParams};
use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};

/// Wheels, gyro, tracker.
fn filter() -> (FusionFilter, [SourceId; 3]) {
    // A short history makes the copy before each run cheap.
    let params = FusionParams { history: 0.25, capacity: 100, ..FusionParams::default() };
    let mut filter = FusionFilter::new(params).expect("the parameters are sound");
    let sources = [SourceParams::wheels(), SourceParams::imu(), SourceParams::pose()];
    let ids = sources.map(|source| filter.add_source(source).expect("there is room"));
    let belief = PoseBelief::around(Se2::default(), Matrix3::identity() * 1e-4).expect("a covariance");
    filter.initialize(&belief).expect("a belief");
    (filter, ids)
}

/// Ten seconds of wheels at 50 Hz, a gyro at 100 Hz and poses at 10 Hz that come `late` seconds after their time; each with its
/// source, in the order of arrival.
fn messages(late: f64) -> Vec<(usize, Measurement)> {
    let (twist, noise) = (Twist2::new(1.0, 0.0, 0.3), Matrix3::identity() * 1e-4);
    let rates = UncertainVector::from_sigmas(Vector3::new(0.0, 0.0, 0.3), &Vector3::repeat(1e-3)).expect("positive");
    let at = |i: u32| Stamp::from_seconds(0.01 * f64::from(i));
    let pose = |i: u32| twist.integrate(0.01 * f64::from(i));
    let mut messages = Vec::new();
    for i in 1..=1000 {
        let mut push = |arrival: f64, source, message| messages.push((0.01 * f64::from(i) + arrival, source, message));
        push(0.0, 1, ImuSample::new(at(i)).with_angular_velocity(rates).into());
        if i % 2 == 0 {
            let motion = OdometryIncrement::between(at(i - 2), &pose(i - 2), at(i), &pose(i)).expect("finite");
            push(0.0, 0, motion.into());
        }
        if i % 10 == 0 {
            let seen = UncertainPose::new(pose(i), noise).expect("a covariance");
            push(late, 2, PoseObservation::new(at(i), seen).into());
        }
    }
    messages.sort_by(|a, b| a.0.total_cmp(&b.0));
    messages.into_iter().map(|(_, source, message)| (source, message)).collect()
}

fn fusion(c: &mut Criterion) {
    let mut group = c.benchmark_group("fusion");
    let (fresh, ids) = filter();
    let run = |filter: &mut FusionFilter, messages: &[(usize, Measurement)]| {
        for (source, message) in messages {
            filter.fuse(ids[*source], *message).expect("a sound message");
        }
        filter.state().expect("initialised").pose
    };
    let (in_order, late) = (messages(0.0), messages(0.1));
    let truth = Twist2::new(1.0, 0.0, 0.3).integrate(10.0);
    for messages in [&in_order, &late] {
        assert!(run(&mut fresh.clone(), messages).mean().minus(&truth).norm() < 0.01);
    }
    for (name, messages) in [("in_order", &in_order), ("poses_100_ms_late", &late)] {
        group.throughput(Throughput::Elements(messages.len() as u64));
        group.bench_function(name, |b| {
            b.iter_batched_ref(|| fresh.clone(), |f| run(f, messages), BatchSize::LargeInput);
        });
    }
    group.finish();
}

criterion_group!(benches, fusion);
criterion_main!(benches);
