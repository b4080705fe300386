use super::super::search::VoxelSearch;
use super::*;
use crate::registration::Freedom;
use crate::scenes::{CORRIDOR, PARALLEL, ROOM, cloud, scatter, sheets};
use agv_core::geometry::{PoseSigma, So3};
use agv_core::roles::laws;
use agv_core::sensors::{PointCloud, VoxelGrid};
use nalgebra::{Vector3, Vector6};

fn room(truth: &Se3) -> (PointCloud, PointCloud) {
    (cloud(&sheets(&ROOM, 80.0, 1), &Se3::identity()), cloud(&sheets(&ROOM, 12.0, 2), truth))
}

fn truth() -> Se3 {
    Se3::from_parts(Vector3::new(0.4, -0.3, 0.05), So3::from_roll_pitch_yaw(0.01, -0.02, 0.12))
}

fn aligned(params: NdtParams, target: &PointCloud, source: &PointCloud, guess: &Se3) -> Alignment<Se3> {
    let mut ndt = NdtRegistration::new(params).unwrap();
    ndt.set_target(target).unwrap();
    ndt.align(source, guess).unwrap()
}

#[test]
fn the_laws_of_a_registration_hold() {
    let (target, source) = room(&truth());
    let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap();
    laws::registration(&mut ndt, &target, &source, &Se3::identity()).unwrap();
}

#[test]
fn every_search_and_optimizer_finds_the_pose() {
    let (target, source) = room(&truth());
    let all =
        [VoxelSearch::Direct1, VoxelSearch::Direct7, VoxelSearch::Direct8, VoxelSearch::Direct27, VoxelSearch::Radius];
    for search in all {
        for optimizer in [Optimizer::TrustRegion, Optimizer::LineSearch] {
            let params = NdtParams { search, optimizer, ..NdtParams::default() };
            let found = aligned(params, &target, &source, &Se3::identity());
            let error = found.target_from_source.minus(&truth());
            assert!(found.converged(), "{search:?} {optimizer:?}: {found:?}");
            assert!(error.fixed_rows::<3>(0).norm() < 0.02, "{search:?} {optimizer:?}: {error}");
            assert!(error.fixed_rows::<3>(3).norm() < 0.004, "{search:?} {optimizer:?}: {error}");
            assert!(found.inlier_ratio > 0.7 && found.unobserved.norm() < 1e-9, "{found:?}");
        }
    }
}

#[test]
fn a_target_that_grew_is_to_the_bit_one_that_was_made_at_once() {
    let source = room(&truth()).1;
    let poses = [0.0, 0.7, -1.3]
        .map(|x| Se3::from_parts(Vector3::new(x, 0.5 * x, 0.0), So3::from_roll_pitch_yaw(0.0, 0.0, 0.2 * x)));
    let clouds: Vec<_> = poses.iter().zip(1..).map(|(pose, draw)| cloud(&sheets(&ROOM, 30.0, draw), pose)).collect();
    let mut map = NdtMap::new(NdtParams::default().voxels).unwrap();
    let mut grown = NdtRegistration::new(NdtParams { coarse_levels: 3, ..NdtParams::default() }).unwrap();
    assert!(grown.insert(&PointCloud::default(), &Se3::identity()).is_err() && grown.map().is_empty());
    for (cloud, pose) in clouds.iter().zip(&poses) {
        assert_eq!(map.insert(cloud, pose), grown.insert(cloud, pose).unwrap());
        let mut once = NdtRegistration::new(*grown.params()).unwrap();
        once.set_map(&map).unwrap();
        assert_eq!(grown.map(), &map);
        assert_eq!(grown.align(&source, &Se3::identity()).unwrap(), once.align(&source, &Se3::identity()).unwrap());
        let nowhere = Se3::from_parts(Vector3::repeat(f64::NAN), So3::default());
        assert!(grown.insert(cloud, &nowhere).is_err());
    }
    assert_eq!(grown.into_map(), map);
}

