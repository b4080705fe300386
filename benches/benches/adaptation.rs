//! What an adaptive particle filter does beside moving and weighing: counting bins, deciding how many particles it needs, telling
//! hypotheses apart, and searching elsewhere. On the `depot` map where the shared data is present, else on an office of its size.
//!
//! Particles stand around one pose, 0.2 m and 0.1 rad wide, as in tracking, or anywhere, as after a start without a pose. A search looks
//! at all candidates at once, or, per update, at as many poses as the filter has particles.

use agv_bench::maps;
use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, LikelihoodField, LikelihoodFieldParams, RayCastParams, RayCaster},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_filters::particle::{
    Clusters, FreeSpace, KldParams, KldSampling, LikelihoodFieldModel, LikelihoodFieldModelParams, LikelihoodSearch,
    LikelihoodSearchParams, ParticleSet, PoseBins, PoseHistogram, PoseProposal, ProposalContext, SampleSize,
};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};
use std::hint::black_box;

/// Particles of a filter that tracks, and of one that has just been started.
const SIZES: [usize; 2] = [400, 20_000];

/// A belief by its name: narrow or wide.
fn beliefs(space: &FreeSpace, count: usize) -> [(&'static str, ParticleSet); 2] {
    let mut stream = Seed(5).stream(0, 0);
    let centre = space.sample(&mut stream);
    let mut around = || {
        let noise: Vector3<f64> = Vector3::from_fn(|_, _| StandardNormal.sample(&mut stream));
        centre.plus(&noise.component_mul(&Vector3::new(0.2, 0.2, 0.1)))
    };
    let tracked = (0..count).map(|_| around()).collect();
    let mut stream = Seed(6).stream(0, 0);
    let anywhere = (0..count).map(|index| space.sample_stratum(index, count, &mut stream)).collect();
    [("tracked", tracked), ("anywhere", anywhere)].map(|(name, poses)| (name, ParticleSet::new(poses).expect("poses")))
}

fn free_space(map: &Grid<CellState>) -> FreeSpace {
    FreeSpace::new(map, 0.3).expect("free cells").largest()
}

fn bins(criterion: &mut Criterion) {
    let (_, map) = maps::depot_or_office();
    let space = free_space(&map);
    let mut group = criterion.benchmark_group("adaptation");
    for count in SIZES {
        for (name, set) in beliefs(&space, count) {
            group.throughput(Throughput::Elements(count as u64));
            let mut histogram = PoseHistogram::new(PoseBins::default()).expect("bins").with_capacity(count);
            group.bench_function(BenchmarkId::new(format!("histogram/{name}"), count), |bencher| {
                bencher.iter(|| {
                    histogram.clear();
                    black_box(&set).states().iter().for_each(|pose| _ = histogram.insert(pose, 1.0));
                    histogram.len()
                });
            });
            let mut size = KldSampling::new(KldParams::default()).expect("parameters");
            let needed = size.sample_size(&set, &mut Seed(7).stream(0, 0));
            assert!((400..=20_000).contains(&needed) && (name != "tracked" || needed < 1000), "{needed} particles");
            group.bench_function(BenchmarkId::new(format!("kld/{name}"), count), |bencher| {
                bencher.iter(|| size.sample_size(black_box(&set), &mut Seed(7).stream(0, 0)));
            });
            let mut clusters = Clusters::new(PoseBins::default()).expect("bins").with_capacity(count);
            let particles = clusters.find(&set).expect("finite").iter().map(|part| part.particles).sum::<usize>();
            assert_eq!(particles, count, "the parts are the whole");
            group.bench_function(BenchmarkId::new(format!("clusters/{name}"), count), |bencher| {
                bencher.iter(|| clusters.find(black_box(&set)).map(<[_]>::len));
            });
        }
    }
    group.finish();
}

/// A scan of 360 beams.
fn scan(map: &Grid<CellState>, pose: &Se2) -> LaserScan {
    let geometry = ScanGeometry {
        angle_min: -std::f64::consts::PI,
        angle_increment: 1_f64.to_radians(),
        range_max: 20.0,
        ..Default::default()
    };
    let direction = |i| {
        let (sin, cos) = geometry.angle(i).sin_cos();
        Vector2::new(cos, sin)
    };
    let (directions, mut ranges): (Vec<_>, _) = ((0..360).map(direction).collect(), vec![0.0; 360]);
    let caster = RayCaster::new(map, RayCastParams::default()).expect("a map of ordinary size");
    caster.cast_into(pose, &directions, 20.0, &mut ranges, Par::Seq);
    LaserScan::new(Stamp::default(), geometry, ranges).expect("scan")
}

fn search(criterion: &mut Criterion) {
    let (name, map) = maps::depot_or_office();
    let space = free_space(&map);
    let pose = space.sample(&mut Seed(3).stream(0, 0));
    let scan = scan(&map, &pose);
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).expect("field");
    let mut sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).expect("model");
    let mut search = LikelihoodSearch::new(LikelihoodSearchParams::default()).expect("parameters");
    let context = ProposalContext::new(&space, pose, Par::Seq, Seed(7), 0);
    let mut group = criterion.benchmark_group("search");

    assert!(search.search(&scan, &mut sensor, &context) > 0, "something is found");
    let error = search.found().map(|(found, _)| found.minus(&pose).norm()).fold(f64::INFINITY, f64::min);
    assert!(error < 0.1, "the pose is among what is found, but for {error}");
    group.bench_function(BenchmarkId::new("at once", name), |bencher| {
        bencher.iter(|| search.search(black_box(&scan), &mut sensor, &context));
    });
    for particles in [400, 2000] {
        let (mut poses, mut updates) = (vec![Se2::identity(); particles / 4], 0);
        group.bench_function(BenchmarkId::new(format!("per update/{name}"), particles), |bencher| {
            bencher.iter(|| {
                updates += 1;
                let context = context.after(updates, Se2::identity()).of_particles(particles, true);
                search.propose(black_box(&scan), &mut sensor, &context, &mut poses)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, bins, search);
criterion_main!(benches);
