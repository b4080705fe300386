//! Behaviour on small simulated worlds: consistency, association, ranges alone, and what is refused.
#![expect(clippy::disallowed_types, reason = "the dense reference")]

use super::*;
use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, UncertainVector},
    metrics::chi_square_quantile,
    odometry::OdometryIncrement,
    time::Stamp,
};
use nalgebra::{DMatrix, Matrix2, Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};

const SIGMAS: [f64; 2] = [0.05, 0.01];
const STEP: [f64; 3] = [0.02, 0.01, 0.005];

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}

fn motion(start_from_end: Se2, covariance: Matrix3<f64>) -> OdometryIncrement {
    let now = Stamp::default();
    OdometryIncrement { start: now, end: now, start_from_end, covariance }
}

/// On two rings around a circle of six metres.
fn posts() -> Vec<Vector2<f64>> {
    let ring = |k: u32| {
        let (angle, radius) = (f64::from(k) * 0.7, if k.is_multiple_of(2) { 9.0 } else { 3.5 });
        Vector2::new(radius * angle.cos(), 6.0 + radius * angle.sin())
    };
    (0..9).map(ring).collect()
}

/// A vehicle on a circle of six metres, and what it measures.
struct World {
    stream: Stream,
    truth: Se2,
    posts: Vec<Vector2<f64>>,
}

impl World {
    fn new(seed: u64) -> Self {
        Self { stream: Seed(seed).stream(0, 0), truth: Se2::default(), posts: posts() }
    }

    fn drive(&mut self) -> OdometryIncrement {
        let step = Se2::exp(&Vector3::new(0.5, 0.0, 0.5 / 6.0));
        self.truth = self.truth * step;
        let noise = Vector3::from(STEP.map(|sigma| sigma * normal(&mut self.stream)));
        let covariance = Matrix3::from_diagonal(&STEP.map(|sigma| sigma * sigma).into());
        // The truth is off the odometry by a right increment.
        motion(step.plus(&noise), covariance)
    }

    fn look(&mut self, named: bool) -> Vec<LandmarkSighting> {
        let mut seen = Vec::new();
        for (id, post) in (0..).zip(&self.posts) {
            let q = self.truth.inverse().act(post);
            if q.norm() < 8.0 {
                let range = q.norm() + SIGMAS[0] * normal(&mut self.stream);
                let bearing = q.y.atan2(q.x) + SIGMAS[1] * normal(&mut self.stream);
                let reading = LandmarkReading::range_bearing(range, bearing, SIGMAS).unwrap();
                seen.push(LandmarkSighting::new(named.then_some(id), reading));
            }
        }
        seen
    }
}

fn nees(slam: &LandmarkSlam, truth: &Se2) -> f64 {
    let estimate = slam.estimate().unwrap();
    let error = truth.minus(estimate.mean());
    error.dot(&estimate.covariance().cholesky().unwrap().solve(&error))
}

/// Mean normalised square of the pose's error at the end of three rounds, over drives of different seeds.
fn mean_nees(errors: SlamErrors, drives: u64) -> f64 {
    let one = |seed| {
        let mut world = World::new(seed);
        let mut slam = LandmarkSlam::new(LandmarkSlamParams { errors, ..Default::default() }).unwrap();
        for _ in 0..3 * 75 {
            slam.predict(&world.drive()).unwrap();
            slam.update(&world.look(true)).unwrap();
        }
        nees(&slam, &world.truth)
    };
    (0..drives).map(one).sum::<f64>() / drives as f64
}

/// Within the bounds of 99.9 % of a chi-square with three degrees of freedom a drive, and a tenth for linearisation.
#[test]
fn the_filter_is_as_sure_as_it_may_be() {
    let drives = 60;
    let bound = |p| chi_square_quantile(3.0 * drives as f64, p).unwrap() / drives as f64;
    let mean = mean_nees(SlamErrors::Invariant, drives);
    assert!(mean > bound(0.0005) && mean < 1.1 * bound(0.9995), "{mean}");
}

