//! Monte Carlo localisation: the full update and its parts, on the Intel map (665 x 662 cells) where the shared data is
//! present, else on a synthetic map of the same size.
//!
//! Particles stand as in tracking: around the pose that the scan was taken from, 0.2 m and 0.1 rad wide. A full update is
//! a prediction of 0.2 m, the weighing, the moments, and resampling when the effective sample size asks for it.

use agv_core::{
    compute::{CHUNK, Par, Seed},
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_filters::particle::{
    DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
    MotionModel, OdometryNoise, ParticleSet, Resampler, Systematic, WeighParticles,
};
use agv_support::{
    log::{ScanLog, csv},
    map,
};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Matrix3, Vector3};
use std::{hint::black_box, time::Instant};

struct Scene {
    map: Grid<CellState>,
    scan: LaserScan,
    pose: Se2,
}

fn scene() -> Scene {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/localization");
    if let Ok(map) = map::read(folder.join("intel_map.yaml")) {
        let row = 6000;
        let scan = ScanLog::read(folder.join("intel_scans.csv.gz")).expect("log").entries[row].scan.clone();
        let pose = csv::read_reference(folder.join("intel_reference.csv.gz")).expect("reference")[row].pose;
        return Scene { map, scan, pose };
    }
    // Rooms of 3 m, walls of one cell, seen from the middle of one.
    let layout = GridLayout::new(665, 662, 0.05, Se2::new(-12.5, -25.15, 0.0)).expect("layout");
    let is_wall = |index: usize| (index % 665).is_multiple_of(60) || (index / 665).is_multiple_of(60);
    let states = (0..layout.len()).map(|i| if is_wall(i) { CellState::Occupied } else { CellState::Free }).collect();
    let map = Grid::new(layout, states).expect("map");
    let geometry = ScanGeometry {
        angle_min: -90_f64.to_radians(),
        angle_increment: 1_f64.to_radians(),
        range_max: 81.0,
        ..Default::default()
    };
    let range = |i: usize| {
        let (sin, cos) = geometry.angle(i).sin_cos();
        (1.5 / cos.abs().max(sin.abs())) as f32
    };
    let scan = LaserScan::new(Stamp::default(), geometry, (0..180).map(range).collect()).expect("scan");
    Scene { map, scan, pose: Se2::new(-12.5 + 3.0 * 3.0 + 1.5, -25.15 + 3.0 * 4.0 + 1.5, 0.0) }
}

fn sensor(scene: &Scene, max_beams: usize) -> LikelihoodFieldModel {
    let field = LikelihoodField::new(&scene.map, LikelihoodFieldParams::default()).expect("field");
    LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams { max_beams, ..Default::default() }).expect("model")
}

fn covariance() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.01))
}

fn filter(
    scene: &Scene,
    particles: usize,
    beams: usize,
    par: Par,
) -> Mcl<DifferentialOdometryModel, LikelihoodFieldModel> {
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).expect("noise");
    let params = MclParams { particles, ..Default::default() };
    let free_space = FreeSpace::new(&scene.map, 0.2).expect("free cells");
    let filter = Mcl::new(motion, sensor(scene, beams), free_space, params, Seed(7)).expect("parameters");
    let mut filter = filter.with_parallelism(par);
    filter.initialize(&PoseBelief::around(scene.pose, covariance()).expect("covariance")).expect("belief");
    filter
}

fn step(run: f64) -> OdometryIncrement {
    let end = Se2::new(run, 0.0, 0.01 * run.signum());
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &end).expect("finite")
}

