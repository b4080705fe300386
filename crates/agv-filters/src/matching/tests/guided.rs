//! Matchers that need a guess: the slope of a field, climbing, and iterated closest points.

use super::{corridor, hall, laser, scan};
use crate::matching::{
    ClimbingMatcher, ClimbingMatcherParams, FieldMatcher, FieldMatcherParams, PointToLineMatcher, PointToLineParams,
};
use agv_core::{
    Error,
    compute::Seed,
    geometry::{LieGroup, PoseSigma, Se2},
    roles::{AlignmentError, ScanMatcher, TargetScan, Termination, laws},
};
use rand::RngExt;

fn field() -> FieldMatcher {
    FieldMatcher::new(FieldMatcherParams::default()).unwrap()
}

fn climbing() -> ClimbingMatcher {
    ClimbingMatcher::new(ClimbingMatcherParams::default()).unwrap()
}

fn point_to_line() -> PointToLineMatcher {
    PointToLineMatcher::new(PointToLineParams::default()).unwrap()
}

/// What is asked of a matcher from guesses that are off by so many metres along each axis, and so many radians.
struct Ask {
    off: (f64, f64),
    worst: (f64, f64),
    /// Of the squared errors, by the stated information: three per run where that is right.
    consistency: std::ops::Range<f64>,
}

/// From any guess within its reach a matcher finds the pose, and the information is of the size of the errors.
fn finds(matcher: &mut dyn ScanMatcher, ask: &Ask) {
    let (world, mut clean) = (hall(), laser(0.0, 1));
    let poses = [(0.0, 0.0, 0.0), (0.5, 0.5, 2.0), (-0.5, 0.3, -2.0)].map(|(x, y, yaw)| Se2::new(x, y, yaw));
    let scans = poses.map(|pose| scan(&world, &mut clean, &pose));
    let target: Vec<_> =
        poses.iter().zip(&scans).map(|(pose, scan)| TargetScan { target_from_base: *pose, scan }).collect();
    assert_eq!(matcher.match_scan(&scans[0], &Se2::default()), Err(AlignmentError::NoTarget));
    matcher.set_target(&target).unwrap();
    let (mut laser, mut stream) = (laser(0.02, 3), Seed(5).stream(0, 0));
    let (mut squares, runs) = (0.0, 60);
    for _ in 0..runs {
        let mut within = |limit: f64| stream.random_range(-limit..limit);
        let truth = Se2::new(within(0.8), within(0.8), within(3.0));
        let guess =
            Se2::new(truth.x() + within(ask.off.0), truth.y() + within(ask.off.0), truth.yaw() + within(ask.off.1));
        let found = matcher.match_scan(&scan(&world, &mut laser, &truth), &guess).unwrap();
        assert!(found.inlier_ratio > 0.8 && found.score > 0.8, "{found:?}");
        let error = truth.between(&found.target_from_source).log();
        assert!(error.xy().norm() < ask.worst.0 && error.z.abs() < ask.worst.1, "{truth:?} {error:?}");
        squares += (error.transpose() * found.information * error)[0];
        assert_eq!(found.unobserved.trace(), 0.0);
    }
    let mean = squares / f64::from(runs);
    assert!(ask.consistency.contains(&mean), "{mean}");
    laws::scan_matcher(matcher, &target, &scans[1], &Se2::new(0.4, 0.4, 1.95)).unwrap();
}

#[test]
fn the_slope_of_the_field_leads_there() {
    finds(&mut field(), &Ask { off: (0.2, 0.1), worst: (0.04, 0.012), consistency: 0.5..30.0 });
}

#[test]
fn climbing_leads_there() {
    finds(&mut climbing(), &Ask { off: (0.15, 0.1), worst: (0.02, 0.006), consistency: 0.5..12.0 });
}

#[test]
fn closest_points_lead_there() {
    finds(&mut point_to_line(), &Ask { off: (0.35, 0.3), worst: (0.02, 0.006), consistency: 1.0..9.0 });
}

#[test]
fn a_corridor_fixes_no_place_along_it() {
    let (world, mut laser) = (corridor(), laser(0.02, 6));
    let first = scan(&world, &mut laser, &Se2::default());
    let reading = scan(&world, &mut laser, &Se2::new(0.3, 0.1, 0.05));
    let (mut field, mut climbing, mut point_to_line) = (field(), climbing(), point_to_line());
    let matchers: [&mut dyn ScanMatcher; 3] = [&mut field, &mut climbing, &mut point_to_line];
    for matcher in matchers {
        matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &first }]).unwrap();
        let found = matcher.match_scan(&reading, &Se2::new(0.1, 0.0, 0.0)).unwrap();
        let pose = found.target_from_source;
        assert!((pose.y() - 0.1).abs() < 0.02 && (pose.yaw() - 0.05).abs() < 0.005, "{pose:?}");
        let unobserved = found.unobserved;
        assert!((unobserved.trace() - 1.0).abs() < 1e-9 && unobserved[(0, 0)] > 0.9, "{unobserved}");
        assert!((pose.x() - 0.1).abs() < 0.02, "{pose:?}");
    }
}

