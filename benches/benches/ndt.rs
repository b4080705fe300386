//! Registration of clouds: two revolutions of a simulated 32-line lidar in a factory, and recorded pairs where the data folder is.
//!
//! Sources have a point per 0.25 m, targets one per 0.1 m (normal distributions) or 0.25 m (closest points); the search starts at the
//! identity. Throughput is in points of the source, for building in points of the target.

use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se3},
    roles::Registration,
    sensors::{PointCloud, VoxelGrid},
};
use agv_ndt::{
    gicp::{PointMetric, PointParams, PointRegistration},
    ndt::{NdtParams, NdtRegistration, VoxelSearch},
    registration::Optimizer,
};
use agv_sim::{CloudPair, LidarParams};
use agv_support::{cloud, pairs};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::{hint::black_box, path::Path};

struct Pair {
    name: String,
    target: PointCloud,
    source: PointCloud,
    target_from_source: Se3,
}

fn thinned(cloud: &PointCloud, leaf: f32) -> PointCloud {
    let mut out = PointCloud::default();
    VoxelGrid::new(leaf).expect("a valid leaf").filter_into(cloud, &mut out);
    out
}

fn simulated() -> Pair {
    let CloudPair { target, source, target_from_source } =
        CloudPair::in_factory(LidarParams::hdl32(), Seed(1)).expect("defaults are valid");
    Pair { name: "factory".into(), target, source, target_from_source }
}

/// The recorded pairs that are there.
fn recorded() -> Vec<Pair> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/registration3d");
    let Ok(pairs) = pairs::read(folder.join("pair_references.csv")) else { return Vec::new() };
    [("hdl32", "xyz.f32"), ("os0_30_31", "xyz.i16mm2"), ("kitti00_0_1", "xyzi.f32")]
        .into_iter()
        .filter_map(|(name, suffix)| {
            let pair = pairs.iter().find(|pair| pair.name == name && pair.kind == "consensus")?;
            let read = |stem: &str| cloud::read(folder.join(format!("{stem}.{suffix}"))).ok();
            Some(Pair {
                name: name.into(),
                target: read(&pair.target)?,
                source: read(&pair.source)?,
                target_from_source: pair.target_from_source,
            })
        })
        .collect()
}

/// A method: its name, the leaf of its target, and itself.
type Method = (&'static str, f32, Box<dyn Registration + Send>);

fn methods() -> Vec<Method> {
    let ndt = |params: NdtParams, threads: usize| -> Box<dyn Registration + Send> {
        Box::new(NdtRegistration::new(params).expect("valid").with_parallelism(Par::threads(threads)))
    };
    let points = |metric| -> Box<dyn Registration + Send> {
        let params = PointParams { metric, ..PointParams::default() };
        Box::new(PointRegistration::new(params).expect("valid"))
    };
    let good = NdtParams::default();
    vec![
        ("ndt", 0.1, ndt(good, 1)),
        ("ndt, 2 threads", 0.1, ndt(good, 2)),
        ("ndt, 1 voxel", 0.1, ndt(NdtParams { search: VoxelSearch::Direct1, ..good }, 1)),
        ("ndt, line search", 0.1, ndt(NdtParams { optimizer: Optimizer::LineSearch, ..good }, 1)),
        ("point to plane", 0.25, points(PointMetric::PointToPlane)),
        ("generalized", 0.25, points(PointMetric::Generalized)),
        ("voxelized", 0.25, points(PointMetric::Voxelized)),
    ]
}

fn registration(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("threads");
    for pair in std::iter::once(simulated()).chain(recorded()) {
        let source = thinned(&pair.source, 0.25);
        for (name, leaf, mut method) in methods() {
            let target = thinned(&pair.target, leaf);
            method.set_target(&target).expect("enough points");
            // The others build the same.
            if ["ndt", "generalized", "voxelized"].contains(&name) {
                let mut group = c.benchmark_group(format!("ndt/build, {}", pair.name));
                group.throughput(Throughput::Elements(target.len() as u64)).sample_size(20);
                group
                    .bench_function(name, |b| b.iter(|| method.set_target(black_box(&target)).expect("enough points")));
                group.finish();
            }
            // The recorded references are good to about a centimetre.
            let found = method.align(&source, &Se3::identity()).expect("a valid guess");
            let error = pair.target_from_source.between(&found.target_from_source);
            assert!(error.translation().norm() < 0.1, "{} {name}: {found:?}", pair.name);
            let mut group = c.benchmark_group(format!("ndt/align, {}", pair.name));
            group.throughput(Throughput::Elements(source.len() as u64)).sample_size(20);
            // A pool entered once: a call from outside of any wakes a thread up for each loop.
            group.bench_function(name, |b| {
                b.iter_custom(|times| {
                    pool.install(|| {
                        let start = std::time::Instant::now();
                        for _ in 0..times {
                            black_box(method.align(black_box(&source), &Se3::identity())).expect("a valid guess");
                        }
                        start.elapsed()
                    })
                });
            });
            group.finish();
        }
    }
}

criterion_group!(benches, registration);
criterion_main!(benches);
