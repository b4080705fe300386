//! Codes and landmarks: pixels to a pose, patterns to numbers, ranges to a position.

use agv_core::{
    geometry::{LieGroup, Se2, Se3, So3, UncertainPose, UncertainVector},
    nalgebra::{Matrix2, Matrix3, Vector2, Vector3},
    sensors::{CodeSighting, LandmarkObservation, LensDistortion, MarkerObservation, PinholeCamera, PinholeParams},
    time::Stamp,
};
use agv_filters::marker::{
    CodeReader, CodeReaderParams, FloorProjection, KnownLandmark, MarkerFix, MarkerLocalizer, MarkerLocalizerParams,
    MarkerMap, PixelOf, RangeTo, SightedCode, TemplateLibrary, TemplateMatch, TemplateParams, looking_down, nine_codes,
    pose_from_landmarks, resect, trilaterate,
};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::{f64::consts::FRAC_PI_2, hint::black_box};

fn camera(distortion: LensDistortion) -> PinholeCamera {
    PinholeCamera::new(PinholeParams { distortion, ..PinholeParams::default() }).expect("a calibration")
}

fn codes(c: &mut Criterion) {
    let mut group = c.benchmark_group("marker/code_pose");
    group.throughput(Throughput::Elements(1));
    let wide = LensDistortion { radial: [-0.25, 0.06, 0.0], tangential: [3e-4, -1e-4] };
    for (name, lens) in [("pinhole", LensDistortion::default()), ("wide_lens", wide)] {
        let floor = FloorProjection::new(camera(lens), looking_down(Vector2::zeros(), 0.3, 0.0)).expect("a mount");
        let reader = CodeReader::new(floor, CodeReaderParams::default()).expect("the defaults are sound");
        let truth = Se2::new(0.02, 0.03, 0.4);
        let finders = reader.places(&truth).map(|place| floor.to_pixel(&place).expect("in sight"));
        let sighting = CodeSighting { id: Some(7), finders };
        let seen = reader.observe(Stamp::default(), &sighting).expect("a code");
        assert!(seen.base_from_marker().mean().minus(&truth).norm() < 1e-9);
        group.bench_function(name, |b| b.iter(|| reader.observe(Stamp::default(), black_box(&sighting))));
    }
    group.finish();
}

fn fixes(c: &mut Criterion) {
    let mut group = c.benchmark_group("marker/fix");
    let truth = Se2::new(0.4, 0.7, -2.0);
    for count in [1_u32, 4, 9] {
        let marker = |id: u32| (id, Se2::new(0.2 * f64::from(id), 1.0, f64::from(id)));
        let map = MarkerMap::from_exact((0..1000).map(marker)).expect("finite");
        let localizer = MarkerLocalizer::new(map, MarkerLocalizerParams::default()).expect("a gate");
        let seen = |(id, pose): (u32, Se2)| {
            let pose = UncertainPose::new(truth.between(&pose), Matrix3::identity() * 1e-5).expect("a covariance");
            MarkerObservation::new(Stamp::default(), id, pose)
        };
        let image: Vec<_> = (0..count).map(marker).map(seen).collect();
        let fix = localizer.locate(&image).expect("codes");
        assert!(matches!(fix, MarkerFix::Located { used, .. } if used == count as usize));
        group.bench_function(BenchmarkId::new("codes", count), |b| b.iter(|| localizer.locate(black_box(&image))));
    }

    let places = [(4.0, 1.0), (-3.0, 2.0), (0.5, -5.0), (-1.0, 6.0), (7.0, -2.0), (5.0, 5.0)];
    let places = places.map(|(x, y)| Vector2::new(x, y));
    let landmark = |place: &Vector2<f64>| {
        let away = truth.inverse() * *place;
        let reading = Vector2::new(away.norm(), away.y.atan2(away.x));
        let measured = UncertainVector::from_sigmas(reading, &Vector2::new(0.05, 0.01)).expect("a reading");
        let observation = LandmarkObservation::new(Stamp::default(), None, measured).expect("a range");
        KnownLandmark { observation, place: UncertainVector::new(*place, Matrix2::zeros()).expect("finite") }
    };
    let landmarks = places.each_ref().map(landmark);
    for count in [2, 6] {
        let some = &landmarks[..count];
        let fix = pose_from_landmarks(some, 13.8).expect("landmarks");
        assert!(fix.map_from_base.mean().minus(&truth).norm() < 1e-8);
        group.bench_function(BenchmarkId::new("landmarks", count), |b| {
            b.iter(|| pose_from_landmarks(black_box(some), 13.8));
        });
    }
    let range =
        |landmark: Vector2<f64>| RangeTo { landmark, range: (truth.translation() - landmark).norm(), sigma: 0.05 };
    let ranges = places.map(range);
    assert!((trilaterate(&ranges).expect("ranges").position.mean() - truth.translation()).norm() < 1e-8);
    group.bench_function(BenchmarkId::new("ranges", ranges.len()), |b| b.iter(|| trilaterate(black_box(&ranges))));
    group.finish();
}

fn patterns(c: &mut Criterion) {
    let mut group = c.benchmark_group("marker/template");
    let library = TemplateLibrary::new(nine_codes(0, 0.3), TemplateParams::default()).expect("nine codes");
    for count in [3, 5, 9] {
        let place = |id: u32| Se2::new(0.1, -0.2, 1.0).inverse() * library.place(id).expect("a code");
        let sighted: Vec<_> = [0, 4, 7, 2, 6, 1, 3, 5, 8].map(|id| SightedCode { place: place(id), id: None }).into();
        let sighted = &sighted[..count];
        assert!(matches!(library.identify(sighted), TemplateMatch::Identified(found) if found.explained == count));
        group.throughput(Throughput::Elements(count as u64));
        group.bench_function(BenchmarkId::new("unread_codes", count), |b| {
            b.iter(|| library.identify(black_box(sighted)));
        });
    }
    group.finish();
}

fn resection(c: &mut Criterion) {
    let mut group = c.benchmark_group("marker/resection");
    let (camera, truth) = (camera(LensDistortion::default()), Se2::new(3.5, -0.8, 0.4));
    let ahead = So3::from_roll_pitch_yaw(-FRAC_PI_2, 0.0, -FRAC_PI_2);
    let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 0.5), ahead);
    let camera_from_map = (Se3::from(truth) * mount).inverse();
    for tags in [1_i32, 3] {
        let corners = (0..tags).flat_map(|tag| {
            let middle = 0.4 * f64::from(tag) - 0.2;
            [(-0.1, 0.4), (0.1, 0.4), (0.1, 0.6), (-0.1, 0.6)].map(|(y, z)| Vector3::new(5.0, middle + y, z))
        });
        let pixel = |point: Vector3<f64>| camera.project(&camera_from_map.act(&point)).expect("in front");
        let seen: Vec<_> = corners.map(|point| PixelOf { point, pixel: pixel(point) }).collect();
        let found = resect(&camera, &mount, &seen, 0.5).expect("corners");
        assert!(found.map_from_base.mean().minus(&truth).norm() < 1e-6);
        group.bench_function(BenchmarkId::new("tags", tags), |b| {
            b.iter(|| resect(&camera, &mount, black_box(&seen), 0.5));
        });
    }
    group.finish();
}

criterion_group!(benches, codes, fixes, patterns, resection);
criterion_main!(benches);
