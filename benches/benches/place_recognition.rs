//! Place recognition and maps of key frames: a cloud of 16 lines in a factory among a thousand places, and what they make together.
//!
//! Describing a cloud, finding it among 1000 places by ring keys and sectors, comparing it with all of them (what the ring keys save),
//! checking a find by registration with the clouds around it, and putting a map together. Throughput is in points, places, finds and
//! points.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Se3, So3, Twist3},
    nalgebra::Vector3,
    roles::{LidarOdometryStep, Registration},
    sensors::{PointCloud, VoxelGrid},
    time::Stamp,
};
use agv_nav::pipeline::mapping::{KeyFrameMapper, KeyFrameParams};
use agv_ndt::{
    ndt::{NdtParams, NdtRegistration, VoxelParams},
    places::{ScanContext, ScanContextParams, ScanContexts},
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Places that a query is compared with.
const PLACES: usize = 1000;

/// Clouds of one aisle, half a metre apart.
const CLOUDS: usize = 80;

fn clouds() -> Vec<(Se3, PointCloud)> {
    let factory = Factory::generate(FactoryParams::default(), Seed(1)).expect("defaults are valid");
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::default());
    let mut lidar = Lidar::new(LidarParams::vlp16().with_mount(mount), Seed(1)).expect("valid");
    let mut look = |i: usize| {
        let pose = Se3::from(factory.aisles()[1] * Se2::new(0.5 * i as f64, 0.0, 0.0));
        let cloud =
            lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::from_seconds(i as f64)).expect("finite");
        (pose, cloud.clone())
    };
    (0..CLOUDS).map(&mut look).collect()
}

fn places(c: &mut Criterion) {
    let clouds = clouds();
    let mut group = c.benchmark_group("place_recognition/scan_context");
    let (query, mut context, mut found) = (&clouds[37].1, ScanContext::default(), Vec::new());
    let mut places = ScanContexts::new(ScanContextParams::default()).expect("defaults are valid");
    for i in 0..PLACES {
        // The same places again and again, but for the first time: what is looked for is there once.
        places.describe_into(&clouds[if i < CLOUDS { i } else { 38 + i % 40 }].1, &mut context);
        places.push(&context);
    }
    group.throughput(Throughput::Elements(query.len() as u64));
    group.bench_function("describe", |b| b.iter(|| places.describe_into(black_box(query), &mut context)));
    places.describe_into(query, &mut context);
    places.find_into(&context, |_| true, &mut found);
    assert_eq!((found[0].place, found[0].yaw), (37, 0.0));
    group.throughput(Throughput::Elements(PLACES as u64));
    group.bench_function("find among 1000", |b| {
        b.iter(|| places.find_into(black_box(&context), |_| true, &mut found));
    });
    group.bench_function("compare with 1000", |b| {
        b.iter(|| {
            let nearest = (0..PLACES).map(|place| places.compare(black_box(&context), place));
            nearest.min_by(|a, b| a.distance.total_cmp(&b.distance))
        });
    });
    group.finish();
}

fn maps(c: &mut Criterion) {
    let clouds = clouds();
    let mut mapper = KeyFrameMapper::new(
        NdtRegistration::new(NdtParams::default()).expect("defaults are valid"),
        KeyFrameParams::default(),
    )
    .expect("defaults are valid");
    for (pose, cloud) in &clouds {
        let odom_from_base = clouds[0].0.between(pose);
        mapper.process(&LidarOdometryStep { odom_from_base, alignment: None }, cloud).expect("finite");
    }
    let map = mapper.into_map();
    let keys: Vec<_> = map.key_frames().collect();
    let points: usize = keys.iter().map(|(key, _)| key.cloud().len()).sum();

    let mut group = c.benchmark_group("place_recognition/map");
    group.sample_size(20).throughput(Throughput::Elements(points as u64));
    group.bench_function("assemble tiles", |b| b.iter(|| map.tiles(VoxelParams::default(), 32)));
    group.bench_function("thin out to 0.2 m", |b| b.iter(|| map.thinned_cloud(0.2)));
    let tiles = map.tiles(VoxelParams::default(), 32).expect("defaults are valid");
    group.throughput(Throughput::Elements(tiles.len() as u64));
    group.bench_function("tiles as one map", |b| b.iter(|| black_box(&tiles).assembled()));
    group.finish();

    // As the mapper does: nine clouds around the one that is looked from, and a guess half a metre off.
    let (anchor, mut target, mut moved, mut source) =
        (20, PointCloud::default(), PointCloud::default(), PointCloud::default());
    VoxelGrid::new(0.25).expect("valid").filter_into(keys[anchor + 1].0.cloud(), &mut source);
    let truth = keys[anchor].1.between(keys[anchor + 1].1);
    let guess = truth.compose(&Se2::new(0.4, -0.2, 0.03).into());
    let mut ndt = NdtRegistration::new(NdtParams::default()).expect("defaults are valid");
    let mut check = || {
        target.clear();
        for (key, pose) in &keys[anchor - 4..=anchor + 4] {
            key.cloud().transform_into(&keys[anchor].1.between(pose), &mut moved);
            target.append(&moved).expect("alike");
        }
        ndt.set_target(&target).expect("enough points");
        ndt.align(&source, &guess).expect("a finite guess")
    };
    let found = check();
    assert!(found.converged() && truth.between(&found.target_from_source).translation().norm() < 0.05, "{found:?}");
    let mut group = c.benchmark_group("place_recognition/closure");
    group.sample_size(20).throughput(Throughput::Elements(1));
    group.bench_function("check a find", |b| b.iter(&mut check));
    group.finish();
}

criterion_group!(benches, places, maps);
criterion_main!(benches);
