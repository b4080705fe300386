//! The models that a particle filter exchanges: what it costs to weigh by each sensor, to move by each vehicle and to resample
//! in each way, on the depot's map (604 x 307 cells) where the shared data is present, else in an office of the same size.
//!
//! Particles stand as in tracking: around the pose that the observations were taken from, 0.2 m and 0.1 rad wide. The
//! likelihood field and the differential drive are there to compare with; `mcl.rs` measures them in the filter.

use agv_bench::maps;
use agv_core::{
    compute::{CHUNK, Par, Seed, Stream},
    geometry::{LieGroup, Se2, UncertainPose, UncertainVector},
    grid::{
        CellState, GaussianGrid, GaussianParams, Grid, LikelihoodField, LikelihoodFieldParams, RayCastParams, RayCaster,
    },
    odometry::OdometryIncrement,
    sensors::{LandmarkObservation, LaserScan, MarkerObservation, ScanGeometry},
    time::Stamp,
};
use agv_filters::particle::{
    AckermannOdometryModel, AckermannOdometryParams, BeamFit, BeamModel, BeamModelParams, BeamSkipping,
    BeamSkippingParams, DifferentialOdometryModel, FreeSpace, LandmarkModel, LandmarkModelParams, LikelihoodFieldModel,
    LikelihoodFieldModelParams, MarkerModel, MarkerModelParams, MotionModel, Multinomial, NdtMapModel,
    NdtMapModelParams, OdometryNoise, OmnidirectionalNoise, OmnidirectionalOdometryModel, PriorMotionModel, PriorNoise,
    Resampler, Residual, Stratified, Systematic, VelocityModel, VelocityNoise, WeighParticles,
};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::hint::black_box;

struct Scene {
    name: &'static str,
    map: Grid<CellState>,
    scan: LaserScan,
    pose: Se2,
}

fn scene() -> Scene {
    let (name, map) = maps::depot_or_office();
    // With room for the particles on all sides.
    let pose = FreeSpace::new(&map, 1.0).expect("free cells").largest().sample(&mut Seed(3).stream(0, 0));
    let caster = RayCaster::new(&map, RayCastParams::default()).expect("map");
    let geometry = ScanGeometry::default();
    let range = |i: usize| {
        let hit = caster.cast(&pose.translation(), pose.yaw() + geometry.angle(i), geometry.range_max);
        hit.map_or(f32::INFINITY, |hit| hit.range as f32)
    };
    let scan = LaserScan::new(Stamp::default(), geometry, (0..1081).map(range).collect()).expect("scan");
    Scene { name, map, scan, pose }
}

fn particles(pose: &Se2, count: usize) -> Vec<Se2> {
    let mut stream = Seed(5).stream(0, 0);
    let sigma = Vector3::new(0.2, 0.2, 0.1);
    let mut draw = || Vector3::from_fn(|_, _| StandardNormal.sample(&mut stream)).component_mul(&sigma);
    (0..count).map(|_| pose.plus(&draw())).collect()
}

/// The likeliest of the particles is near the pose that the observation was taken from, or the bench measures nonsense.
fn check<Z: ?Sized>(model: &mut impl WeighParticles<Z>, observation: &Z, pose: &Se2, poses: &[Se2]) {
    let mut weights = vec![0.0; poses.len()];
    model.weigh(observation, poses, &mut weights, Par::Seq).expect("usable");
    let best = (0..poses.len()).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).expect("some");
    let error = poses[best].minus(pose).norm();
    assert!(error < 0.25, "the likeliest particle is off by {error}");
}

fn scans(criterion: &mut Criterion) {
    let Scene { name, map, scan, pose } = scene();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).expect("field");
    let distributions = GaussianGrid::from_map(&map, 0.5, GaussianParams::default()).expect("map");
    let mut group = criterion.benchmark_group(format!("weigh_by_scan/{name}"));
    for (count, beams) in [(2000, 60), (2000, 180), (10_000, 60)] {
        let poses = particles(&pose, count);
        let params = LikelihoodFieldModelParams { max_beams: beams, ..Default::default() };
        let field = LikelihoodFieldModel::new(&field, params).expect("model");
        let skipping = BeamSkippingParams { converged_within: 10.0, ..Default::default() };
        let skipping = BeamSkipping::new(field.clone(), &map, skipping).expect("model");
        let ndt = NdtMapModelParams { max_beams: beams, ..Default::default() };
        let rays = BeamModelParams { max_beams: beams, ..Default::default() };
        let models: [(&str, Box<dyn WeighParticles<LaserScan>>); 4] = [
            ("likelihood_field", Box::new(field)),
            ("beam_skipping", Box::new(skipping)),
            ("ndt_map", Box::new(NdtMapModel::new(&distributions, ndt).expect("model"))),
            ("beam", Box::new(BeamModel::new(&map, rays).expect("model"))),
        ];
        group.throughput(Throughput::Elements((count * beams) as u64));
        for (name, mut model) in models {
            check(&mut model, &scan, &pose, &poses);
            let mut weights = vec![0.0; count];
            group.sample_size(if name == "beam" { 10 } else { 50 });
            group.bench_function(BenchmarkId::new(name, format!("{count}x{beams}")), |bencher| {
                bencher.iter(|| model.weigh(black_box(&scan), &poses, &mut weights, Par::Seq));
            });
        }
    }
    group.finish();
}

