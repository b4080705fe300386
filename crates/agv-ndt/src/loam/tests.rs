//! What the odometry does on scenes whose truth is known.

use super::*;
use crate::ndt::{NdtParams, NdtRegistration};
use crate::odometry::{Follow, FollowParams};
use crate::scenes::{CORRIDOR, ROOM, cloud, sheets};
use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Se3, So3, Twist2},
    roles::{LidarOdometry, LidarOdometryStep, Termination, laws},
    sensors::{PointCloud, PointSource},
    time::Stamp,
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams, Simulator3d, Vehicle, VehicleParams};
use nalgebra::Vector3;

fn odometry(params: LoamParams) -> LoamOdometry {
    LoamOdometry::new(params).unwrap()
}

fn shift(x: f64, y: f64, yaw: f64) -> Se3 {
    Se3::from(Se2::new(x, y, yaw))
}

/// Steps along poses in a scene, another draw of its points each time.
fn walk(scene: &[[[f64; 3]; 3]], poses: &[Se3], params: LoamParams) -> Vec<LidarOdometryStep> {
    let mut odometry = odometry(params);
    let seen = poses.iter().zip(0..).map(|(pose, draw)| cloud(&sheets(scene, 60.0, draw), pose));
    seen.map(|seen| odometry.process(&seen, None).unwrap()).collect()
}

#[test]
fn the_laws_of_lidar_odometry_hold() {
    let first = cloud(&sheets(&ROOM, 60.0, 0), &Se3::identity());
    let second = cloud(&sheets(&ROOM, 60.0, 1), &shift(0.3, 0.1, 0.05));
    for target in [LoamTarget::LocalMap, LoamTarget::LastCloud, LoamTarget::LastCloudThenMap] {
        let mut player = odometry(LoamParams { target, ..LoamParams::default() });
        laws::lidar_odometry(&mut player, &first, &second).unwrap();
    }
}

#[test]
fn a_walk_in_a_room_is_followed_with_every_target_and_solve() {
    let poses: Vec<_> = (0..12).map(f64::from).map(|i| shift(0.15 * i, 0.05 * i, 0.06 * i)).collect();
    for (target, solve, bound) in [
        (LoamTarget::LocalMap, LoamSolve::Joint, 0.01),
        (LoamTarget::LastCloudThenMap, LoamSolve::Joint, 0.01),
        (LoamTarget::LastCloud, LoamSolve::Joint, 0.05),
        (LoamTarget::LocalMap, LoamSolve::TwoStep, 0.01),
        (LoamTarget::LastCloud, LoamSolve::TwoStep, 0.05),
        (LoamTarget::LastCloudThenMap, LoamSolve::TwoStep, 0.01),
    ] {
        let steps = walk(&ROOM, &poses, LoamParams { target, solve, ..LoamParams::default() });
        for (step, pose) in steps.iter().zip(&poses).skip(1) {
            let error = pose.between(&step.odom_from_base).log();
            assert!(step.alignment.unwrap().converged(), "{target:?} {solve:?}");
            assert!(error.norm() < bound, "{target:?} {solve:?}: {error:?}");
        }
    }
}

/// A lidar that is carried, tilted and lifted: on the local map two steps end with the joint solve, and are as good as that.
#[test]
fn a_walk_that_rolls_and_pitches_is_followed_in_two_steps_too() {
    let pose = |i: f64| {
        let turn = So3::from_roll_pitch_yaw(0.12 * (1.3 * i).sin(), 0.12 * (0.9 * i).sin(), 0.15 * i);
        Se3::from_parts(Vector3::new(0.2 * i, 0.1 * i, 0.15 * (1.7 * i).sin()), turn)
    };
    let poses: Vec<_> = (0..12).map(f64::from).map(pose).collect();
    for solve in [LoamSolve::Joint, LoamSolve::TwoStep] {
        let steps = walk(&ROOM, &poses, LoamParams { solve, ..LoamParams::default() });
        for (step, pose) in steps.iter().zip(&poses).skip(1) {
            assert!(step.alignment.unwrap().converged(), "{solve:?}: {step:?}");
            let error = pose.between(&step.odom_from_base).log();
            assert!(error.norm() < 0.01, "{solve:?}: {error:?}");
        }
    }
}

