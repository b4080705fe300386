//! Monte Carlo localisation: the full update and its parts, on the Intel map (665 x 662 cells) where the shared data is
//! present, else on a synthetic map of the same size.
//!
//! Particles stand as in tracking: around the pose that the scan was taken from, 0.2 m and 0.1 rad wide. A full update is
//! a prediction of 0.2 m, the weighing, the moments, and resampling when the effective sample size asks for it. `mcl_tail`
//! prints how far the slowest updates are from the median. In `mcl_global` the particles stand anywhere on the map.

use agv_bench::maps;
use agv_core::{
    compute::{CHUNK, Par, Seed},
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams, RayCastParams, RayCaster},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
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
use std::{
    hint::black_box,
    time::{Duration, Instant},
};

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

/// Particles and beams, as Beluga, Nav2 and MRPT were measured.
const SIZES: [(usize, usize); 7] =
    [(500, 60), (2000, 60), (10_000, 60), (50_000, 60), (2000, 180), (10_000, 180), (50_000, 180)];

/// A prediction and an update, forth and back, so that the scan stays the right one.
fn cycle<'a>(
    filter: &'a mut Mcl<DifferentialOdometryModel, LikelihoodFieldModel>,
    scan: &'a LaserScan,
) -> impl FnMut() -> UpdateOutcome + 'a {
    let steps = [step(0.21), step(-0.21)];
    let mut turn = 0;
    move || {
        filter.predict(&steps[turn]).expect("initialised");
        turn = 1 - turn;
        filter.update(scan).expect("initialised")
    }
}

fn full_update(criterion: &mut Criterion) {
    let scene = scene();
    let pool = rayon_pool();
    let mut group = criterion.benchmark_group("mcl_update");
    for (particles, beams) in SIZES {
        group.throughput(Throughput::Elements((particles * beams) as u64));
        for threads in [1, 2] {
            let mut filter = filter(&scene, particles, beams, Par::threads(threads));
            let mut cycle = cycle(&mut filter, &scene.scan);
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
            drop(cycle);
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
                for (index, (moved, poses)) in moved.chunks_mut(CHUNK).zip(poses.chunks(CHUNK)).enumerate() {
                    model.propagate(black_box(&motion), poses, moved, &mut Seed(7).stream(0, index as u64));
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

/// Median and 99th percentile of single updates: a figure of its own, which criterion does not give.
fn tail(_: &mut Criterion) {
    let scene = scene();
    for (particles, beams) in [(2000, 60), (2000, 180), (10_000, 180)] {
        let mut filter = filter(&scene, particles, beams, Par::Seq);
        let mut cycle = cycle(&mut filter, &scene.scan);
        let mut times: Vec<Duration> = (0..2000)
            .map(|_| {
                let start = Instant::now();
                black_box(cycle());
                start.elapsed()
            })
            .collect();
        times.sort_unstable();
        let (median, p99) =
            (times[times.len() / 2].as_secs_f64() * 1e3, times[times.len() * 99 / 100].as_secs_f64() * 1e3);
        println!("mcl_tail/{particles}x{beams}: median {median:.4} ms, p99 {p99:.4} ms, ratio {:.2}", p99 / median);
    }
}

/// The first update of particles that stand anywhere.
fn global(criterion: &mut Criterion) {
    const PARTICLES: usize = 100_000;
    let mut group = criterion.benchmark_group("mcl_global");
    group.throughput(Throughput::Elements(PARTICLES as u64 * 60));
    group.sample_size(10);
    for (name, map) in [maps::depot_or_office(), maps::warehouse_or_office()] {
        let free_space = FreeSpace::new(&map, 0.3).expect("free cells").largest();
        let pose = free_space.sample(&mut Seed(3).stream(0, 0));
        let geometry = ScanGeometry {
            angle_min: -std::f64::consts::PI,
            angle_increment: 1_f64.to_radians(),
            range_max: 20.0,
            ..Default::default()
        };
        let directions: Vec<_> =
            (0..360).map(|i| geometry.angle(i).sin_cos()).map(|(sin, cos)| nalgebra::Vector2::new(cos, sin)).collect();
        let mut ranges = vec![0.0; 360];
        let caster = RayCaster::new(&map, RayCastParams::default()).expect("a map of ordinary size");
        caster.cast_into(&pose, &directions, 20.0, &mut ranges, Par::Seq);
        let scan = LaserScan::new(Stamp::default(), geometry, ranges).expect("scan");

        let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).expect("field");
        let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).expect("model");
        let motion = DifferentialOdometryModel::new(OdometryNoise::default()).expect("noise");
        let params = MclParams { particles: PARTICLES, ..Default::default() };
        let mut filter = Mcl::new(motion, sensor, free_space, params, Seed(7)).expect("parameters");
        group.bench_function(BenchmarkId::new("100000x60", name), |bencher| {
            bencher.iter_custom(|iterations| {
                let mut elapsed = Duration::ZERO;
                for _ in 0..iterations {
                    filter.initialize(&PoseBelief::Anywhere).expect("free space");
                    filter.predict(&step(0.21)).expect("initialised");
                    let start = Instant::now();
                    black_box(filter.update(&scan).expect("initialised"));
                    elapsed += start.elapsed();
                }
                elapsed
            });
        });
        assert!(filter.diagnostics().weights.effective_sample_size < 0.5 * PARTICLES as f64, "the scan says something");
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
    // A site of 200 by 600 m: racks every 10 m, with aisles.
    let layout = GridLayout::new(4000, 12_000, 0.05, Se2::identity()).expect("layout");
    let is_rack =
        |(x, y): (usize, usize)| (x.is_multiple_of(200) && y % 60 > 10) || (y.is_multiple_of(400) && x % 90 > 20);
    let state = |i: usize| if is_rack((i % 4000, i / 4000)) { CellState::Occupied } else { CellState::Free };
    let site = Grid::new(layout, (0..layout.len()).map(state).collect()).expect("map");
    group.throughput(Throughput::Elements(layout.len() as u64));
    group.sample_size(10);
    group.bench_function("build 4000x12000", |bencher| {
        bencher.iter(|| LikelihoodField::new(black_box(&site), LikelihoodFieldParams::default()));
    });
    group.finish();
}

criterion_group!(benches, field, parts, full_update, tail, global);
criterion_main!(benches);