#[test]
fn a_glance_at_many_poses_is_the_same_for_any_number_of_threads_and_tells_the_right_one() {
    let (target, source) = room(&truth());
    let pose = |i: u32| {
        truth().compose(&Se3::from_parts(
            Vector3::new(f64::from(i % 20) - 10.0, f64::from(i / 20) - 10.0, 0.0),
            So3::default(),
        ))
    };
    let poses: Vec<_> = (0..400).map(pose).collect();
    let glance = |threads| {
        let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap().with_parallelism(Par::threads(threads));
        ndt.set_target(&target).unwrap();
        let mut scores = vec![f64::NAN];
        ndt.glance(&source, &poses, &mut scores);
        scores
    };
    let scores = glance(1);
    assert_eq!(scores, glance(3));
    let best = (0..400).max_by(|&a, &b| scores[a].total_cmp(&scores[b])).unwrap();
    assert_eq!((best, scores.len()), (210, 400));
}

#[test]
fn threads_change_no_bit() {
    let (target, source) = room(&truth());
    let align = |par| {
        let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap().with_parallelism(par);
        ndt.set_target(&target).unwrap();
        let first = ndt.align(&source, &Se3::identity()).unwrap();
        // What an earlier call left in the buffers does not matter either.
        ndt.align(&target, &truth()).unwrap();
        assert_eq!(ndt.align(&source, &Se3::identity()).unwrap(), first);
        first
    };
    let expected = align(Par::Seq);
    for threads in [2, 3, 7] {
        assert_eq!(align(Par::threads(threads)), expected, "{threads}");
    }
}

#[test]
fn a_map_of_many_clouds_is_a_target() {
    let (target, source) = room(&truth());
    let (half, other) = (truth().inverse(), sheets(&ROOM, 40.0, 5));
    let mut map = NdtMap::new(VoxelParams::default()).unwrap();
    map.insert(&cloud(&other, &half), &half);
    map.insert(&target, &Se3::identity());
    let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap();
    ndt.set_map(&map).unwrap();
    assert_eq!(ndt.map(), &map);
    let found = ndt.align(&source, &Se3::identity()).unwrap();
    assert!(found.converged() && found.target_from_source.minus(&truth()).norm() < 0.02, "{found:?}");
    let report = ndt.report();
    assert!(report.nearest_likelihood > 0.5 && report.matched_ratio > 0.95, "{report:?}");
    let coarse = NdtMap::new(VoxelParams { resolution: 2.0, ..VoxelParams::default() }).unwrap();
    assert!(matches!(ndt.set_map(&coarse), Err(Error::MapMismatch { .. })));
    assert_eq!(ndt.align(&source, &Se3::identity()).unwrap(), found);
}

#[test]
fn in_the_plane_height_roll_and_pitch_are_the_guess() {
    let pose = Se3::from_parts(Vector3::new(0.4, -0.3, 0.0), So3::from_roll_pitch_yaw(0.0, 0.0, 0.12));
    let (target, source) = room(&pose);
    let params = NdtParams { freedom: Freedom::Planar, ..NdtParams::default() };
    let guess = Se3::from_parts(Vector3::new(0.0, 0.0, 0.03), So3::default());
    let found = aligned(params, &target, &source, &guess);
    let (roll, pitch, yaw) = found.target_from_source.rotation().roll_pitch_yaw();
    assert!(found.converged(), "{found:?}");
    assert!(roll.abs() < 1e-9 && pitch.abs() < 1e-9 && (found.target_from_source.translation().z - 0.03).abs() < 1e-9);
    assert!(
        (yaw - 0.12).abs() < 0.004
            && (found.target_from_source.translation().xy() - pose.translation().xy()).norm() < 0.02
    );
    assert!((found.unobserved.trace() - 3.0).abs() < 1e-9 && (found.information * Vector6::ith(2, 1.0)).norm() < 1e-6);
}

