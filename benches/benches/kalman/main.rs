//! Kalman filters: a cycle of the pose filter, prediction and correction.

use agv_core::{
    geometry::{Se2, Twist2, UncertainPose},
    nalgebra::Matrix3,
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief},
    sensors::PoseObservation,
    time::Stamp,
};
use agv_filters::kalman::{PoseFilter, PoseFilterParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Odometry and measured poses of a minute on a circle at 50 Hz.
fn circle() -> Vec<(OdometryIncrement, PoseObservation<Se2>)> {
    let (dt, noise) = (0.02, Matrix3::identity() * 1e-4);
    let step = Twist2::new(1.0, 0.0, 0.5).integrate(dt);
    let (mut odom, mut now) = (Se2::default(), Stamp::default());
    let cycle = |_| {
        let (next, then) = (odom * step, now + dt);
        let motion = OdometryIncrement::between(now, &odom, then, &next).expect("the poses are finite");
        (odom, now) = (next, then);
        (motion, PoseObservation::new(now, UncertainPose::new(odom, noise).expect("a covariance")))
    };
    (0..3000).map(cycle).collect()
}

fn pose_filter(c: &mut Criterion) {
    let mut group = c.benchmark_group("kalman");
    let drive = circle();
    group.throughput(Throughput::Elements(drive.len() as u64));
    let mut start = PoseFilter::new(PoseFilterParams::default()).expect("the defaults are sound");
    let belief = PoseBelief::around(Se2::default(), Matrix3::identity() * 1e-4).expect("a covariance");
    start.initialize(&belief).expect("a belief");
    let run = |mut filter: PoseFilter| {
        for (motion, seen) in &drive {
            filter.predict(motion).expect("a motion");
            filter.update(seen).expect("a pose");
        }
        filter.estimate().expect("initialised").pose
    };
    assert!(run(start).position_deviation() < 0.005);
    group.bench_function("pose_filter/predict_and_correct", |b| b.iter(|| run(black_box(start))));
    group.finish();
}

criterion_group!(benches, pose_filter);
criterion_main!(benches);