#[test]
fn landmarks_without_names_are_told_apart() {
    for association in [Association::Nearest, Association::Joint] {
        let mut world = World::new(5);
        let mut slam = LandmarkSlam::new(LandmarkSlamParams { association, ..Default::default() }).unwrap();
        for _ in 0..2 * 75 {
            slam.update(&world.look(false)).unwrap();
            slam.predict(&world.drive()).unwrap();
        }
        let found: Vec<_> = slam.landmarks().collect();
        assert_eq!(found.len(), 9, "{association:?}");
        for landmark in found {
            let nearest = world.posts.iter().map(|post| (post - landmark.place.mean()).norm()).fold(9.0, f64::min);
            assert!(nearest < 0.4 && landmark.confirmed, "{association:?} {nearest}");
        }
    }
}

/// Two posts a metre apart, and an estimate that is a metre off: one by one, the first sighting fits the wrong post better. Together they fit only as they are.
#[test]
fn joint_compatibility_sees_what_single_pairs_do_not() {
    let found = |association| {
        let params = LandmarkSlamParams { association, gate_probability: 0.999, ..Default::default() };
        let mut slam = LandmarkSlam::new(params).unwrap();
        let see = |places: &[[f64; 2]]| -> Vec<_> {
            let sighting = |place: &[f64; 2]| {
                let place = UncertainVector::new(Vector2::from(*place), Matrix2::identity() * 1e-3).unwrap();
                LandmarkSighting::new(None, LandmarkReading::Place(place))
            };
            places.iter().map(sighting).collect()
        };
        slam.update(&see(&[[5.0, 0.0], [5.0, 1.0], [8.0, 0.5]])).unwrap();
        // Nobody knows where to, by half a metre; in truth 0.9 m to the right.
        let anywhere = Matrix3::from_diagonal(&Vector3::new(0.25, 0.25, 1e-6));
        slam.predict(&motion(Se2::default(), anywhere)).unwrap();
        slam.update(&see(&[[5.0, 0.9], [5.0, 1.9], [8.0, 1.4]])).unwrap();
        slam.map_from_base().y()
    };
    assert!((found(Association::Joint) + 0.9).abs() < 0.05, "{}", found(Association::Joint));
    assert!((found(Association::Nearest) + 0.9).abs() > 0.3, "{}", found(Association::Nearest));
}

/// Ranges alone, with a scale that is off by 5 %, from a way that is not straight.
#[test]
fn beacons_are_placed_by_their_ranges() {
    let beacons = [Vector2::new(12.0, 10.0), Vector2::new(-10.0, 2.0), Vector2::new(4.0, -9.0)];
    let mut world = World::new(3);
    let params = LandmarkSlamParams { range_scale_sigma: 0.1, ..Default::default() };
    let mut slam = LandmarkSlam::new(params).unwrap();
    for step in 0..3 * 75 {
        slam.predict(&world.drive()).unwrap();
        let id = step % 3;
        let range = 1.05 * (beacons[id] - world.truth.translation()).norm() + 0.1 * normal(&mut world.stream);
        let seen = LandmarkSighting::new(Some(id as u32), LandmarkReading::range(range, 0.1).unwrap());
        slam.update(&[seen]).unwrap();
    }
    let found: Vec<_> = slam.landmarks().collect();
    assert_eq!(found.len(), 3);
    for landmark in found {
        let error = landmark.place.mean() - beacons[landmark.id.unwrap() as usize];
        let square = error.dot(&(landmark.place.covariance().try_inverse().unwrap() * error));
        assert!(error.norm() < 0.6 && square < 16.0, "{error} {square}");
    }
    let (scale, sigma) = slam.range_scale();
    assert!((scale - 0.05).abs() < 4.0 * sigma && sigma < 0.01, "{scale} {sigma}");
    assert_eq!(slam.state.points.len(), 3, "no anchor is left behind");
}

/// A post that was there for one look is forgotten, one that was believed is not.
#[test]
fn what_is_not_seen_again_is_forgotten() {
    let view = Some(SensorView { range: 10.0, half_angle: 3.0 });
    let mut slam = LandmarkSlam::new(LandmarkSlamParams { view, ..Default::default() }).unwrap();
    let post = |x: f64| LandmarkSighting::new(None, LandmarkReading::range_bearing(x, 0.0, SIGMAS).unwrap());
    for _ in 0..3 {
        slam.update(&[post(4.0)]).unwrap();
    }
    slam.update(&[post(8.0)]).unwrap();
    assert_eq!(slam.landmarks().count(), 2);
    let removed: usize = (0..20).map(|_| slam.update(&[]).unwrap().removed).sum();
    assert_eq!((removed, slam.landmarks().count()), (1, 1));
}