#[test]
fn a_corridor_hides_its_axis_and_the_pose_keeps_it_on_request() {
    let pose = Se3::from_parts(Vector3::new(0.0, 0.2, 0.05), So3::from_roll_pitch_yaw(0.0, 0.0, 0.08));
    let near = |points: Vec<Vector3<f64>>, reach: f64| -> Vec<_> {
        points.into_iter().filter(|p| p.x.abs() < reach).collect()
    };
    let target = cloud(&near(sheets(&CORRIDOR, 60.0, 1), 40.0), &Se3::identity());
    let source = cloud(&near(sheets(&CORRIDOR, 10.0, 2), 25.0), &pose);
    let guess = Se3::from_parts(Vector3::new(0.3, 0.0, 0.0), So3::default());
    let along = guess.rotation().inverse().act(&Vector3::x());
    for hold_unobserved in [false, true] {
        let found = aligned(NdtParams { hold_unobserved, ..NdtParams::default() }, &target, &source, &guess);
        let moved = found.target_from_source.translation();
        assert!((moved - Vector3::new(moved.x, 0.2, 0.05)).norm() < 0.02, "{moved}");
        let axis = Vector6::new(along.x, along.y, along.z, 0.0, 0.0, 0.0);
        assert!((found.unobserved.trace() - 1.0).abs() < 1e-6, "{}", found.unobserved);
        assert!((found.unobserved * axis).norm() > 0.98, "{}", found.unobserved);
        let covariance = found.covariance(PoseSigma { translation: 10.0, rotation: 1.0 }).unwrap();
        assert!(axis.dot(&(covariance * axis)) > 90.0, "{covariance}");
        assert!(covariance[(1, 1)] < 1.0, "{covariance}");
        let termination = if hold_unobserved { Termination::Converged } else { Termination::Degenerate };
        assert_eq!(found.termination, termination);
        assert!(!hold_unobserved || (moved.x - 0.3).abs() < 0.03, "{moved}");
    }
}

/// Floor and two walls of a corner, `n` by `n` points on each, which take turns.
fn corner(n: u16, x: f32) -> PointCloud {
    let sheets = [|a, b| [a, b, 0.3], |a, b| [a, -1.3, b], |a: f32, b: f32| [8.3, a, b]];
    let at = |i: u16| f32::from(i) * 8.0 / f32::from(n);
    let points = (0..n * n).flat_map(|i| sheets.map(|sheet| Vector3::from(sheet(at(i % n), at(i / n)))));
    PointCloud::from_points(points.map(|p| p - Vector3::new(x, 0.0, 0.0)))
}

/// Where sheets take turns in the cloud, every so many points are of one of them.
#[test]
fn no_surface_is_left_out_by_the_order_of_the_points() {
    let (target, source) = (corner(80, 0.0), corner(40, 0.1));
    let mut thinned = PointCloud::default();
    VoxelGrid::new(0.25).unwrap().filter_into(&source, &mut thinned);
    for cloud in [&source, &thinned] {
        for coarse_levels in 0..3 {
            let params = NdtParams { coarse_levels, ..NdtParams::default() };
            let found = aligned(params, &target, cloud, &Se3::identity());
            let error = found.target_from_source.minus(&Se3::from_parts(Vector3::x() * 0.1, So3::default()));
            assert!(found.converged() && error.norm() < 0.005, "{coarse_levels}: {found:?}");
        }
    }
}

#[test]
fn a_wall_that_nothing_fits_to_fixes_nothing() {
    let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap();
    ndt.set_target(&corner(80, 0.0)).unwrap();
    ndt.source.refill(&corner(40, 0.0));
    for (x, unobserved) in [(0.0, 0.0), (0.4, 1.0)] {
        let pose = Se3::from_parts(Vector3::x() * x, So3::default());
        let fit = ndt.objective(0, &pose).fit(&pose, 0.01, &Matrix6::identity());
        assert!((fit.unobserved.m11 - unobserved).abs() < 0.05, "{x}: {}", fit.unobserved);
        assert!(fit.inlier_ratio > 0.55, "{x}: {fit:?}");
    }
}

/// A handful fits anywhere.
#[test]
fn a_handful_of_points_is_too_few_unless_the_caller_knows_better() {
    let (target, source) = room(&truth());
    let few = |count: usize| PointCloud::from_points((0..count).map(|i| source.point(i * source.len() / count)));
    for count in [1, 5, 20, 40] {
        let found = aligned(NdtParams::default(), &target, &few(count), &Se3::identity());
        assert_eq!(found, Alignment::unknown(Se3::identity(), Termination::TooFewPoints), "{count}");
    }
    let knows = NdtParams { min_points: 40, ..NdtParams::default() };
    assert_ne!(aligned(knows, &target, &few(40), &Se3::identity()).termination, Termination::TooFewPoints);
    assert_ne!(
        aligned(NdtParams::default(), &target, &few(50), &Se3::identity()).termination,
        Termination::TooFewPoints
    );
}

