//! Path trackers against the truth: lagging drives, slip and a noisy pose, filtered, on a figure of eight and through an aisle.
//!
//! The bounds are those of the issue that asked for the trackers (5 cm), with the largest errors in 100 seeds far inside of them
//! (`docs/experiments.md`); the tighter ones have half as much room again as the worst of those.

use agv_nav::{
    control::track::{
        FollowerParams, Lqr, LqrParams, Mpc, MpcParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams,
        Stanley, StanleyParams,
    },
    core::path::shapes,
    filters::kalman::{PoseFilter, PoseFilterParams},
    nalgebra::Vector2,
    prelude::*,
};
use agv_sim::{PathRun, PathRunParams};

const SEEDS: u64 = 3;

/// All trackers, reading bends of paths that are given point by point, without a load that must not shift.
fn trackers() -> Vec<(&'static str, Box<dyn PathTracker>)> {
    let follower = FollowerParams { bend_window: 0.2, lateral_acceleration: 2.0, ..FollowerParams::default() };
    vec![
        ("pure pursuit", Box::new(PurePursuit::new(PurePursuitParams { follower, ..Default::default() }).unwrap())),
        ("pid", Box::new(PidTracker::new(PidTrackerParams { follower, ..Default::default() }).unwrap())),
        ("stanley", Box::new(Stanley::new(StanleyParams { follower, ..Default::default() }).unwrap())),
        ("lqr", Box::new(Lqr::new(LqrParams { follower, ..Default::default() }).unwrap())),
        ("mpc", Box::new(Mpc::new(MpcParams { follower, ..Default::default() }).unwrap())),
    ]
}

fn aisle() -> Path {
    let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.5), (0.0, 2.5), (0.0, 5.0)].map(|(x, y)| Vector2::new(x, y));
    shapes::rounded(&corners, 0.6, 0.02).unwrap()
}

/// Every tracker on a path, over all seeds; each must arrive without having broken a limit.
fn drive(vehicle: &PathRunParams, path: &Path, is_filtered: bool) -> Vec<(&'static str, Vec<PathRun>)> {
    let drive = |(name, mut tracker): (&'static str, Box<dyn PathTracker>)| {
        let runs = (0..SEEDS).map(|seed| {
            let mut filter = PoseFilter::new(PoseFilterParams::default()).unwrap();
            let localizer = is_filtered.then_some(&mut filter as _);
            let run = vehicle.drive(tracker.as_mut(), localizer, path, Seed(seed)).unwrap();
            assert!(run.arrived && run.violations == 0, "{name}, seed {seed}: {} {}", run.arrived, run.violations);
            assert!(run.final_position_error() < 0.03 && run.final_heading_error() < 0.03, "{name}, seed {seed}");
            run
        });
        (name, runs.collect())
    };
    trackers().into_iter().map(drive).collect()
}

fn worst(runs: &[PathRun], of: impl Fn(&PathRun) -> f64) -> f64 {
    runs.iter().map(of).fold(0.0, f64::max)
}

#[test]
fn every_tracker_keeps_to_the_eight_and_the_best_within_seven_millimetres() {
    let eight = shapes::lemniscate(3.0, 0.02).unwrap();
    let mut best = (f64::INFINITY, f64::INFINITY);
    for (name, runs) in drive(&PathRunParams::differential(), &eight, true) {
        let (rmse, max) = (worst(&runs, PathRun::rmse), worst(&runs, PathRun::max));
        assert!(rmse < 0.01 && max < 0.03, "{name}: {rmse} m, {max} m");
        best = if rmse < best.0 { (rmse, max) } else { best };
    }
    assert!(best.0 <= 0.007 && best.1 <= 0.02, "{best:?}");
}

#[test]
fn every_tracker_takes_the_corners_of_an_aisle() {
    for (name, runs) in drive(&PathRunParams::differential(), &aisle(), true) {
        let (rmse, max) = (worst(&runs, PathRun::rmse), worst(&runs, PathRun::max));
        assert!(rmse < 0.01 && max < 0.035, "{name}: {rmse} m, {max} m");
    }
}

#[test]
fn vehicles_that_steer_or_slide_keep_to_both() {
    let eight = shapes::lemniscate(3.0, 0.02).unwrap();
    for vehicle in [PathRunParams::ackermann().unwrap(), PathRunParams::omnidirectional().unwrap()] {
        for path in [&eight, &aisle()] {
            for (name, runs) in drive(&vehicle, path, true) {
                let (rmse, max) = (worst(&runs, PathRun::rmse), worst(&runs, PathRun::max));
                assert!(rmse < 0.012 && max < 0.04, "{name}, {:?}: {rmse} m, {max} m", vehicle.vehicle.drive);
            }
        }
    }
}

/// Tail first into a bay, over a cusp.
#[test]
fn every_tracker_reverses_into_a_bay() {
    let bay = shapes::reverse_into_bay(1.5, 0.8, 0.02).unwrap();
    for vehicle in [PathRunParams::differential(), PathRunParams::ackermann().unwrap()] {
        for (name, runs) in drive(&vehicle, &bay, true) {
            let (rmse, max) = (worst(&runs, PathRun::rmse), worst(&runs, PathRun::max));
            assert!(rmse < 0.012 && max < 0.04, "{name}: {rmse} m, {max} m");
            let reversed = |run: &PathRun| run.samples.iter().any(|sample| sample.twist.vx < -0.2);
            assert!(runs.iter().all(reversed), "{name}");
        }
    }
}

/// Without the filter the trackers hold the eight all the same: two filter the pose themselves, the others are damped enough.
#[test]
fn no_tracker_needs_the_filter_to_stay_on_its_path() {
    let eight = shapes::lemniscate(3.0, 0.02).unwrap();
    for (name, runs) in drive(&PathRunParams::differential(), &eight, false) {
        let (rmse, max) = (worst(&runs, PathRun::rmse), worst(&runs, PathRun::max));
        assert!(rmse < 0.01 && max < 0.03, "{name}: {rmse} m, {max} m");
    }
}
