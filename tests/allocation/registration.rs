//! Registration of clouds.

use crate::{counter, scenes::clouds};
use agv_nav::core::{
    geometry::{LieGroup, Se3, So3},
    nalgebra::Vector3,
    roles::Registration,
};
use agv_nav::core::{
    geometry::{Se2, Twist2, Twist3},
    nalgebra::{Matrix6, Vector2},
    odometry::MotionIncrement,
    roles::{Correct, Localizer, PoseBelief, ScanMatcher, TargetScan, UpdateOutcome},
    sensors::PointCloud,
    time::Stamp,
};
use agv_nav::ndt::{
    convert::{CloudToGrid, CloudToGridParams},
    gicp::{PointMetric, PointParams, PointRegistration},
    ndt::{
        DistributionRegistration, NdtLocalizer, NdtLocalizerParams, NdtMap, NdtParams, NdtRegistration, NdtScanMatcher,
        NdtScanMatcherParams, VoxelSearch,
    },
    registration::Optimizer,
};
use agv_nav::prelude::Seed;
use agv_sim::{CloudPair, Factory, FactoryParams, Laser, LaserParams, Lidar, LidarParams, Shape, World2d};

/// Aligns twice from far away, which meets more voxels than the next does, and counts while the map is built anew and the same is
/// done from guesses nearby.
fn count_again(registration: &mut dyn Registration) -> usize {
    let CloudPair { target, source, target_from_source } = clouds::pair();
    let off = |x: f64, yaw: f64| {
        let offset = Se3::from_parts(Vector3::new(x, 0.4 * x, 0.1 * x), So3::from_roll_pitch_yaw(0.0, 0.0, yaw));
        target_from_source * offset
    };
    for guess in [off(1.2, 0.2), off(-1.2, -0.2)] {
        registration.set_target(&target).unwrap();
        registration.align(&source, &guess).unwrap();
    }
    let mut found = None;
    let count = counter::count(|| {
        registration.set_target(&target).unwrap();
        for guess in [off(-0.4, 0.03), off(0.3, -0.05), Se3::identity()] {
            found = Some(registration.align(&source, &guess).unwrap());
        }
    });
    assert!((found.unwrap().target_from_source.minus(&target_from_source)).norm() < 0.05, "{found:?}");
    count
}

#[test]
fn normal_distributions() {
    for search in [VoxelSearch::Direct7, VoxelSearch::Direct8, VoxelSearch::Radius] {
        for optimizer in [Optimizer::TrustRegion, Optimizer::LineSearch] {
            let params = NdtParams { search, optimizer, ..NdtParams::default() };
            assert_eq!(count_again(&mut NdtRegistration::new(params).unwrap()), 0, "{search:?} {optimizer:?}");
        }
    }
}

#[test]
fn distributions_of_both_clouds() {
    assert_eq!(count_again(&mut DistributionRegistration::new(NdtParams::default()).unwrap()), 0);
}

#[test]
fn closest_points() {
    for metric in [PointMetric::PointToPlane, PointMetric::Generalized, PointMetric::Voxelized] {
        let params = PointParams { metric, ..PointParams::default() };
        assert_eq!(count_again(&mut PointRegistration::new(params).unwrap()), 0, "{metric:?}");
    }
}

#[test]
fn localization_in_a_map() {
    let (CloudPair { target, source, target_from_source }, params) = (clouds::pair(), NdtLocalizerParams::default());
    let mut map = NdtMap::new(params.ndt.voxels).unwrap();
    map.insert(&target, &Se3::identity());
    let mut localizer = NdtLocalizer::new(&map, params).unwrap();
    let source = source.with_mount(Se3::default()).unwrap();
    let belief = PoseBelief::around(target_from_source, Matrix6::identity() * 0.01).unwrap();
    localizer.initialize(&belief).unwrap();
    let at = |step: u32| Stamp::from_seconds(0.1 * f64::from(step));
    let clouds: Vec<_> = (0..18).map(|step| source.clone().with_stamp(at(step + 1))).collect();
    let mut update = |step: u32| {
        let still = MotionIncrement::between(at(step), &Se3::default(), at(step + 1), &Se3::default()).unwrap();
        localizer.predict(&still).unwrap();
        let outcome = localizer.update(&clouds[step as usize]).unwrap();
        assert!(matches!(outcome, UpdateOutcome::Applied(_)), "{outcome:?}");
    };
    // A full history of motions, first.
    (0..14).for_each(&mut update);
    assert_eq!(counter::count(|| (14..17).for_each(&mut update)), 0);
}

#[test]
fn laser_scans_by_normal_distributions() {
    let world = World2d::new(Shape::room(Vector2::new(-5.5, -4.0), Vector2::new(6.5, 5.0)).to_vec()).unwrap();
    let scan = |x: f64, seed: u64| {
        let mut laser = Laser::new(LaserParams { range_sigma: 0.01, ..LaserParams::default() }, Seed(seed)).unwrap();
        laser.scan(&world, &Se2::new(x, 0.0, 0.0), &Twist2::default(), Stamp::default()).unwrap().clone()
    };
    let (target, first, second) = (scan(0.0, 1), scan(0.3, 2), scan(0.2, 3));
    let mut matcher = NdtScanMatcher::new(NdtScanMatcherParams::default()).unwrap();
    matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &target }]).unwrap();
    matcher.match_scan(&first, &Se2::default()).unwrap();
    let mut found = None;
    assert_eq!(counter::count(|| found = matcher.match_scan(&second, &Se2::default()).ok()), 0);
    assert!(found.is_some_and(|found| found.converged()), "{found:?}");
}

/// Two lidars by turns, each with its mount.
#[test]
fn clouds_to_a_grid() {
    let params = FactoryParams { length: 24.0, width: 10.0, ..FactoryParams::default() };
    let factory = Factory::generate(params, Seed(1)).unwrap();
    let pose = Se3::from(factory.aisles()[0] * Se2::new(4.0, 0.0, 0.0));
    let clouds: Vec<PointCloud> = [0.2, 0.9]
        .map(|x| {
            let mount = Se3::from_parts(Vector3::new(x, 0.0, 1.3), So3::default());
            let params = LidarParams { columns: 450, ..LidarParams::vlp16().with_mount(mount) };
            let mut lidar = Lidar::new(params, Seed(2)).unwrap();
            lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::default()).unwrap().clone()
        })
        .into();
    let mut grid = CloudToGrid::new(CloudToGridParams::default()).unwrap();
    let mut insert = || clouds.iter().for_each(|cloud| assert!(grid.insert(cloud, &pose).is_ok()));
    insert();
    assert_eq!(counter::count(insert), 0);
}
