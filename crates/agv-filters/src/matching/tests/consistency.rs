//! Whether matchers err as much as they say.

use super::{hall, laser, matcher, scan};
use crate::matching::{
    ClimbingMatcher, ClimbingMatcherParams, FieldMatcher, FieldMatcherParams, PointToLineMatcher, PointToLineParams,
};
use agv_core::{
    compute::Seed,
    geometry::{LieGroup, PoseSigma, Se2},
    roles::{ScanMatcher, TargetScan},
};
use nalgebra::Vector3;
use rand::RngExt;

/// Squared errors by the stated covariance: of each coordinate (one if it is right), and of all three (three if it is right). Means over
/// poses in the hall and seeds of the scanner's noise.
fn errors_by_what_is_stated(matcher: &mut dyn ScanMatcher) -> (Vector3<f64>, f64) {
    let (world, mut clean) = (hall(), laser(0.0, 1));
    let poses = [(0.0, 0.0, 0.0), (0.5, 0.5, 2.0), (-0.5, 0.3, -2.0)].map(|(x, y, yaw)| Se2::new(x, y, yaw));
    let scans = poses.map(|pose| scan(&world, &mut clean, &pose));
    let target: Vec<_> =
        poses.iter().zip(&scans).map(|(pose, scan)| TargetScan { target_from_base: *pose, scan }).collect();
    matcher.set_target(&target).unwrap();
    let (mut single, mut all, mut runs) = (Vector3::zeros(), 0.0, 0.0);
    for seed in 0..8 {
        let (mut laser, mut stream) = (laser(0.02, 100 + seed), Seed(200 + seed).stream(0, 0));
        for _ in 0..40 {
            let mut within = |limit: f64| stream.random_range(-limit..limit);
            let truth = Se2::new(within(0.8), within(0.8), within(3.0));
            let guess = truth * Se2::new(within(0.1), within(0.1), within(0.05));
            let found = matcher.match_scan(&scan(&world, &mut laser, &truth), &guess).unwrap();
            assert!(found.converged(), "{found:?}");
            let error = truth.between(&found.target_from_source).log();
            let covariance = found.covariance(PoseSigma::default()).unwrap();
            single += error.component_mul(&error).component_div(&covariance.diagonal());
            all += (error.transpose() * found.information * error)[0];
            runs += 1.0;
        }
    }
    (single / runs, all / runs)
}

/// Neither four times too small nor too large, of any coordinate.
#[test]
fn covariances_are_of_the_size_of_the_errors() {
    let mut field = FieldMatcher::new(FieldMatcherParams::default()).unwrap();
    let mut climbing = ClimbingMatcher::new(ClimbingMatcherParams::default()).unwrap();
    let mut point_to_line = PointToLineMatcher::new(PointToLineParams::default()).unwrap();
    let mut correlative = matcher();
    let matchers: [(&str, &mut dyn ScanMatcher); 4] = [
        ("correlative", &mut correlative),
        ("point to line", &mut point_to_line),
        ("climbing", &mut climbing),
        ("field", &mut field),
    ];
    let stated = matchers.map(|(name, matcher)| (name, errors_by_what_is_stated(matcher)));
    for (name, (single, all)) in stated {
        assert!(single.iter().all(|ratio| (0.25..4.0).contains(ratio)), "{name}: {single} of {stated:?}");
        assert!((0.75..12.0).contains(&all), "{name}: {all}");
    }
}
