//! Kalman filters: a cycle of the pose filter, prediction and correction, and of the landmark filter.

use agv_core::{
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    nalgebra::{Matrix3, Vector2},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief},
    sensors::{LandmarkObservation, PoseObservation},
    time::Stamp,
};
use agv_filters::{
    kalman::{PoseFilter, PoseFilterParams},
    landmark::{LandmarkFilter, LandmarkFilterParams, LandmarkMap},
};
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

/// Odometry of a minute on a circle at 50 Hz, and every fifth step a sighting of one of four landmarks.
fn landmark_filter(c: &mut Criterion) {
    let places = [[6.0, 5.0], [-6.0, 5.0], [-6.0, -5.0], [6.0, -5.0]].map(Vector2::from);
    let map = LandmarkMap::new((0..).zip(places)).expect("places");
    let sigmas = Vector2::new(0.05, 0.015);
    let see = |id: usize, motion: &OdometryIncrement, truth: &Se2| {
        let seen = truth.inverse().act(&places[id]);
        let reading = UncertainVector::from_sigmas(Vector2::new(seen.norm(), seen.y.atan2(seen.x)), &sigmas);
        LandmarkObservation::new(motion.end, Some(id as u32), reading.expect("deviations")).expect("a sighting")
    };
    let mut truth = Se2::default();
    let mut drive = Vec::new();
    for (step, (motion, _)) in circle().into_iter().enumerate() {
        truth = truth * motion.start_from_end;
        drive.push((motion, (step % 5 == 0).then(|| see(step / 5 % 4, &motion, &truth))));
    }
    let mut start = LandmarkFilter::new(map, LandmarkFilterParams::default()).expect("the defaults are sound");
    let belief = PoseBelief::around(Se2::default(), Matrix3::identity() * 1e-4).expect("a covariance");
    start.initialize(&belief).expect("a belief");
    let run = |filter: &mut LandmarkFilter| {
        filter.initialize(&belief).expect("a belief");
        for (motion, seen) in &drive {
            filter.predict(motion).expect("a motion");
            if let Some(seen) = seen {
                filter.update(seen).expect("a sighting");
            }
        }
        filter.estimate().expect("initialised").pose
    };
    assert!(run(&mut start).mean().minus(&truth).norm() < 0.05);
    let mut group = c.benchmark_group("kalman");
    group.throughput(Throughput::Elements(drive.len() as u64));
    group.bench_function("landmark_filter/predict_and_every_fifth_correct", |b| b.iter(|| run(black_box(&mut start))));
    group.finish();
}

criterion_group!(benches, pose_filter, landmark_filter);
criterion_main!(benches);
