//! Landmark SLAM by the filter: an update of ten sightings among 50, 200 and 1000 landmarks, by name and by joint compatibility, and a motion.
//!
//! The landmarks stand in a square grid, two metres apart, all in the map; the vehicle is in their middle. Throughput is in entries of the covariance for updates.
//! Before timing: all ten sightings are matched.

use agv_core::{
    geometry::{LieGroup, Se2},
    nalgebra::{Matrix3, Vector2, Vector3},
    odometry::OdometryIncrement,
    time::Stamp,
};
use agv_filters::slam::landmark::{LandmarkReading, LandmarkSighting, LandmarkSlam, LandmarkSlamParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

fn motion(step: Se2) -> OdometryIncrement {
    let (now, spread) = (Stamp::default(), Vector3::new(1e-5, 1e-5, 1e-7));
    OdometryIncrement { start: now, end: now, start_from_end: step, covariance: Matrix3::from_diagonal(&spread) }
}

fn posts(count: usize) -> Vec<Vector2<f64>> {
    let side = (count as f64).sqrt().ceil() as usize;
    let at = |i: usize| 2.0 * i as f64 - side as f64 + 0.3;
    (0..count).map(|k| Vector2::new(at(k % side), at(k / side))).collect()
}

fn sighting(map_from_base: &Se2, id: Option<u32>, post: &Vector2<f64>) -> LandmarkSighting {
    let seen = map_from_base.inverse().act(post);
    let reading = LandmarkReading::range_bearing(seen.norm(), seen.y.atan2(seen.x), [0.02, 0.005]);
    LandmarkSighting::new(id, reading.expect("sound"))
}

/// A filter that has the posts in its map, and the ten nearest as they are seen.
fn mapped(count: usize, named: bool) -> (LandmarkSlam, Vec<LandmarkSighting>) {
    let mut slam = LandmarkSlam::new(LandmarkSlamParams::default()).expect("sound");
    let name = |k: usize| named.then_some(k as u32);
    let mut places: Vec<_> = posts(count).into_iter().enumerate().collect();
    for (k, post) in &places {
        slam.update(&[sighting(&Se2::default(), name(*k), post)]).expect("sound");
    }
    places.sort_by(|a, b| a.1.norm().total_cmp(&b.1.norm()));
    let step = Se2::new(0.1, 0.0, 0.01);
    slam.predict(&motion(step)).expect("sound");
    let seen: Vec<_> = places[..10].iter().map(|(k, post)| sighting(&step, name(*k), post)).collect();
    assert_eq!(slam.landmarks().count(), count);
    assert_eq!(slam.update(&seen).expect("sound").matched, 10);
    (slam, seen)
}

fn landmark_slam(c: &mut Criterion) {
    let mut group = c.benchmark_group("landmark_slam");
    group.sample_size(20);
    for count in [50, 200, 1000] {
        let rows = 4 + 2 * count as u64;
        group.throughput(Throughput::Elements(rows * (rows + 1) / 2));
        for (name, named) in [("update by name", true), ("update by joint compatibility", false)] {
            let (mut slam, seen) = mapped(count, named);
            group.bench_function(format!("{name}/{count}"), |b| b.iter(|| slam.update(&seen)));
        }
    }
    group.throughput(Throughput::Elements(1));
    let (mut slam, _) = mapped(1000, true);
    let still = motion(Se2::default());
    group.bench_function("motion/1000", |b| b.iter(|| slam.predict(&still)));
    group.finish();
}

criterion_group!(benches, landmark_slam);
criterion_main!(benches);