/// Along what was held the pose is the guess's, wherever the points lie then.
#[test]
fn what_was_held_is_not_reported_as_observed() {
    let mut ndt = NdtRegistration::new(NdtParams { hold_unobserved: true, ..NdtParams::default() }).unwrap();
    ndt.set_target(&corner(80, 0.0)).unwrap();
    ndt.source.refill(&corner(40, 0.0));
    let (along, all) = (Vector6::x(), ndt.levels.len());
    let held = along * along.transpose();
    let free = ndt.descend(&Se3::identity(), all, &Matrix6::zeros()).result;
    assert!(free.converged() && free.unobserved.norm() < 1e-9 && free.information.m11 > 1e3, "{free:?}");
    let found = ndt.descend(&Se3::identity(), 1, &held);
    assert!(found.result.converged() && !found.still_free, "{:?}", found.result);
    assert!((found.result.unobserved - held).norm() < 1e-9, "{}", found.result.unobserved);
    assert!((found.result.information * along).norm() < 1e-6, "{}", found.result.information);
    assert_eq!(found.report.unobserved_count, 1);
}

/// An end wall that about one in a hundred points is of: whether it is seen to fix the place along the corridor or not, what keeps the guess says
/// so.
#[test]
fn along_a_corridor_with_a_hint_of_an_end_the_place_is_found_or_said_to_be_the_guess() {
    let end = [[24.0, -1.4, -1.0], [0.0, 2.8, 0.0], [0.0, 0.0, 2.5]];
    let near = |per_area: f64, wall: f64, draw: u32| -> Vec<_> {
        let mut points: Vec<_> = sheets(&CORRIDOR, per_area, draw).into_iter().filter(|p| p.x.abs() < 24.0).collect();
        points.extend(sheets(&[end], wall * per_area, draw + 9));
        points
    };
    let target = cloud(&near(40.0, 4.0, 1), &Se3::identity());
    let params = NdtParams { hold_unobserved: true, ..NdtParams::default() };
    let (mut kept, mut found_it) = (0, 0);
    for wall in [0.0, 0.3, 0.5, 0.52, 0.525, 0.53, 0.535, 0.54, 0.6, 1.0, 2.0] {
        for offset in [0.0, 0.1, 0.3] {
            let source = cloud(&near(8.0, wall, 2), &Se3::identity());
            let guess = Se3::from_parts(Vector3::x() * offset, So3::default());
            let found = aligned(params, &target, &source, &guess);
            let moved = found.target_from_source.translation().x - offset;
            let (said, seen) = (found.unobserved.m11 > 0.9, found.unobserved.m11 < 0.1);
            assert!(found.converged() && (said || seen), "{wall} {offset}: {found:?}");
            let known = (found.information * found.unobserved).norm();
            assert!(known < 1e-6 * found.information.norm(), "{wall} {offset}: {found:?}");
            assert!(!said || moved.abs() < 0.02, "{wall} {offset}: {moved} {found:?}");
            assert!(!seen || (moved + offset).abs() < 0.05, "{wall} {offset}: {moved} {found:?}");
            kept += usize::from(said);
            found_it += usize::from(seen);
        }
    }
    assert!(kept > 3 && found_it > 3, "{kept} {found_it}");
}

#[test]
fn a_wrong_place_is_a_poor_fit() {
    let (target, source) = room(&truth());
    for guess in [(30.0, 0.0, 0.0), (0.0, 7.0, 0.0), (6.0, -4.0, 0.8), (-5.0, 3.0, -0.6)] {
        let guess = Se3::from_parts(Vector3::new(guess.0, guess.1, 0.0), So3::from_roll_pitch_yaw(0.0, 0.0, guess.2));
        let found = aligned(NdtParams::default(), &target, &source, &guess);
        let right = found.target_from_source.minus(&truth()).norm() < 0.05;
        assert!(right || !found.converged(), "{found:?}");
        assert!(found.target_from_source.is_finite());
    }
}

/// ... also where directions are free: those of a wrong fit mean nothing.
#[test]
fn a_poor_fit_is_not_taken_for_a_degenerate_one() {
    let wall = cloud(&sheets(&PARALLEL[..1], 60.0, 1), &Se3::identity());
    let found =
        aligned(NdtParams::default(), &wall, &cloud(&sheets(&PARALLEL, 15.0, 2), &Se3::identity()), &Se3::identity());
    assert!(found.inlier_ratio < 0.5 && found.unobserved.trace() > 0.5, "{found:?}");
    assert_eq!(found.termination, Termination::PoorFit, "{found:?}");
}

