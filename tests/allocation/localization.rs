//! Filters.

use crate::{counter, scenes};
use agv_nav::core::{
    compute::Par,
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
    sensors::LaserScan,
};
use agv_nav::nalgebra::Matrix3;
use scenes::ScanFilter;
use std::sync::Mutex;

fn initialized(par: Par) -> ScanFilter {
    let mut filter = scenes::scan_filter(2000, par);
    filter.initialize(&PoseBelief::around(scenes::start(), Matrix3::identity() * 0.04)).unwrap();
    filter
}

/// Drives, and says whether the particles were resampled.
fn localize(filter: &mut ScanFilter, steps: &[(OdometryIncrement, LaserScan)]) -> bool {
    let mut resampled = false;
    for (motion, scan) in steps {
        filter.predict(motion).unwrap();
        assert_eq!(filter.update(scan), Ok(UpdateOutcome::Applied));
        std::hint::black_box(filter.estimate());
        resampled |= filter.diagnostics().resampled;
    }
    resampled
}

#[test]
fn monte_carlo_localisation() {
    let drive = scenes::circle(30);
    let mut filter = initialized(Par::Seq);
    localize(&mut filter, &drive[..3]);
    let mut resampled = false;
    assert_eq!(counter::count(|| resampled = localize(&mut filter, &drive[3..])), 0);
    assert!(resampled, "the drive must exercise resampling");
}

#[test]
fn monte_carlo_localisation_inside_a_pool() {
    let drive = scenes::circle(30);
    let filter = Mutex::new(initialized(Par::threads(2)));
    let run = |steps| localize(&mut filter.lock().unwrap(), steps);
    let count = counter::count_in_pool(2, || assert!(run(&drive[..10])), || assert!(run(&drive[10..])));
    assert_eq!(count, 0);
}
