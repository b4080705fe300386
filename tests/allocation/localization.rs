//! Filters.

use crate::{
    counter,
    scenes::{circle, initialized, localize},
};
use agv_nav::core::compute::Par;
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
