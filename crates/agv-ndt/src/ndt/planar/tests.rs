use super::*;
use agv_core::{compute::Seed, geometry::Twist2, roles::laws, time::Stamp};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use proptest::prelude::*;

fn block(x: f64, y: f64, width: f64, height: f64, yaw: f64) -> Shape {
    let at = Se2::new(x, y, yaw);
    let corner = |a: f64, b: f64| at.act(&Vector2::new(a * width, b * height));
    Shape::Polygon(vec![corner(-0.5, -0.5), corner(0.5, -0.5), corner(0.5, 0.5), corner(-0.5, 0.5)])
}

/// A room of 12 x 9 m with two boxes.
fn room() -> World2d {
    let mut shapes = Shape::room(Vector2::new(-5.5, -4.0), Vector2::new(6.5, 5.0)).to_vec();
    shapes.extend([block(2.5, 2.0, 1.2, 0.8, 0.4), block(-3.0, -1.5, 0.6, 1.6, -0.2)]);
    World2d::new(shapes).unwrap()
}

fn scan(world: &World2d, at: &Se2, seed: u64) -> LaserScan {
    let params = LaserParams { range_sigma: 0.01, ..LaserParams::default() };
    Laser::new(params, Seed(seed)).unwrap().scan(world, at, &Twist2::default(), Stamp::default()).unwrap().clone()
}

fn matcher(target: &LaserScan) -> NdtScanMatcher {
    let mut matcher = NdtScanMatcher::new(NdtScanMatcherParams::default()).unwrap();
    matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: target }]).unwrap();
    matcher
}

#[test]
fn it_plays_its_role() {
    let (world, truth) = (room(), Se2::new(0.3, -0.2, 0.1));
    let (target, source) = (scan(&world, &Se2::default(), 1), scan(&world, &truth, 2));
    let mut matcher = NdtScanMatcher::new(NdtScanMatcherParams::default()).unwrap();
    assert_eq!(matcher.match_scan(&source, &truth), Err(AlignmentError::NoTarget));
    let target = [TargetScan { target_from_base: Se2::default(), scan: &target }];
    laws::scan_matcher(&mut matcher, &target, &source, &Se2::default()).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Guesses up to 0.7 m and 17° off come to a centimetre and a fifth of a degree.
    #[test]
    fn poses_are_found_from_guesses_nearby(x in -0.5..0.5_f64, y in -0.5..0.5_f64, yaw in -0.3..0.3_f64, seed in 0..1000_u64) {
        let (world, truth) = (room(), Se2::new(x, y, yaw));
        let found = matcher(&scan(&world, &Se2::default(), 1)).match_scan(&scan(&world, &truth, seed), &Se2::default()).unwrap();
        let error = found.target_from_source.minus(&truth);
        prop_assert!(found.converged(), "{:?}", found.termination);
        prop_assert!(error.xy().norm() < 0.01 && error.z.abs() < 0.0035, "{}", error);
    }
}

/// Nothing that a scan can bring about; should it be all the same, the guess is what is known.
#[test]
fn a_pose_that_is_no_number_does_not_come_out() {
    let target = scan(&room(), &Se2::default(), 1);
    let mut matcher = matcher(&target);
    let guess = Se2::new(0.1, 0.2, 0.3);
    let good = matcher.match_scan(&target, &guess).unwrap();
    assert!(good.converged());
    let quadratic = matcher.levels[0].evaluate(&matcher.points, &guess);
    for bad in [f64::NAN, f64::INFINITY] {
        let descent =
            Descent { pose: Se2::new(bad, 0.0, 0.0), quadratic, termination: Termination::Converged, iterations: 3 };
        let found = matcher.conclude(&matcher.levels[0], &descent, &guess, 5);
        assert_eq!((found.target_from_source, found.termination, found.iterations), (guess, Termination::Stalled, 5));
    }
}

/// Only the walls along a corridor are in sight.
#[test]
fn a_corridor_is_degenerate_lengthwise() {
    let world = World2d::new(vec![block(0.0, -1.5, 200.0, 0.2, 0.0), block(0.0, 1.5, 200.0, 0.2, 0.0)]).unwrap();
    let truth = Se2::new(0.4, 0.1, 0.02);
    let found =
        matcher(&scan(&world, &Se2::default(), 1)).match_scan(&scan(&world, &truth, 2), &Se2::default()).unwrap();
    assert_eq!(found.termination, Termination::Degenerate);
    assert!(found.unobserved[(0, 0)] > 0.95 && (found.unobserved.trace() - 1.0).abs() < 1e-9, "{}", found.unobserved);
    assert!((found.target_from_source.y() - 0.1).abs() < 0.01);
    assert!(found.information[(1, 1)] > 1e3 * found.information[(0, 0)].abs());
}

#[test]
fn scans_of_other_rooms_fit_poorly_and_bad_parameters_are_named() {
    let other = World2d::new(vec![block(3.0, 0.0, 0.3, 9.0, 0.6)]).unwrap();
    let found =
        matcher(&scan(&room(), &Se2::default(), 1)).match_scan(&scan(&other, &Se2::default(), 2), &Se2::default());
    assert!(!found.unwrap().converged());
    // Scans that lie absurdly far apart leave the last target.
    let near = scan(&room(), &Se2::default(), 1);
    let mut matcher = matcher(&near);
    for far in [(1e300, 0.0), (1e4, 1e4), (-1e308, 1e308)] {
        let scans = [Se2::default(), Se2::new(far.0, far.1, 0.0)];
        let scans = scans.map(|target_from_base| TargetScan { target_from_base, scan: &near });
        let refused = matcher.set_target(&scans);
        assert!(
            matches!(refused, Err(AlignmentError::Invalid(agv_core::Error::TooMany { .. }))),
            "{far:?}: {refused:?}"
        );
    }
    assert!(matcher.match_scan(&near, &Se2::default()).unwrap().converged());
    let good = NdtScanMatcherParams::default();
    for bad in [
        NdtScanMatcherParams { resolution: 0.0, ..good },
        NdtScanMatcherParams { resolution: f64::NAN, ..good },
        NdtScanMatcherParams { coarse_levels: 9, ..good },
        NdtScanMatcherParams { outlier_ratio: 1.0, ..good },
        NdtScanMatcherParams { max_iterations: 0, ..good },
        NdtScanMatcherParams { translation_tolerance: 0.0, ..good },
        NdtScanMatcherParams { rotation_tolerance: f64::NAN, ..good },
        NdtScanMatcherParams { min_points: 0, ..good },
        NdtScanMatcherParams { min_inlier_ratio: -0.1, ..good },
        NdtScanMatcherParams { min_facing_share: 0.0, ..good },
        NdtScanMatcherParams { cells: agv_core::grid::GaussianParams { min_points: 1, ..good.cells }, ..good },
    ] {
        assert!(NdtScanMatcher::new(bad).is_err(), "{bad:?}");
    }
}
