//! The Kalman family, fusion, landmarks and codes.

use crate::{
    counter,
    scenes::kalman::{
        bootstrap, fusion, landmark_filter, marker_localizer, run_bootstrap, run_codes, run_fusion, run_landmarks,
        run_smoother, run_ukf, smoother, source_switch, ukf,
    },
};
use agv_nav::core::compute::Par;
use std::sync::Mutex;

#[test]
fn unscented_filter() {
    let mut filter = ukf();
    assert_eq!(counter::count(|| run_ukf(&mut filter, 0..200)), 0);
}

/// A second drive in the memory of the first.
#[test]
fn smoother_with_memory() {
    let (mut filter, mut smoothed) = (smoother().with_capacity(100), Vec::new());
    let start = *filter.filter();
    assert_eq!(counter::count(|| run_smoother(&mut filter, 0..100)), 0);
    filter.smooth_into(&mut smoothed).unwrap();
    let again = || {
        filter.restart(start);
        run_smoother(&mut filter, 0..100);
        filter.smooth_into(&mut smoothed).unwrap();
    };
    assert_eq!(counter::count(again), 0);
    assert_eq!(smoothed.len(), 101);
}

#[test]
fn bootstrap_filter() {
    let mut filter = bootstrap(Par::Seq);
    let mut resampled = false;
    assert_eq!(counter::count(|| resampled = run_bootstrap(&mut filter, 0..20)), 0);
    assert!(resampled, "the drive must exercise resampling");
}

#[test]
fn bootstrap_filter_inside_a_pool() {
    let filter = Mutex::new(bootstrap(Par::threads(2)));
    let run = |range| {
        run_bootstrap(&mut filter.lock().unwrap(), range);
    };
    assert_eq!(counter::count_in_pool(2, || run(0..5), || run(5..20)), 0);
}

#[test]
fn landmarks_that_are_seen_late() {
    let mut filter = landmark_filter();
    let mut applied = 0;
    assert_eq!(counter::count(|| applied = run_landmarks(&mut filter, 0..300)), 0);
    assert!(applied > 200, "{applied}");
}

#[test]
fn fusion_of_late_measurements() {
    let (mut filter, sources) = fusion();
    run_fusion(&mut filter, sources, 0..20);
    assert_eq!(counter::count(|| run_fusion(&mut filter, sources, 20..520)), 0);
}

#[test]
fn codes_and_the_switch() {
    let (localizer, mut switch) = (marker_localizer(), source_switch());
    let mut by_codes = 0;
    assert_eq!(counter::count(|| by_codes = run_codes(&localizer, &mut switch, 0..100)), 0);
    assert!(by_codes > 90);
}