fn full_update(criterion: &mut Criterion) {
    let scene = scene();
    let pool = rayon_pool();
    let mut group = criterion.benchmark_group("mcl_update");
    for (particles, beams) in [(500, 60), (2000, 60), (10_000, 60), (2000, 180), (10_000, 180), (50_000, 180)] {
        group.throughput(Throughput::Elements((particles * beams) as u64));
        for threads in [1, 2] {
            let mut filter = filter(&scene, particles, beams, Par::threads(threads));
            // Forth and back, so that the scan stays the right one.
            let steps = [step(0.21), step(-0.21)];
            let mut turn = 0;
            let mut cycle = || {
                filter.predict(&steps[turn]).expect("initialised");
                turn = 1 - turn;
                filter.update(&scene.scan).expect("initialised")
            };
            cycle();
            let id = BenchmarkId::new(format!("{particles}x{beams}"), threads);
            group.bench_function(id, |bencher| {
                bencher.iter_custom(|iterations| {
                    pool.install(|| {
                        let start = Instant::now();
                        for _ in 0..iterations {
                            black_box(cycle());
                        }
                        start.elapsed()
                    })
                });
            });
            let error = filter.estimate().expect("initialised").map_from_base().minus(&scene.pose).norm();
            assert!(error < 0.6, "the filter is lost by {error}");
        }
    }
    group.finish();
}

/// Two threads, so that parallel updates do not pay for entering a pool.
fn rayon_pool() -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("threads")
}

fn parts(criterion: &mut Criterion) {
    let scene = scene();
    let mut group = criterion.benchmark_group("mcl_parts");
    for particles in [2000_usize, 10_000] {
        let poses = filter(&scene, particles, 60, Par::Seq).particles().states().to_vec();
        let mut log_likelihoods = vec![0.0; particles];
        for beams in [60, 180] {
            let mut model = sensor(&scene, beams);
            group.throughput(Throughput::Elements((particles * beams) as u64));
            group.bench_function(BenchmarkId::new("weigh", format!("{particles}x{beams}")), |bencher| {
                bencher.iter(|| model.weigh(&scene.scan, black_box(&poses), &mut log_likelihoods, Par::Seq));
            });
        }

        group.throughput(Throughput::Elements(particles as u64));
        let model = DifferentialOdometryModel::new(OdometryNoise::default()).expect("noise");
        let mut moved = poses.clone();
        let motion = step(0.21);
        group.bench_function(BenchmarkId::new("propagate", particles), |bencher| {
            bencher.iter(|| {
                let sample = model.condition(black_box(&motion));
                for (index, chunk) in moved.chunks_mut(CHUNK).enumerate() {
                    let mut stream = Seed(7).stream(0, index as u64);
                    for pose in chunk {
                        *pose = sample(pose, &mut stream);
                    }
                }
            });
        });

        let mut set = ParticleSet::new(poses.clone()).expect("poses");
        let uneven: Vec<f64> =
            (0..particles).map(|i| -((i * 7919 % particles) as f64) * 10.0 / particles as f64).collect();
        group.bench_function(BenchmarkId::new("reweigh", particles), |bencher| {
            bencher.iter(|| {
                set.equalize();
                set.reweigh(black_box(&uneven), Par::Seq)
            });
        });
        group.bench_function(BenchmarkId::new("estimate", particles), |bencher| {
            bencher.iter(|| black_box(&set).estimate(Par::Seq));
        });
        let (weights, mut ancestors) = (set.weights().to_vec(), vec![0; particles]);
        group.bench_function(BenchmarkId::new("systematic", particles), |bencher| {
            bencher.iter(|| Systematic.resample(black_box(&weights), &mut Seed(7).stream(0, 0), &mut ancestors));
        });
        group.bench_function(BenchmarkId::new("resample_set", particles), |bencher| {
            bencher.iter(|| set.resample(particles, &Systematic, &mut Seed(7).stream(0, 0), Par::Seq).len());
        });
    }
    group.finish();
}

fn field(criterion: &mut Criterion) {
    let scene = scene();
    let mut group = criterion.benchmark_group("likelihood_field");
    group.throughput(Throughput::Elements(scene.map.layout().len() as u64));
    group.sample_size(20);
    group.bench_function("build", |bencher| {
        bencher.iter(|| LikelihoodField::new(black_box(&scene.map), LikelihoodFieldParams::default()));
    });
    let built = LikelihoodField::new(&scene.map, LikelihoodFieldParams::default()).expect("field");
    group.bench_function("model", |bencher| {
        bencher.iter(|| LikelihoodFieldModel::new(black_box(&built), LikelihoodFieldModelParams::default()));
    });
    group.finish();
}

criterion_group!(benches, field, parts, full_update);
criterion_main!(benches);