fn landmarks(criterion: &mut Criterion) {
    const READINGS: usize = 8;
    let (pose, count) = (Se2::new(20.0, 10.0, 0.5), 2000);
    let poses = particles(&pose, count);
    let mut stream = Seed(6).stream(0, 0);
    let place = |stream: &mut Stream| Vector2::new(40.0 * stream.random::<f64>(), 20.0 * stream.random::<f64>());
    let map: Vec<(u32, Vector2<f64>)> = (0..200).map(|id| (id, place(&mut stream))).collect();
    let read = |named: bool| -> Vec<LandmarkObservation> {
        map.iter()
            .take(READINGS)
            .map(|(id, place)| {
                let towards = pose.inverse().act(place);
                let reading = Vector2::new(towards.norm(), towards.y.atan2(towards.x));
                let reading = UncertainVector::from_sigmas(reading, &Vector2::new(0.05, 0.01)).expect("finite");
                LandmarkObservation::new(Stamp::default(), named.then_some(*id), reading).expect("a range")
            })
            .collect()
    };
    let mut group = criterion.benchmark_group("weigh_by_readings");
    let mut weights = vec![0.0; count];
    group.throughput(Throughput::Elements((count * READINGS) as u64));
    for (name, named) in [("landmarks_known", true), ("landmarks_unknown_of_200", false)] {
        let mut model = LandmarkModel::new(map.iter().copied(), LandmarkModelParams::default()).expect("model");
        let seen = read(named);
        check(&mut model, seen.as_slice(), &pose, &poses);
        group.bench_function(BenchmarkId::new(name, count), |bencher| {
            bencher.iter(|| model.weigh(black_box(seen.as_slice()), &poses, &mut weights, Par::Seq));
        });
    }
    let code = Se2::new(20.2, 10.1, 1.0);
    let mut model = MarkerModel::new([(7, UncertainPose::exact(code))], MarkerModelParams::default()).expect("model");
    let seen = MarkerObservation::new(Stamp::default(), 7, UncertainPose::exact(pose.between(&code)));
    check(&mut model, &seen, &pose, &poses);
    group.throughput(Throughput::Elements(count as u64));
    group.bench_function(BenchmarkId::new("marker", count), |bencher| {
        bencher.iter(|| model.weigh(black_box(&seen), &poses, &mut weights, Par::Seq));
    });
    group.finish();
}

fn motions(criterion: &mut Criterion) {
    fn propagate(model: &impl MotionModel<Motion = OdometryIncrement>, motion: &OdometryIncrement, poses: &mut [Se2]) {
        let sample = model.condition(motion);
        for (index, chunk) in poses.chunks_mut(CHUNK).enumerate() {
            let mut stream = Seed(7).stream(0, index as u64);
            for pose in chunk {
                *pose = sample(pose, &mut stream);
            }
        }
    }
    let count = 10_000;
    let mut poses = particles(&Se2::default(), count);
    let (now, end) = (Stamp::default(), Se2::new(0.2, 0.005, 0.05));
    let motion = OdometryIncrement::between(now, &Se2::identity(), now, &end).expect("finite");
    let motion = OdometryIncrement { covariance: Matrix3::identity() * 1e-4, ..motion };
    let mut group = criterion.benchmark_group("propagate");
    group.throughput(Throughput::Elements(count as u64));
    macro_rules! bench {
        ($name:literal, $model:expr) => {
            let model = $model.expect("noise");
            group.bench_function(BenchmarkId::new($name, count), |bencher| {
                bencher.iter(|| propagate(&model, black_box(&motion), &mut poses));
            });
        };
    }
    bench!("differential", DifferentialOdometryModel::new(OdometryNoise::default()));
    bench!("omnidirectional", OmnidirectionalOdometryModel::new(OmnidirectionalNoise::default()));
    bench!("ackermann", AckermannOdometryModel::new(AckermannOdometryParams::default()));
    bench!("velocity", VelocityModel::new(VelocityNoise::default()));
    bench!("prior", PriorMotionModel::new(PriorNoise::default()));
    group.finish();
}

fn resamplers(criterion: &mut Criterion) {
    let count = 10_000;
    let mut stream = Seed(8).stream(0, 0);
    let weights: Vec<f64> = (0..count).map(|_| stream.random::<f64>().powi(4) / f64::from(count)).collect();
    let mut ancestors = vec![0; weights.len()];
    let mut group = criterion.benchmark_group("resample");
    group.throughput(Throughput::Elements(weights.len() as u64));
    let resamplers: [(&str, Box<dyn Resampler>); 4] = [
        ("systematic", Box::new(Systematic)),
        ("stratified", Box::new(Stratified)),
        ("residual", Box::new(Residual)),
        ("multinomial", Box::new(Multinomial)),
    ];
    for (name, resampler) in resamplers {
        group.bench_function(BenchmarkId::new(name, count), |bencher| {
            bencher.iter(|| resampler.resample(black_box(&weights), &mut stream, &mut ancestors));
        });
    }
    group.finish();
}

fn fit(criterion: &mut Criterion) {
    let Scene { name, map, scan, pose } = scene();
    let mut model = BeamModel::new(&map, BeamModelParams::default()).expect("model");
    let mut samples = Vec::new();
    (0..10).for_each(|_| model.samples_into(&scan, &pose, &mut samples));
    let mut group = criterion.benchmark_group(format!("beam_fit/{name}"));
    group.throughput(Throughput::Elements(samples.len() as u64)).sample_size(10);
    group.bench_function(BenchmarkId::new("ten_rounds", samples.len()), |bencher| {
        bencher.iter(|| BeamFit::new(&BeamModelParams::default(), black_box(&samples), 10));
    });
    group.finish();
}

criterion_group!(benches, scans, landmarks, motions, resamplers, fit);
criterion_main!(benches);
