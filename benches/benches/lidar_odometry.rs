//! Lidar odometry: a simulated drive through a factory with 16 and 64 lines, and recorded clouds where the data folder is.
//!
//! The odometry has seen the first clouds; the next ten are timed. Throughput is in clouds.

use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se3, So3, Twist2},
    nalgebra::Vector3,
    roles::LidarOdometry,
    sensors::PointCloud,
};
use agv_ndt::{
    gicp::{PointParams, PointRegistration},
    loam::{FeatureExtractor, FeatureParams, Features, LoamOdometry, LoamParams},
    ndt::{NdtParams, NdtRegistration},
    odometry::{Follow, FollowParams},
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams, Simulator3d, Vehicle, VehicleParams};
use agv_support::cloud;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::{hint::black_box, path::Path, time::Instant};

/// Clouds that are timed; those before them warm the odometry up.
const TIMED: usize = 10;

struct Drive {
    name: String,
    clouds: Vec<PointCloud>,
    /// Pose of the base at the last cloud in its frame at the first, where it is known.
    end: Option<Se3>,
}

fn simulated(name: &str, lidar: LidarParams) -> Drive {
    let factory = Factory::generate(FactoryParams::default(), Seed(1)).expect("defaults are valid");
    let vehicle = Vehicle::new(VehicleParams::default(), factory.aisles()[1], Seed(1)).expect("defaults are valid");
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::default());
    let lidar = Lidar::new(lidar.with_mount(mount), Seed(1)).expect("valid");
    let mut simulator =
        Simulator3d::new(factory.world(), vehicle, 0.02).and_then(|s| s.with_lidar(lidar)).expect("valid");
    let (mut clouds, mut poses) = (Vec::new(), Vec::new());
    while clouds.len() < 30 + TIMED {
        for (cloud, truth) in simulator.step(&Twist2::new(2.0, 0.0, 0.05)).expect("a valid command").clouds() {
            clouds.push(cloud.clone());
            poses.push(truth.map_from_base);
        }
    }
    Drive { name: name.into(), clouds, end: Some(poses[0].between(&poses[poses.len() - 1])) }
}

/// Consecutive clouds of a handheld 64-line lidar, without lines, if they are there.
fn recorded() -> Option<Drive> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/registration3d");
    let read = |i: u32| cloud::read(folder.join(format!("os0_{i:03}.xyz.i16mm2"))).ok();
    Some(Drive { name: "os0".into(), clouds: (97..=128).map(read).collect::<Option<_>>()?, end: None })
}

type Method = (&'static str, Box<dyn Fn() -> Box<dyn LidarOdometry> + Sync>);

fn methods() -> Vec<Method> {
    let loam = |threads: usize| -> Box<dyn LidarOdometry> {
        let loam = LoamOdometry::new(LoamParams::default()).expect("defaults are valid");
        Box::new(loam.with_parallelism(Par::threads(threads)))
    };
    let ndt = || -> Box<dyn LidarOdometry> {
        let params = FollowParams::for_distributions();
        Box::new(Follow::new(NdtRegistration::new(NdtParams::default()).expect("valid"), params).expect("valid"))
    };
    let gicp = || -> Box<dyn LidarOdometry> {
        let generalized = PointRegistration::new(PointParams::default()).expect("valid");
        Box::new(Follow::new(generalized, FollowParams::default()).expect("valid"))
    };
    vec![
        ("loam", Box::new(move || loam(1))),
        ("loam, 2 threads", Box::new(move || loam(2))),
        ("ndt", Box::new(ndt)),
        ("generalized", Box::new(gicp)),
    ]
}

fn odometry(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("threads");
    let simulated = [simulated("16 lines", LidarParams::vlp16()), simulated("64 lines", LidarParams::uniform64())];
    for drive in simulated.into_iter().chain(recorded()) {
        let mut group = c.benchmark_group(format!("lidar_odometry/{}", drive.name));
        group.throughput(Throughput::Elements(TIMED as u64)).sample_size(10);
        let (before, timed) = drive.clouds.split_at(drive.clouds.len() - TIMED);
        for (name, build) in methods() {
            let run = |clouds: &[PointCloud], method: &mut dyn LidarOdometry| {
                let steps = clouds.iter().map(|cloud| method.process(black_box(cloud), None).expect("no prior"));
                steps.last().map(|step| step.odom_from_base)
            };
            if let Some(end) = drive.end {
                let found = run(&drive.clouds, build().as_mut()).expect("clouds");
                let error = end.between(&found).translation().norm();
                assert!(error < 0.3, "{} {name}: {error} m", drive.name);
            }
            // A pool entered once: a call from outside of any wakes a thread up for each loop.
            group.bench_function(name, |b| {
                let once = || {
                    let mut method = build();
                    run(before, method.as_mut());
                    let start = Instant::now();
                    black_box(run(timed, method.as_mut()));
                    start.elapsed()
                };
                b.iter_custom(|times| pool.install(|| (0..times).map(|_| once()).sum()));
            });
        }
        group.finish();
        let mut group = c.benchmark_group(format!("lidar_odometry/features, {}", drive.name));
        group.throughput(Throughput::Elements(timed[0].len() as u64)).sample_size(20);
        let mut extractor = FeatureExtractor::new(FeatureParams::default()).expect("defaults are valid");
        let mut features = Features::default();
        group.bench_function("extract", |b| {
            b.iter(|| extractor.extract_into(black_box(&timed[0]), Par::Seq, &mut features).expect("small enough"));
        });
        group.finish();
    }
}

criterion_group!(benches, odometry);
criterion_main!(benches);
