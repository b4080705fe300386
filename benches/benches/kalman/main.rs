//! Kalman filters: a cycle of prediction and correction, with Joseph's form, a gate and wrapped headings.
//!
//! - `pose_filter`: the pose filter of the roles; `landmark_filter`: fifteen states, calibrated on the way;
//! - `three_states`, `five_states`: the same drive by the extended filter here, by one written out in nalgebra's
//!   operators, and by the crates `kfilter` and `adskalman` (which have neither gate nor wrapping, the former no Joseph's form
//!   either; both are given the same Jacobians).

mod drive;
mod peers;
mod written_out;

use agv_core::{
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    nalgebra::{Matrix3, Vector2},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief},
    sensors::{LandmarkObservation, PoseObservation},
    time::Stamp,
};
use agv_filters::{
    kalman::{Ekf, Gate, IterationParams, PoseFilter, PoseFilterParams, RtsSmoother, Ukf, UkfParams},
    landmark::{LandmarkFilter, LandmarkFilterParams, LandmarkMap},
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use drive::{FiveStates, Problem, ThreeStates};
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

/// The filters of this crate and the peers on one problem; all end at the same estimate.
fn filters<P: Problem<N> + peers::Peers<N>, const N: usize>(c: &mut Criterion, name: &str) {
    let problem = P::new();
    let mut group = c.benchmark_group(name);
    group.throughput(Throughput::Elements(problem.cycles().len() as u64));
    let (gate, start, spread) = (Gate::at_probability(0.999).expect("a probability"), problem.start(), P::spread());
    let ekf = Ekf::new(start, spread).expect("a belief");
    let by_ekf = |mut ekf: Ekf<P::State, N>| {
        for (control, seen) in problem.cycles() {
            ekf.predict(problem.process(), control, drive::DT).expect("a motion");
            ekf.update(problem.sensor(), seen, &gate).expect("a pose");
        }
        ekf
    };
    let end = by_ekf(ekf);
    let expected = P::vector(end.state());
    let near = |found: [f64; N], what: &str| {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{what}: {found} {expected}");
        }
    };
    near(problem.by_hand(), "written out");
    near(problem.by_kfilter(), "kfilter");
    near(problem.by_adskalman(), "adskalman");
    group.bench_function("ekf", |b| b.iter(|| by_ekf(black_box(ekf))));
    group.bench_function("written_out", |b| b.iter(|| black_box(&problem).by_hand()));
    group.bench_function("kfilter", |b| b.iter(|| black_box(&problem).by_kfilter()));
    group.bench_function("adskalman", |b| b.iter(|| black_box(&problem).by_adskalman()));

    group.bench_function("ekf/iterated", |b| {
        b.iter(|| {
            let mut ekf = black_box(ekf);
            for (control, seen) in problem.cycles() {
                ekf.predict(problem.process(), control, drive::DT).expect("a motion");
                let params = IterationParams::default();
                ekf.update_iterated(problem.sensor(), seen, &gate, &params).expect("a pose");
            }
            ekf
        });
    });
    let ukf = Ukf::new(start, spread, &UkfParams::default()).expect("a belief");
    group.bench_function("ukf", |b| {
        b.iter(|| {
            let mut ukf = black_box(ukf);
            for (control, seen) in problem.cycles() {
                ukf.predict(problem.process(), control, drive::DT).expect("a motion");
                ukf.update(problem.sensor(), seen, &gate).expect("a pose");
            }
            ukf
        });
    });
    let mut smoother = RtsSmoother::new(ekf);
    for (control, seen) in problem.cycles() {
        smoother.predict(problem.process(), control, drive::DT).expect("a motion");
        smoother.update(problem.sensor(), seen, &gate).expect("a pose");
    }
    let mut smoothed = Vec::new();
    group.bench_function("rts/backward_pass", |b| {
        b.iter(|| smoother.smooth_into(black_box(&mut smoothed)).expect("a drive"));
    });
    group.finish();
}

fn three_states(c: &mut Criterion) {
    filters::<ThreeStates, 3>(c, "kalman/three_states");
}

fn five_states(c: &mut Criterion) {
    filters::<FiveStates, 5>(c, "kalman/five_states");
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

criterion_group!(benches, landmark_filter, pose_filter, three_states, five_states);
criterion_main!(benches);