/// Whatever comes in, an outcome comes out, with a pose that is finite.
#[test]
fn hopeless_sources_and_targets_are_outcomes() {
    let (target, source) = room(&truth());
    let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap();
    for hopeless in [
        vec![],
        vec![Vector3::zeros()],
        vec![Vector3::repeat(f64::NAN); 30],
        (0..30).map(|i| Vector3::repeat(3.0 * f64::from(i))).collect(),
    ] {
        assert!(ndt.set_target(&cloud(&hopeless, &Se3::identity())).is_err());
    }
    let blob: Vec<_> = (0..200).map(|i| Vector3::new(scatter(i), scatter(i + 300), scatter(i + 600))).collect();
    let flat: Vec<_> = sheets(&ROOM[..1], 20.0, 3);
    let line: Vec<_> = (0..300).map(|i| Vector3::new(0.02 * f64::from(i), 0.3, 0.3)).collect();
    let same = vec![Vector3::new(0.2, 0.3, 0.4); 100];
    let sources =
        [vec![], vec![Vector3::new(1.0, 1.0, -1.0)], vec![Vector3::repeat(f64::NAN); 9], blob, flat, line, same];
    let far = Se3::from_parts(Vector3::new(1e7, -1e9, 1e5), So3::default());
    // What ends why: against the room, against itself, and the room against it. A line may slide for ever, and a blob turn.
    let (few, poor, free) = ([Termination::TooFewPoints; 2], [Termination::PoorFit; 2], [Termination::Degenerate; 2]);
    let slides = [Termination::Degenerate, Termination::IterationLimit];
    let reasons = [
        [few, few, few],
        [few, few, few],
        [few, few, few],
        [poor, slides, poor],
        [free, free, poor],
        [slides, free, poor],
        [free, free, [Termination::PoorFit, Termination::Stalled]],
    ];
    for (number, (points, reasons)) in sources.iter().zip(reasons).enumerate() {
        let points = cloud(points, &Se3::identity());
        for (own, target) in [&target, &points].into_iter().enumerate() {
            if ndt.set_target(target).is_err() {
                assert!(own == 1 && reasons[0] == few, "{number}");
                continue;
            }
            for (case, (source, guess)) in
                [(&points, Se3::identity()), (&source, Se3::identity()), (&source, far)].into_iter().enumerate()
            {
                let found = ndt.align(source, &guess).unwrap();
                let reason = found.termination;
                match (own, case) {
                    (_, 0) => assert!(reasons[own].contains(&reason), "{number} {own}: {found:?}"),
                    (0, 1) => assert_eq!(reason, Termination::Converged, "{number}: {found:?}"),
                    (1, 1) => assert!(reasons[2].contains(&reason), "{number}: {found:?}"),
                    _ => assert_eq!(reason, Termination::TooFewPoints, "{number}: {found:?}"),
                }
                assert!(found.target_from_source.is_finite() && found.score.is_finite(), "{number}: {found:?}");
                assert!((0.0..=1.0).contains(&found.inlier_ratio), "{number}: {found:?}");
                assert!(found.covariance(PoseSigma::default()).is_ok(), "{number}: {found:?}");
            }
        }
    }
    let outlier = cloud(&[Vector3::new(1.0, 1.0, -1.0)], &Se3::identity());
    ndt.set_target(&target).unwrap();
    assert!(!ndt.align(&outlier, &Se3::identity()).unwrap().converged());
}

#[test]
fn bad_parameters_are_named() {
    let good = NdtParams::default();
    for bad in [
        NdtParams { coarse_levels: 7, ..good },
        NdtParams { outlier_ratio: 0.0, ..good },
        NdtParams { outlier_ratio: f64::NAN, ..good },
        NdtParams { min_points: 0, ..good },
        NdtParams { min_inlier_ratio: 1.1, ..good },
        NdtParams { min_facing_share: 0.0, ..good },
        NdtParams { voxels: VoxelParams { resolution: 0.0, ..good.voxels }, ..good },
        NdtParams { descent: DescentParams { max_iterations: 0, ..good.descent }, ..good },
    ] {
        assert!(NdtRegistration::new(bad).is_err(), "{bad:?}");
    }
}
