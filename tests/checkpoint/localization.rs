//! Filters.

use crate::{
    scenes::{
        adaptive_bits, adaptive_filter, circle, filter_bits, initialized, localize, localize_adaptively, room,
        scan_filter, start,
    },
    table::restored,
};
use agv_nav::core::{
    compute::{Par, Seed},
    geometry::Se2,
    nalgebra::Matrix3,
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, SkipReason, UpdateOutcome},
};
use agv_nav::filters::particle::{DifferentialOdometryModel, FreeSpace, Mcl, MclParams, OdometryNoise, WeighParticles};
use serde_json::json;

#[test]
fn a_resumed_filter_continues_with_the_same_bits() {
    let drive = circle(12);
    let mut uninterrupted = initialized(1000, Par::Seq);
    localize(&mut uninterrupted, &drive[..5]);
    // Odometry that is pending must survive as well.
    let (motion, _) = &drive[0];
    let small = OdometryIncrement { start_from_end: Se2::new(0.03, 0.001, 0.02), ..*motion };
    uninterrupted.predict(&small).unwrap();

    let mut resumed = scan_filter(10, Par::threads(2));
    resumed.restore(&restored(&uninterrupted.checkpoint())).unwrap();
    assert!(filter_bits(&resumed) == filter_bits(&uninterrupted));
    assert!(resumed.estimate().unwrap().stamp == Some(small.end));
    localize(&mut uninterrupted, &drive[5..]);
    localize(&mut resumed, &drive[5..]);
    assert!(filter_bits(&resumed) == filter_bits(&uninterrupted));
}

/// How far the vehicle has been since is part of the state: stored at the far end of a lap, it knows at the near end.
#[test]
fn a_resumed_filter_knows_that_it_has_been_away() {
    let drive = circle(1);
    let mut uninterrupted = initialized(200, Par::Seq);
    localize(&mut uninterrupted, &drive);
    let (motion, scan) = &drive[0];
    let away = |x| OdometryIncrement { start_from_end: Se2::new(x, 0.0, 0.0), ..*motion };
    uninterrupted.predict(&away(2.0)).unwrap();
    let mut resumed = scan_filter(200, Par::Seq);
    resumed.restore(&restored(&uninterrupted.checkpoint())).unwrap();
    resumed.predict(&away(-2.0)).unwrap();
    assert!(!matches!(resumed.update(scan), Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion))));
    assert_eq!(resumed.update(scan), Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion)));
}

#[test]
fn a_resumed_adaptive_filter_continues_with_the_same_bits() {
    let drive = circle(14);
    let mut uninterrupted = adaptive_filter(Par::Seq);
    // In the midst of the search.
    assert!(localize_adaptively(&mut uninterrupted, &drive[..3]) > 0);
    let mut resumed = adaptive_filter(Par::threads(2));
    resumed.restore(&restored(&uninterrupted.checkpoint())).unwrap();
    assert!(adaptive_bits(&resumed) == adaptive_bits(&uninterrupted));
    localize_adaptively(&mut uninterrupted, &drive[3..]);
    localize_adaptively(&mut resumed, &drive[3..]);
    assert!(adaptive_bits(&resumed) == adaptive_bits(&uninterrupted));

    let good = serde_json::to_value(uninterrupted.checkpoint()).unwrap();
    for (path, value) in [
        ("/doubts/known/0/value/slow", json!(-1.0)),
        ("/doubts/known/0/value/params/max_share", json!(7.0)),
        ("/doubts/fresh/variance", json!(null)),
        ("/mcl/weights", json!([1.0])),
    ] {
        let mut spoilt = good.clone();
        *spoilt.pointer_mut(path).unwrap_or_else(|| panic!("{path}")) = value;
        let restored = serde_json::from_value(spoilt).is_ok_and(|checkpoint| resumed.restore(&checkpoint).is_ok());
        assert!(!restored && adaptive_bits(&resumed) == adaptive_bits(&uninterrupted), "{path}");
    }
}

/// A sensor that rules out all poses left of the start.
#[derive(Clone)]
struct Fence;

impl WeighParticles<()> for Fence {
    fn weigh(&mut self, (): &(), poses: &[Se2], log_likelihoods: &mut [f64], _: Par) -> Result<(), SkipReason> {
        for (value, pose) in log_likelihoods.iter_mut().zip(poses) {
            *value = if pose.x() < start().x() - 0.1 { f64::NEG_INFINITY } else { 0.0 };
        }
        Ok(())
    }
}

#[test]
fn particles_that_were_ruled_out_stay_so() {
    let map = room();
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let new = || Mcl::new(motion, Fence, FreeSpace::new(&map, 0.2).unwrap(), MclParams::default(), Seed(1)).unwrap();
    let (mut filter, mut resumed) = (new(), new());
    filter.initialize(&PoseBelief::around(start(), Matrix3::identity() * 0.04).unwrap()).unwrap();
    assert!(matches!(filter.update(&()), Ok(UpdateOutcome::Applied(_))));
    resumed.restore(&restored(&filter.checkpoint())).unwrap();
    assert!(filter.particles().log_weights().contains(&f64::NEG_INFINITY));
    assert_eq!(resumed.particles().log_weights(), filter.particles().log_weights());
    assert_eq!(resumed.estimate(), filter.estimate());
}

#[test]
fn a_spoilt_checkpoint_is_refused_and_changes_nothing() {
    let mut filter = initialized(50, Par::Seq);
    localize(&mut filter, &circle(1));
    let before = filter_bits(&filter);
    let good = serde_json::to_value(filter.checkpoint()).unwrap();
    for (path, value) in [
        ("/poses/3/translation/0", json!(null)),
        ("/poses/3/rotation/cos", json!(7.0)),
        ("/weights/3", json!(-0.5)),
        ("/weights", json!([1.0])),
        ("/log_weights/0", json!(1.0)),
        ("/poses", json!([])),
        ("/known/moments/covariance/0", json!(null)),
        ("/known/pose/covariance/0", json!(-1.0)),
        ("/monitor/params/smoothing", json!(2.0)),
        ("/capacity", json!(usize::MAX)),
        ("/odom_from_base/rotation/cos", json!(7.0)),
        ("/applied/0/value/odom_from_base/translation/0", json!(null)),
    ] {
        let mut spoilt = good.clone();
        *spoilt.pointer_mut(path).unwrap() = value;
        let restored = serde_json::from_value(spoilt).is_ok_and(|checkpoint| filter.restore(&checkpoint).is_ok());
        assert!(!restored, "{path}");
        assert!(filter_bits(&filter) == before, "{path}");
    }
    // Another position is a valid state: the check must not be stricter than the filter.
    let mut moved = good;
    *moved.pointer_mut("/poses/3/translation/0").unwrap() = json!(5.0);
    scan_filter(1, Par::Seq).restore(&serde_json::from_value(moved).unwrap()).unwrap();
}
