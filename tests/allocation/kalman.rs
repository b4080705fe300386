//! The Gaussian filters, and what goes with them.

use crate::{counter, scenes::kalman};
use agv_nav::core::compute::Par;

/// Runs over the first steps, and counts over the others.
fn count(warm_up: u32, mut run: impl FnMut(std::ops::Range<u32>)) -> usize {
    run(0..warm_up);
    counter::count(|| run(warm_up..warm_up + 300))
}

#[test]
fn kalman_filters() {
    let (mut extended, mut unscented) = (kalman::ekf(), kalman::ukf());
    assert_eq!(count(0, |range| kalman::run_ekf(&mut extended, range)), 0);
    assert_eq!(count(0, |range| kalman::run_ukf(&mut unscented, range)), 0);
}

#[test]
fn bootstrap_filter() {
    let mut filter = kalman::bootstrap(Par::Seq);
    let mut resampled = false;
    assert_eq!(count(20, |range| resampled |= kalman::run_bootstrap(&mut filter, range)), 0);
    assert!(resampled, "the drive must exercise resampling");
}

/// The warm-up fills the history of half a second.
#[test]
fn fusion_filter() {
    let (mut filter, sources) = kalman::fusion();
    assert_eq!(count(40, |range| kalman::run_fusion(&mut filter, sources, range)), 0);
}

#[test]
fn landmark_filter() {
    let (mut filter, mut applied) = (kalman::landmark_filter(), 0);
    assert_eq!(count(40, |range| applied += kalman::run_landmarks(&mut filter, range)), 0);
    assert!(applied > 300, "{applied} sightings");
}

#[test]
fn codes_and_the_switch_to_them() {
    let (localizer, mut switch) = (kalman::marker_localizer(), kalman::source_switch());
    let mut by_codes = 0;
    let count = counter::count(|| by_codes = kalman::run_codes(&localizer, &mut switch, 0..150));
    assert_eq!(count, 0);
    assert!(by_codes > 0, "the drive must switch");
}
