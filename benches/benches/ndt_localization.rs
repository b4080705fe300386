//! Localisation in a 3D map, and the grid that is made of clouds: a 16-line lidar of 1800 directions in an aisle of a factory.
//!
//! `update` takes a cloud at a prediction that is 5 cm and half a degree off, throughput in points of the cloud; `search` looks for
//! the vehicle in the whole hall; `to_grid` casts a cloud into the grid. The planar matcher takes two scans of 1081 beams.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Se3, So3, Twist2, Twist3},
    nalgebra::{Matrix6, Vector3},
    roles::{Correct, Localizer, PoseBelief, ScanMatcher, TargetScan, UpdateOutcome},
    sensors::PointCloud,
    time::Stamp,
};
use agv_ndt::{
    convert::{CloudToGrid, CloudToGridParams},
    ndt::{NdtLocalizer, NdtLocalizerParams, NdtMap, NdtScanMatcher, NdtScanMatcherParams},
};
use agv_sim::{Factory, FactoryParams, Laser, LaserParams, Lidar, LidarParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

struct Case {
    localizer: NdtLocalizer,
    cloud: PointCloud,
    truth: Se3,
}

fn case(factory: &Factory) -> Case {
    let mount = Se3::from_parts(Vector3::new(0.6, 0.0, 1.3), So3::identity());
    let mut lidar = Lidar::new(LidarParams::vlp16().with_mount(mount), Seed(1)).expect("defaults are valid");
    let mut scan = |pose: &Se3| {
        lidar.scan(factory.world(), pose, &Twist3::default(), Stamp::default()).expect("a valid pose").clone()
    };
    let params = NdtLocalizerParams::default();
    let mut map = NdtMap::new(params.ndt.voxels).expect("defaults are valid");
    for aisle in factory.aisles() {
        for i in 0..15 {
            let pose = Se3::from(*aisle * Se2::new(2.0 * f64::from(i), 0.0, 0.0));
            map.insert(&scan(&pose), &pose.compose(&mount));
        }
    }
    let truth = Se3::from(factory.aisles()[1] * Se2::new(11.0, 0.1, 0.05));
    Case { localizer: NdtLocalizer::new(&map, params).expect("a map with voxels"), cloud: scan(&truth), truth }
}

fn localization(c: &mut Criterion) {
    let params = FactoryParams { length: 40.0, width: 21.0, ..FactoryParams::default() };
    let factory = Factory::generate(params, Seed(1)).expect("valid");
    let Case { mut localizer, cloud, truth } = case(&factory);
    let off = truth.compose(&Se3::from(Se2::new(0.04, -0.03, 0.009)));
    let near = PoseBelief::around(off, Matrix6::identity() * 0.0025).expect("a covariance");
    let update = |localizer: &mut NdtLocalizer, belief: &PoseBelief<Se3>| {
        localizer.initialize(belief).expect("a good belief");
        localizer.update(&cloud).expect("a good cloud")
    };
    for belief in [&near, &PoseBelief::Anywhere] {
        assert!(matches!(update(&mut localizer, belief), UpdateOutcome::Applied(_)));
        let error = localizer.estimate().expect("initialised").map_from_base().minus(&truth);
        assert!(error.norm() < 0.02, "{error}");
    }
    let mut group = c.benchmark_group("ndt_localization");
    group.throughput(Throughput::Elements(cloud.len() as u64));
    group.bench_function("update", |b| b.iter(|| black_box(update(&mut localizer, &near))));
    group.sample_size(10);
    group.bench_function("search", |b| b.iter(|| black_box(update(&mut localizer, &PoseBelief::Anywhere))));
    group.finish();
}

fn to_grid(c: &mut Criterion) {
    let params = FactoryParams { length: 40.0, width: 21.0, ..FactoryParams::default() };
    let factory = Factory::generate(params, Seed(1)).expect("valid");
    let Case { cloud, truth, .. } = case(&factory);
    let mut grid = CloudToGrid::new(CloudToGridParams::default()).expect("defaults are valid");
    let report = grid.insert(&cloud, &truth).expect("a good cloud");
    assert!(report.rays.beams_used > 1500 && report.rays.grown, "{report:?}");
    let mut group = c.benchmark_group("cloud_to_grid");
    group.throughput(Throughput::Elements(cloud.len() as u64));
    group.bench_function("to_grid", |b| b.iter(|| black_box(grid.insert(&cloud, &truth).expect("a good cloud"))));
    group.finish();
}

fn scan_matching(c: &mut Criterion) {
    let params = FactoryParams { length: 40.0, width: 21.0, ..FactoryParams::default() };
    let factory = Factory::generate(params, Seed(1)).expect("valid");
    let floor = factory.section(0.3).expect("a finite height");
    let mut laser = Laser::new(LaserParams::default(), Seed(1)).expect("defaults are valid");
    let first = factory.aisles()[1];
    let step = Se2::new(0.3, 0.05, 0.05);
    let mut scan =
        |pose: Se2| laser.scan(&floor, &pose, &Twist2::ZERO, Stamp::default()).expect("a valid pose").clone();
    let (target, source) = (scan(first), scan(first * step));
    let mut matcher = NdtScanMatcher::new(NdtScanMatcherParams::default()).expect("defaults are valid");
    let target = [TargetScan { target_from_base: Se2::default(), scan: &target }];
    matcher.set_target(&target).expect("a good target");
    let found = matcher.match_scan(&source, &Se2::default()).expect("a good scan");
    assert!(found.target_from_source.minus(&step).norm() < 0.02, "{found:?}");
    let mut group = c.benchmark_group("ndt_scan_matching");
    group.throughput(Throughput::Elements(source.len() as u64));
    group.bench_function("set_target", |b| b.iter(|| matcher.set_target(black_box(&target))));
    group.bench_function("match_scan", |b| b.iter(|| black_box(matcher.match_scan(&source, &Se2::default()))));
    group.finish();
}

criterion_group!(benches, localization, to_grid, scan_matching);
criterion_main!(benches);