#[test]
fn a_jump_that_no_prediction_foresaw_is_found_and_a_vehicle_at_rest_does_not_drift() {
    let mut poses = vec![Se3::identity(); 8];
    poses.extend([shift(0.9, -0.3, 0.3); 4]);
    let steps = walk(&ROOM, &poses, LoamParams::default());
    for (step, pose) in steps.iter().zip(&poses) {
        assert!(pose.between(&step.odom_from_base).log().norm() < 0.01, "{step:?}");
    }
}

#[test]
fn along_a_corridor_the_prior_is_kept_and_the_direction_reported() {
    let mut odometry = odometry(LoamParams::default());
    let (pose, prior) = (shift(0.5, 0.05, 0.0), shift(0.43, 0.0, 0.02));
    odometry.process(&cloud(&sheets(&CORRIDOR, 20.0, 0), &Se3::identity()), None).unwrap();
    let step = odometry.process(&cloud(&sheets(&CORRIDOR, 20.0, 1), &pose), Some(&prior)).unwrap();
    let alignment = step.alignment.unwrap();
    assert!(alignment.converged());
    assert!((alignment.unobserved.trace() - 1.0).abs() < 1e-6, "{}", alignment.unobserved);
    let x = alignment.unobserved.column(0).norm();
    assert!(x > 0.99, "{}", alignment.unobserved);
    assert!((alignment.information * alignment.unobserved.column(0)).norm() < 1e-6 * alignment.information.norm());
    let found = step.odom_from_base.translation();
    assert!((found.x - 0.43).abs() < 0.01, "{found}");
    assert!((found.y - 0.05).abs() < 0.01 && found.z.abs() < 0.01, "{found}");
}

#[test]
fn clouds_that_are_nearly_blind_move_neither_the_pose_nor_the_map() {
    for target in [LoamTarget::LocalMap, LoamTarget::LastCloud, LoamTarget::LastCloudThenMap] {
        let mut odometry = odometry(LoamParams { target, ..LoamParams::default() });
        let room = cloud(&sheets(&ROOM, 60.0, 0), &Se3::identity());
        for draw in 0..4 {
            odometry.process(&cloud(&sheets(&ROOM, 60.0, draw), &Se3::identity()), None).unwrap();
        }
        for count in [1, 5, 20, 40] {
            let few = PointCloud::from_points((0..count).map(|i| room.point(i * room.len() / count)));
            odometry.process(&room, None).unwrap();
            let map = odometry.map().len();
            let step = odometry.process(&few, None).unwrap();
            assert_eq!(step.alignment.unwrap().termination, Termination::TooFewPoints, "{target:?} {count}");
            assert!(step.odom_from_base.log().norm() < 0.02, "{target:?} {count}: {step:?}");
            assert_eq!(odometry.map().len(), map, "{target:?} {count}");
        }
    }
}

#[test]
fn clouds_of_nothing_are_an_outcome_and_leave_the_map_as_it_is() {
    let mut odometry = odometry(LoamParams::default());
    let room = cloud(&sheets(&ROOM, 60.0, 0), &Se3::identity());
    odometry.process(&room, None).unwrap();
    for bad in [
        PointCloud::default(),
        PointCloud::from_points([Vector3::repeat(f32::NAN); 40]),
        PointCloud::from_points([Vector3::new(3.0, 1.0, 0.5); 400]),
        PointCloud::from_points((0..400_u16).map(|i| Vector3::new(1.0 + f32::from(i) * 0.1, 0.0, 0.0))),
        PointCloud::from_points([Vector3::repeat(3e38); 40]),
    ] {
        let step = odometry.process(&bad, None).unwrap();
        assert!((step.odom_from_base.translation()).norm() < 1e-9);
        let alignment = step.alignment.unwrap();
        assert!(!alignment.converged() && alignment.target_from_source.is_finite() && step.odom_from_base.is_finite());
        assert!(alignment.information.iter().all(|v| v.is_finite()));
    }
    // A lidar that was covered for half a second and longer is found where it was.
    for i in 1..4 {
        let pose = shift(0.1 * f64::from(i), 0.0, 0.0);
        let step = odometry.process(&cloud(&sheets(&ROOM, 60.0, i), &pose), None).unwrap();
        assert!(step.alignment.unwrap().converged());
        assert!(pose.between(&step.odom_from_base).log().norm() < 0.01, "{step:?}");
    }
    odometry.reset();
    assert!(odometry.map().is_empty());
    assert!(odometry.process(&room, None).unwrap().alignment.is_none());
}