/// The graph of a drive with two names for one post finds it out, and is better than the filter.
#[test]
fn the_graph_joins_what_is_one() {
    let mut world = World::new(11);
    let mut slam = LandmarkGraphSlam::new(LandmarkGraphSlamParams::default()).unwrap();
    let mut truths = Vec::new();
    for step in 0..2 * 75 {
        let mut seen = world.look(true);
        // The sensor renames the posts at half-time.
        if step >= 75 {
            for sighting in &mut seen {
                sighting.id = sighting.id.map(|id| id + 100);
            }
        }
        slam.update(&seen).unwrap();
        truths.push(world.truth);
        slam.predict(&world.drive()).unwrap();
    }
    assert!(slam.landmarks().count() > 9);
    let merged = slam.finish().unwrap();
    assert_eq!((merged, slam.landmarks().count()), (9, 9));
    let worst = truths.iter().zip(slam.graph().poses()).map(|(a, b)| a.minus(b).norm()).fold(0.0, f64::max);
    assert!(worst < 0.3, "{worst}");
    let [cost, again] = [(); 2].map(|()| slam.optimize().unwrap().cost);
    assert!((cost - again).abs() <= 1e-7 * cost, "the optimum is reached: {cost} {again}");
}

/// The covariance of many updates against the same by dense matrices, in the group's own coordinates.
#[test]
fn corrections_are_those_of_dense_matrices() {
    let mut world = World::new(2);
    let mut slam = LandmarkSlam::new(LandmarkSlamParams::default()).unwrap();
    for _ in 0..10 {
        slam.predict(&world.drive()).unwrap();
        slam.update(&world.look(true)).unwrap();
    }
    slam.predict(&world.drive()).unwrap();
    let mut scratch = correction::CorrectionScratch::default();
    slam.state.flush(&mut scratch);
    let n = slam.state.covariance.size();
    let before = DMatrix::from_fn(n, n, |i, j| slam.state.covariance.get(i, j));
    let constraints: Vec<_> = world
        .look(true)
        .iter()
        .map(|sighting| {
            let is_it =
                |point: &state::Point| matches!(point.kind, state::PointKind::Landmark { id, .. } if id == sighting.id);
            let index = slam.state.points.iter().position(is_it).unwrap();
            let seen = slam.state.seen(&sighting.base_from_sensor, index);
            slam.state.constraint(&sighting.base_from_sensor, index, &sighting.expect(&seen, 0.0).unwrap())
        })
        .collect();
    let k = 2 * constraints.len();
    let (mut h, mut r) = (DMatrix::zeros(k, n), DMatrix::zeros(k, k));
    for (i, c) in constraints.iter().enumerate() {
        h.view_mut((2 * i, c.point), (2, 2)).copy_from(&c.a);
        h.view_mut((2 * i, 0), (2, 2)).copy_from(&(-c.a));
        r.view_mut((2 * i, 2 * i), (2, 2)).copy_from(&c.noise);
    }
    let gain = &before * h.transpose() * (&h * &before * h.transpose() + &r).try_inverse().unwrap();
    let keep = DMatrix::identity(n, n) - &gain * &h;
    // Joseph's form.
    let expected = &keep * before * keep.transpose() + &gain * r * gain.transpose();
    assert!(slam.state.correct(&constraints, SlamErrors::Invariant, &mut scratch));
    let after = DMatrix::from_fn(n, n, |i, j| slam.state.covariance.get(i, j));
    assert!((after - expected).amax() < 1e-12);
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let mut world = World::new(1);
    let mut slam = LandmarkSlam::new(LandmarkSlamParams::default()).unwrap();
    slam.update(&world.look(false)).unwrap();
    slam.predict(&world.drive()).unwrap();
    slam.update(&world.look(false)).unwrap();
    let before = slam.state.clone();
    let nan = f64::NAN;
    for bad in [
        motion(Se2::new(nan, 0.0, 0.0), Matrix3::zeros()),
        motion(Se2::new(1e9, 0.0, 0.0), Matrix3::zeros()),
        motion(Se2::default(), Matrix3::identity() * nan),
        motion(Se2::default(), -Matrix3::identity()),
        motion(Se2::default(), Matrix3::identity() * 1e200),
    ] {
        assert!(slam.predict(&bad).is_err());
    }
    let good = world.look(false)[0];
    let exact = UncertainVector::new(Vector2::new(3.0, 0.0), Matrix2::zeros()).unwrap();
    let far = UncertainVector::new(Vector2::new(1e9, 0.0), Matrix2::identity()).unwrap();
    for bad in [
        good.with_mount(Se2::new(0.0, nan, 0.0)),
        LandmarkSighting::new(None, LandmarkReading::RangeBearing(exact)),
        LandmarkSighting::new(None, LandmarkReading::Place(far)),
        LandmarkSighting::new(None, LandmarkReading::range_bearing(-1.0, 0.0, SIGMAS).unwrap()),
        LandmarkSighting::new(Some(1), LandmarkReading::range(-1.0, 0.1).unwrap()),
        LandmarkSighting::new(Some(1), LandmarkReading::range(1.0, 0.0).unwrap()),
        LandmarkSighting::new(Some(1), LandmarkReading::range(1e200, 0.1).unwrap()),
        LandmarkSighting::new(Some(1), LandmarkReading::range(1.0, 1e100).unwrap()),
        LandmarkSighting::new(Some(1), LandmarkReading::range(1.0, 1e-160).unwrap()),
        good.with_mount(Se2::new(1e200, 0.0, 0.0)),
    ] {
        assert!(slam.update(&[good, bad]).is_err(), "{bad:?}");
    }
    assert_eq!(slam.state, before);
    assert!(LandmarkReading::range(nan, 0.1).is_err() && LandmarkReading::range_bearing(1.0, nan, SIGMAS).is_err());
}