/// Half of what the scan sees has come since: it pulls no matcher that leaves out what does not fit.
#[test]
fn what_the_target_does_not_show_pulls_little() {
    let mut shapes = agv_sim::Shape::room([-6.0, -4.0].into(), [7.0, 5.0].into()).to_vec();
    let empty = agv_sim::World2d::new(shapes.clone()).unwrap();
    for (x, y) in [(2.0, 1.0), (-2.0, 1.5), (1.0, -2.0), (-2.5, -1.5), (3.5, -0.5)] {
        shapes.push(agv_sim::Shape::rectangle(Se2::new(x, y, x), 0.8, 0.6));
    }
    let full = agv_sim::World2d::new(shapes).unwrap();
    let mut laser = laser(0.02, 12);
    let first = scan(&empty, &mut laser, &Se2::default());
    let truth = Se2::new(0.2, -0.15, 0.1);
    let reading = scan(&full, &mut laser, &truth);
    let (mut climbing, mut point_to_line) = (climbing(), point_to_line());
    let matchers: [&mut dyn ScanMatcher; 2] = [&mut climbing, &mut point_to_line];
    for matcher in matchers {
        matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &first }]).unwrap();
        let found = matcher.match_scan(&reading, &Se2::new(0.1, -0.1, 0.05)).unwrap();
        let error = truth.between(&found.target_from_source).log();
        assert!((0.4..0.9).contains(&found.inlier_ratio), "{found:?}");
        assert!(error.xy().norm() < 0.03 && error.z.abs() < 0.01, "{error:?}");
    }
}

/// Scans that are too far apart for one grid, guesses that are nowhere, and no scans at all.
fn refuses_what_is_nowhere(matcher: &mut dyn ScanMatcher) {
    let reading = scan(&hall(), &mut laser(0.01, 9), &Se2::default());
    let at = |x: f64| TargetScan { target_from_base: Se2::new(x, 0.0, 0.0), scan: &reading };
    assert!(matches!(matcher.set_target(&[at(0.0), at(1e9)]), Err(AlignmentError::Invalid(Error::TooMany { .. }))));
    assert!(matcher.set_target(&[]).is_err());
    matcher.set_target(&[at(0.0)]).unwrap();
    for x in [1e9, 1e300, f64::MAX] {
        let found = matcher.match_scan(&reading, &Se2::new(x, -x, 0.0)).unwrap();
        assert_eq!((found.termination, found.target_from_source.x()), (Termination::TooFewPoints, x));
    }
}

#[test]
fn bad_fields_are_named() {
    let good = FieldMatcherParams::default();
    for (name, bad) in [
        ("resolution", FieldMatcherParams { resolution: f64::NAN, ..good }),
        ("sigma", FieldMatcherParams { sigma: -1.0, ..good }),
        ("sigma / resolution", FieldMatcherParams { sigma: 0.01, ..good }),
        ("levels", FieldMatcherParams { levels: 0, ..good }),
        ("range_sigma", FieldMatcherParams { range_sigma: 0.0, ..good }),
        ("min_points", FieldMatcherParams { min_points: 1, ..good }),
        ("min_inlier_ratio", FieldMatcherParams { min_inlier_ratio: f64::NAN, ..good }),
        ("translation", FieldMatcherParams { observable: PoseSigma { translation: -1.0, rotation: 1.0 }, ..good }),
    ] {
        let error = FieldMatcher::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    refuses_what_is_nowhere(&mut field());
}

#[test]
fn bad_climbs_are_named() {
    let good = ClimbingMatcherParams::default();
    for (name, bad) in [
        ("resolution", ClimbingMatcherParams { resolution: f64::NAN, ..good }),
        ("sigma / resolution", ClimbingMatcherParams { sigma: 0.01, ..good }),
        ("step", ClimbingMatcherParams { step: 0.0, ..good }),
        ("turn", ClimbingMatcherParams { turn: f64::INFINITY, ..good }),
        ("halvings", ClimbingMatcherParams { halvings: 99, ..good }),
        ("max_moves", ClimbingMatcherParams { max_moves: 0, ..good }),
        ("range_sigma", ClimbingMatcherParams { range_sigma: -0.1, ..good }),
        ("min_points", ClimbingMatcherParams { min_points: 1, ..good }),
        ("min_inlier_ratio", ClimbingMatcherParams { min_inlier_ratio: 2.0, ..good }),
        ("rotation", ClimbingMatcherParams { observable: PoseSigma { translation: 1.0, rotation: 0.0 }, ..good }),
    ] {
        let error = ClimbingMatcher::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    refuses_what_is_nowhere(&mut climbing());
}

#[test]
fn bad_closest_points_are_named() {
    let good = PointToLineParams::default();
    for (name, bad) in [
        ("resolution", PointToLineParams { resolution: 0.0, ..good }),
        ("max_distance", PointToLineParams { max_distance: 0.1, ..good }),
        ("max_distance", PointToLineParams { max_distance: f64::NAN, ..good }),
        ("cut", PointToLineParams { cut: 0.0, ..good }),
        ("sigma", PointToLineParams { sigma: f64::NAN, ..good }),
        ("range_sigma", PointToLineParams { range_sigma: 0.0, ..good }),
        ("normal_radius", PointToLineParams { normal_radius: -1.0, ..good }),
        ("max_iterations", PointToLineParams { max_iterations: 0, ..good }),
        ("min_points", PointToLineParams { min_points: 0, ..good }),
        ("min_inlier_ratio", PointToLineParams { min_inlier_ratio: f64::NAN, ..good }),
        ("translation", PointToLineParams { observable: PoseSigma { translation: 0.0, rotation: 1.0 }, ..good }),
    ] {
        let error = PointToLineMatcher::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    refuses_what_is_nowhere(&mut point_to_line());
}