#[test]
fn bad_parameters_and_priors_are_named() {
    let good = LoamParams::default();
    for bad in [
        LoamParams { max_surfaces: 0, ..good },
        LoamParams { max_rounds: 0, ..good },
        LoamParams { initial_sigma: 0.0, ..good },
        LoamParams { kernel: f64::NAN, ..good },
        LoamParams { inlier_distance: -1.0, ..good },
        LoamParams { min_agreement: 1.5, ..good },
        LoamParams { min_facing_share: 0.0, ..good },
        LoamParams { features: FeatureParams { surfaces_per_sector: 0, ..good.features }, ..good },
        LoamParams { features: FeatureParams { edge_bend: 0.0, ..good.features }, ..good },
        LoamParams { features: FeatureParams { range_sigma: f64::NAN, ..good.features }, ..good },
        LoamParams { features: FeatureParams { min_range: 200.0, ..good.features }, ..good },
        LoamParams { features: FeatureParams { leaf: 0.0, ..good.features }, ..good },
        LoamParams { map: LocalMapParams { radius: f64::INFINITY, ..good.map }, ..good },
        LoamParams { map: LocalMapParams { surface_spacing: 0.0, ..good.map }, ..good },
        LoamParams { map: LocalMapParams { edge_spacing: f64::NAN, ..good.map }, ..good },
    ] {
        assert!(LoamOdometry::new(bad).is_err(), "{bad:?}");
    }
    let mut odometry = odometry(good);
    let nowhere = Se3::from_parts(Vector3::new(0.0, f64::NAN, 0.0), So3::default());
    assert!(odometry.process(&PointCloud::default(), Some(&nowhere)).is_err());
    // Far, and too far.
    let far = Se3::from_parts(Vector3::new(1e308, 0.0, 0.0), So3::default());
    odometry.process(&PointCloud::default(), None).unwrap();
    assert!(odometry.process(&PointCloud::default(), Some(&far)).unwrap().odom_from_base.is_finite());
    assert!(odometry.process(&PointCloud::default(), Some(&far)).is_err());
}

#[test]
fn a_cloud_that_is_skipped_does_not_lose_the_last_one() {
    let mut odometry = odometry(LoamParams { target: LoamTarget::LastCloud, ..LoamParams::default() });
    let seen = |i: u32| cloud(&sheets(&ROOM, 60.0, i), &shift(0.1 * f64::from(i), 0.0, 0.0));
    for i in 0..3 {
        odometry.process(&seen(i), None).unwrap();
    }
    let lost = odometry.process(&PointCloud::default(), None).unwrap();
    assert!((lost.odom_from_base.translation().x - 0.3).abs() < 0.03, "goes on as it went");
    let found = odometry.process(&seen(4), None).unwrap();
    assert!(found.alignment.unwrap().converged() && (found.odom_from_base.translation().x - 0.4).abs() < 0.03);
}

#[test]
fn rings_and_times_of_nonsense_are_survived() {
    let (good, _) = drive(LidarParams::vlp16(), 6).remove(0);
    let bare = || PointCloud::new(good.x().to_vec(), good.y().to_vec(), good.z().to_vec()).unwrap();
    let mut extractor = FeatureExtractor::new(FeatureParams::default()).unwrap();
    let (mut before, mut after, mut out) = (Features::default(), Features::default(), Features::default());
    extractor.extract_into(&good, Par::Seq, &mut before).unwrap();
    let wild = bare().with_ring((0..good.len()).map(|i| (i * 7919 % 65_536) as u16).collect()).unwrap();
    extractor.extract_into(&wild, Par::Seq, &mut out).unwrap();
    extractor.extract_into(&good, Par::Seq, &mut after).unwrap();
    assert_eq!(before, after, "as if nothing had been");
    for time in [f32::NAN, f32::INFINITY, 1e38] {
        let mut odometry = odometry(LoamParams::default());
        let cloud = bare().with_ring(good.ring().unwrap().to_vec()).unwrap().with_time(vec![time; good.len()]).unwrap();
        for (i, stamp) in [0.0, 0.1, 0.2].map(Stamp::from_seconds).into_iter().enumerate() {
            let prior = shift(0.1, 0.0, 0.1);
            let step = odometry.process(&cloud.clone().with_stamp(stamp), Some(&prior)).unwrap();
            assert!(step.odom_from_base.is_finite(), "{time} {i}");
        }
    }
}