#[test]
fn bad_parameters_are_named() {
    let ok = LandmarkSlamParams::default();
    let noise = |forward| WayNoise { forward, ..WayNoise::default() };
    let start = |start: RangeStart| LandmarkSlamParams { range_start: start, ..ok };
    for bad in [
        LandmarkSlamParams { way_noise: noise(-1.0), ..ok },
        LandmarkSlamParams { way_noise: noise(f64::NAN), ..ok },
        LandmarkSlamParams { range_scale_sigma: -0.1, ..ok },
        LandmarkSlamParams { gate_probability: 1.0, ..ok },
        LandmarkSlamParams { novelty_probability: 0.5, ..ok },
        LandmarkSlamParams { joint_work: 0, ..ok },
        LandmarkSlamParams { lead: -1.0, ..ok },
        LandmarkSlamParams { lead: f64::NAN, ..ok },
        LandmarkSlamParams { most_landmarks: usize::MAX, ..ok },
        LandmarkSlamParams { view: Some(SensorView { range: 0.0, half_angle: 1.0 }), ..ok },
        LandmarkSlamParams { view: Some(SensorView { range: 1.0, half_angle: 4.0 }), ..ok },
        start(RangeStart { spacing: 0.0, ..Default::default() }),
        start(RangeStart { least: 2, ..Default::default() }),
        start(RangeStart { most: 9, ..Default::default() }),
        start(RangeStart { lead: f64::NAN, ..Default::default() }),
        start(RangeStart { certainty: 0.0, ..Default::default() }),
    ] {
        assert!(LandmarkSlam::new(bad).is_err(), "{bad:?}");
    }
    let graph = LandmarkGraphSlamParams::default();
    for bad in [
        LandmarkGraphSlamParams { merge_probability: 0.0, ..graph },
        LandmarkGraphSlamParams { least_sigmas: [0.0, 1.0], ..graph },
        LandmarkGraphSlamParams { kernel: agv_core::solve::RobustKernel::Huber { scale: 0.0 }, ..graph },
    ] {
        assert!(LandmarkGraphSlam::new(bad).is_err(), "{bad:?}");
    }
}
