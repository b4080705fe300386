//! Filters.

use crate::{
    counter,
    scenes::{self, adaptive_filter, circle, equipped, initialized, localize, localize_adaptively},
};
use agv_nav::{
    core::{compute::Par, geometry::UncertainPose, sensors::PoseObservation},
    filters::kalman::{PoseFilter, PoseFilterParams},
    nalgebra::Matrix3,
    prelude::*,
};
use std::sync::Mutex;

#[test]
fn monte_carlo_localisation() {
    let drive = circle(30);
    let mut filter = initialized(2000, Par::Seq);
    localize(&mut filter, &drive[..3]);
    let mut resampled = false;
    assert_eq!(counter::count(|| resampled = localize(&mut filter, &drive[3..])), 0);
    assert!(resampled, "the drive must exercise resampling");
}

#[test]
fn monte_carlo_localisation_inside_a_pool() {
    let drive = circle(30);
    let filter = Mutex::new(initialized(2000, Par::threads(2)));
    let run = |steps| localize(&mut filter.lock().unwrap(), steps);
    let count = counter::count_in_pool(2, || assert!(run(&drive[..10])), || assert!(run(&drive[10..])));
    assert_eq!(count, 0);
}

/// From anywhere, with thousands of particles and a search in each update, to a few hundred that track.
#[test]
fn adaptive_monte_carlo_localisation() {
    let drive = circle(40);
    let mut filter = adaptive_filter(Par::Seq);
    localize_adaptively(&mut filter, &drive[..1]);
    let mut fresh = 0;
    assert_eq!(counter::count(|| fresh = localize_adaptively(&mut filter, &drive[1..])), 0);
    assert!(fresh > 0, "the drive must exercise the search");
}

/// Two lasers and codes on one filter, from anywhere.
#[test]
fn several_lasers_and_codes() {
    let round = equipped::round(30);
    let mut filter = equipped::filter(Par::Seq);
    equipped::run(&mut filter, &round[..4]);
    let mut applied = (0, 0);
    assert_eq!(counter::count(|| applied = equipped::run(&mut filter, &round[4..])), 0);
    assert!(applied.0 > 20 && applied.1 > 3, "{applied:?}");
}

#[test]
fn pose_filter() {
    let noise = Matrix3::identity() * 1e-4;
    let mut filter = PoseFilter::new(PoseFilterParams::default()).unwrap();
    let count = counter::count(|| {
        filter.initialize(&PoseBelief::around(Se2::default(), noise).unwrap()).unwrap();
        let (mut odom, mut now) = (Se2::default(), Stamp::default());
        for _ in 0..100 {
            let (next, then) = (odom * Se2::new(0.02, 0.0, 0.01), now + 0.02);
            filter.predict(&OdometryIncrement::between(now, &odom, then, &next).unwrap()).unwrap();
            (odom, now) = (next, then);
            filter.update(&PoseObservation::new(now, UncertainPose::new(odom, noise).unwrap())).unwrap();
        }
        assert!(filter.estimate().is_some());
    });
    assert_eq!(count, 0);
}

/// The third round: the map has grown, and nothing is new.
#[test]
fn landmark_slam() {
    let looks = scenes::landmarks::rounds(180);
    let mut slam = scenes::landmarks::filter();
    scenes::landmarks::run(&mut slam, &looks[..120]);
    let mut matched = 0;
    assert_eq!(counter::count(|| matched = scenes::landmarks::run(&mut slam, &looks[120..])), 0);
    assert!(matched > 400, "{matched}");
}