/// A 16-line lidar on a vehicle that drives a curve in a factory, skewed as such clouds are.
fn drive(lines: LidarParams, steps: u32) -> Vec<(PointCloud, Se3)> {
    let factory = Factory::generate(FactoryParams::default(), Seed(3)).unwrap();
    let start = factory.aisles()[1];
    let vehicle = Vehicle::new(VehicleParams::default(), start, Seed(3)).unwrap();
    let mount = Se3::from_parts(Vector3::new(0.1, 0.0, 1.8), So3::default());
    let lidar = Lidar::new(LidarParams { columns: 900, ..lines.with_mount(mount) }, Seed(3)).unwrap();
    let mut simulator = Simulator3d::new(factory.world(), vehicle, 0.02).unwrap().with_lidar(lidar).unwrap();
    let mut seen = Vec::new();
    for step in 0..steps {
        let turn = if step % 100 < 50 { 0.15 } else { -0.15 };
        let observed = simulator.step(&Twist2::new(1.5, 0.0, turn)).unwrap();
        let clouds =
            observed.clouds().map(|(cloud, truth)| (cloud.clone(), start_from(&start.into(), &truth.map_from_base)));
        seen.extend(clouds.collect::<Vec<_>>());
    }
    seen
}

fn start_from(start: &Se3, pose: &Se3) -> Se3 {
    start.between(pose)
}

#[test]
fn a_skewed_drive_with_16_lines_is_followed_to_the_same_bits_for_any_threads() {
    let seen = drive(LidarParams::vlp16(), 200);
    let follow = |par: Par| {
        let mut odometry = odometry(LoamParams::default()).with_parallelism(par);
        seen.iter().map(|(cloud, _)| odometry.process(cloud, None).unwrap()).collect::<Vec<_>>()
    };
    let steps = follow(Par::Seq);
    for (step, (_, truth)) in steps.iter().zip(&seen).skip(1) {
        assert_eq!(step.alignment.unwrap().termination, Termination::Converged);
        let error = truth.between(&step.odom_from_base).log();
        assert!(error.fixed_rows::<3>(0).norm() < 0.1 && error.fixed_rows::<3>(3).norm() < 0.01, "{error:?}");
    }
    assert_eq!(follow(Par::threads(3)), steps);
}

#[test]
fn a_skewed_drive_is_followed_by_distributions_too() {
    let params = FollowParams::for_distributions();
    let mut odometry = Follow::new(NdtRegistration::new(NdtParams::default()).unwrap(), params).unwrap();
    for (cloud, truth) in drive(LidarParams::uniform64(), 60) {
        let error = truth.between(&odometry.process(&cloud, None).unwrap().odom_from_base).log();
        assert!(error.norm() < 0.15, "{error:?}");
    }
}

#[test]
fn lines_without_names_give_the_same_features_as_with() {
    let (cloud, _) = drive(LidarParams { range_sigma: 0.0, ..LidarParams::vlp16() }, 6).remove(0);
    let mut extractor = FeatureExtractor::new(FeatureParams::default()).unwrap();
    let (mut named, mut found) = (Features::default(), Features::default());
    extractor.extract_into(&cloud, Par::Seq, &mut named).unwrap();
    let bare = PointCloud::new(cloud.x().to_vec(), cloud.y().to_vec(), cloud.z().to_vec()).unwrap();
    let bare = bare.with_time(cloud.time().unwrap().to_vec()).unwrap().with_stamp(Stamp::default());
    extractor.extract_into(&bare, Par::Seq, &mut found).unwrap();
    assert_eq!(found, named);
    assert!(named.surfaces.len() > 500 && named.edges.len() > 50, "{} {}", named.surfaces.len(), named.edges.len());
}
