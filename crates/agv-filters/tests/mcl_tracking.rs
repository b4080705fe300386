//! Tracking in a room whose scans are computed in closed form, over many seeds; and what bad input does to the filter.

use agv_core::{
    Error,
    compute::{Par, Seed, Stream},
    geometry::{LieGroup, Se2, Twist2, UncertainPose},
    grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, SkipReason, UpdateOutcome},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_filters::particle::{
    DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
    MotionModel, OdometryNoise,
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;

/// Inner size of the room, in metres.
const ROOM: (f64, f64) = (8.0, 5.0);
const RANGE_SIGMA: f64 = 0.02;
const ALPHA: f64 = 0.02;

type Filter = Mcl<DifferentialOdometryModel, LikelihoodFieldModel>;

/// Free inside, a wall of one cell whose inner face is the room's.
fn room() -> Grid<CellState> {
    let resolution = 0.05;
    let (width, height) = ((ROOM.0 / resolution) as usize + 2, (ROOM.1 / resolution) as usize + 2);
    let layout = GridLayout::new(width, height, resolution, Se2::new(-resolution, -resolution, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for x in 0..width as i32 {
        map.set(Cell::new(x, 0), CellState::Occupied);
        map.set(Cell::new(x, height as i32 - 1), CellState::Occupied);
    }
    for y in 0..height as i32 {
        map.set(Cell::new(0, y), CellState::Occupied);
        map.set(Cell::new(width as i32 - 1, y), CellState::Occupied);
    }
    map
}

fn scan_from(pose: &Se2, stream: &mut Stream) -> LaserScan {
    dense_scan_from(pose, 90, stream)
}

fn dense_scan_from(pose: &Se2, beams: usize, stream: &mut Stream) -> LaserScan {
    let increment = 4.0 / (beams - 1) as f64;
    let geometry = ScanGeometry { angle_min: -2.0, angle_increment: increment, range_max: 20.0, ..Default::default() };
    let range = |i: usize| {
        let (sin, cos) = (pose.yaw() + geometry.angle(i)).sin_cos();
        let along_x = if cos > 0.0 { (ROOM.0 - pose.x()) / cos } else { -pose.x() / cos };
        let along_y = if sin > 0.0 { (ROOM.1 - pose.y()) / sin } else { -pose.y() / sin };
        along_x.min(along_y)
    };
    let noisy = (0..beams).map(|i| {
        let z: f64 = StandardNormal.sample(stream);
        (range(i) + RANGE_SIGMA * z) as f32
    });
    let ranges = noisy.collect();
    LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
}

fn filter(particles: usize, seed: u64) -> Filter {
    filter_with(LikelihoodFieldModelParams::default(), particles, seed)
}

fn filter_with(sensor: LikelihoodFieldModelParams, particles: usize, seed: u64) -> Filter {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, sensor).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(ALPHA)).unwrap();
    let params = MclParams { particles, ..Default::default() };
    Mcl::new(motion, sensor, FreeSpace::new(&map, 0.2).unwrap(), params, Seed(seed)).unwrap()
}

fn diagonal(x: f64, y: f64, yaw: f64) -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(x * x, y * y, yaw * yaw))
}

fn increment(start_from_end: Se2) -> OdometryIncrement {
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &start_from_end).unwrap()
}

/// Drives a circle with a scanner of so many beams, all of them used, and returns the squared position errors and the NEES
/// of every update.
fn drive(beams: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut mcl = filter_with(LikelihoodFieldModelParams { max_beams: beams, ..Default::default() }, 2000, seed);
    let mut world = Seed(seed).derive(99).stream(0, 0);
    let slip = DifferentialOdometryModel::new(OdometryNoise::uniform(ALPHA)).unwrap();
    let mut truth = Se2::new(4.0, 1.2, 0.0);
    mcl.initialize(&PoseBelief::around(truth, diagonal(0.2, 0.2, 0.1)).unwrap()).unwrap();
    let (mut squares, mut nees) = (Vec::new(), Vec::new());
    for _ in 0..60 {
        // The odometry reports what was commanded; the vehicle does what the motion model draws.
        let reported = increment(Twist2::new(0.25, 0.0, 0.2).integrate(1.0));
        truth = slip.condition(&reported)(&truth, &mut world);
        mcl.predict(&reported).unwrap();
        assert!(matches!(mcl.update(&dense_scan_from(&truth, beams, &mut world)), Ok(UpdateOutcome::Applied(_))));
        let estimate = mcl.estimate().unwrap();
        let error = truth.minus(estimate.map_from_base());
        squares.push((truth.translation() - estimate.map_from_base().translation()).norm_squared());
        let information = estimate.covariance().try_inverse().unwrap();
        nees.push((error.transpose() * information * error).x);
    }
    (squares, nees)
}

/// The bound: end points are read to a cell of 5 cm, uniformly off by at most half of it (1.4 cm one sigma), with 2 cm of
/// range noise, and walls one cell thick pull by half a cell (2.5 cm): 3.5 cm per beam and axis if all beams erred
/// alike. Independent beams only do better; the particles' own spread adds less than that again.
#[test]
fn tracks_a_room_over_many_seeds() {
    let (mut squares, mut nees, mut seeds) = (0.0, Vec::new(), 0.0);
    for seed in 0..20 {
        let (s, n) = drive(60, seed);
        // The first updates start from 20 cm.
        let tail = &s[10..];
        let rmse = (tail.iter().sum::<f64>() / tail.len() as f64).sqrt();
        assert!(rmse < 0.1, "seed {seed}: {rmse} m");
        squares += rmse * rmse;
        nees.extend_from_slice(&n[10..]);
        seeds += 1.0;
    }
    let rmse = (squares / seeds).sqrt();
    assert!(rmse < 0.05 * 2_f64.sqrt(), "{rmse} m");
    // A sample's covariance follows the sample: where few particles carry the weight it is far too small, so that the mean
    // NEES has no bound. What holds is its middle: the median of chi-square with 3 degrees of freedom is 2.37, and
    // three quarters of the updates stay below the 95 % quantile, 7.81.
    nees.sort_by(f64::total_cmp);
    let (median, upper) = (nees[nees.len() / 2], nees[nees.len() * 3 / 4]);
    eprintln!("rmse {rmse:.4} m, NEES: median {median:.2}, third quartile {upper:.2}");
    assert!(median < 3.5 && upper < 7.81, "{median}, {upper}");
}

/// With the beams counted by how many are independent, a denser scanner makes the filter neither worse nor surer than it
/// may be: the bounds are those of 60 beams.
#[test]
fn denser_scanners_track_as_well() {
    for beams in [180, 720] {
        let (mut squares, mut nees) = (Vec::new(), Vec::new());
        for seed in 0..4 {
            let (s, n) = drive(beams, seed);
            squares.extend_from_slice(&s[10..]);
            nees.extend_from_slice(&n[10..]);
        }
        let rmse = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        nees.sort_by(f64::total_cmp);
        let (median, upper) = (nees[nees.len() / 2], nees[nees.len() * 3 / 4]);
        eprintln!("{beams} beams: rmse {rmse:.4} m, NEES: median {median:.2}, third quartile {upper:.2}");
        assert!(rmse < 0.05 * 2_f64.sqrt() && median < 3.5 && upper < 7.81, "{beams}: {rmse} {median} {upper}");
    }
}

#[test]
fn finds_itself_from_anywhere_up_to_the_symmetry_of_a_rectangle() {
    let mut mcl = filter(20_000, 3);
    let mut world = Seed(1).stream(0, 0);
    mcl.initialize(&PoseBelief::Anywhere).unwrap();
    assert!(mcl.estimate().unwrap().covariance().m11 > 1.0);
    let mut truth = Se2::new(2.0, 1.2, 0.4);
    for _ in 0..8 {
        let reported = increment(Twist2::new(0.25, 0.0, 0.2).integrate(1.0));
        truth = truth * reported.start_from_end;
        mcl.predict(&reported).unwrap();
        mcl.update(&scan_from(&truth, &mut world)).unwrap();
    }
    // Turned by half a turn about its middle, the room is the same.
    let turned = Se2::new(ROOM.0 - truth.x(), ROOM.1 - truth.y(), truth.yaw() + PI);
    let near = |pose: &Se2| pose.minus(&truth).norm() < 0.5 || pose.minus(&turned).norm() < 0.5;
    let weight: f64 =
        mcl.particles().states().iter().zip(mcl.particles().weights()).filter(|(p, _)| near(p)).map(|(_, w)| w).sum();
    assert!(weight > 0.95, "{weight}");
}

#[test]
fn nothing_is_known_before_the_first_belief() {
    let mut mcl = filter(10, 0);
    let scan = scan_from(&Se2::new(1.0, 1.0, 0.0), &mut Seed(1).stream(0, 0));
    assert_eq!(mcl.predict(&increment(Se2::identity())), Err(LocalizationError::NotInitialized));
    assert_eq!(mcl.update(&scan), Err(LocalizationError::NotInitialized));
    assert_eq!((mcl.estimate(), mcl.status()), (None, LocalizationStatus::Uninitialized));
}

#[test]
fn bad_beliefs_are_refused_and_change_nothing() {
    let mut mcl = filter(300, 0);
    let at = Se2::new(4.0, 2.0, 0.0);
    mcl.initialize(&PoseBelief::around(at, diagonal(0.1, 0.1, 0.1)).unwrap()).unwrap();
    let before = (mcl.particles().clone(), mcl.estimate());
    let vague = PoseBelief::around(at, diagonal(1e300, 0.1, 0.1)).unwrap_or(PoseBelief::Anywhere);
    let wide = PoseBelief::around(at, diagonal(1e7, 0.1, 0.1)).unwrap();
    assert!(vague == PoseBelief::Anywhere && matches!(mcl.initialize(&wide), Err(LocalizationError::Invalid(_))));
    for x in [100.0, 1e200] {
        let far = PoseBelief::around(Se2::new(x, 0.0, 0.0), diagonal(0.1, 0.1, 0.1)).unwrap();
        assert_eq!(mcl.initialize(&far), Err(LocalizationError::OffMap { x, y: 0.0 }));
    }
    assert!((mcl.particles().clone(), mcl.estimate()) == before);
    // A pose that is known exactly is a belief too.
    mcl.initialize(&PoseBelief::around(at, Matrix3::zeros()).unwrap()).unwrap();
    let estimate = mcl.estimate().unwrap();
    assert!(estimate.map_from_base().minus(&at).norm() < 1e-9 && estimate.covariance().amax() < 1e-9);
}

#[test]
fn bad_motions_are_refused_and_change_nothing() {
    let mut mcl = filter(300, 0);
    mcl.initialize(&PoseBelief::around(Se2::new(4.0, 2.0, 0.0), diagonal(0.1, 0.1, 0.1)).unwrap()).unwrap();
    let (particles, estimate) = (mcl.particles().clone(), mcl.estimate());
    let good = increment(Se2::new(0.3, 0.0, 0.0));
    for bad in [
        OdometryIncrement { start_from_end: Se2::new(f64::NAN, 0.0, 0.0), ..good },
        OdometryIncrement { start_from_end: Se2::new(0.0, 0.0, f64::INFINITY), ..good },
        OdometryIncrement { start_from_end: Se2::new(1e300, 0.0, 0.0), ..good },
        OdometryIncrement { covariance: Matrix3::from_element(f64::NAN), ..good },
    ] {
        assert!(matches!(mcl.predict(&bad), Err(LocalizationError::Invalid(_))));
    }
    assert!(mcl.particles() == &particles && mcl.estimate() == estimate);
    // Time that stands still or steps backwards: stamps are not used.
    let backwards = OdometryIncrement { start: Stamp::from_seconds(9.0), end: Stamp::from_seconds(3.0), ..good };
    assert_eq!(mcl.predict(&backwards), Ok(()));
    assert_eq!(mcl.predict(&good), Ok(()));
}

#[test]
fn scans_that_say_nothing_are_skipped_and_change_no_weight() {
    let mut mcl = filter(300, 0);
    mcl.initialize(&PoseBelief::around(Se2::new(4.0, 2.0, 0.0), diagonal(0.1, 0.1, 0.1)).unwrap()).unwrap();
    let before = mcl.particles().clone();
    let geometry = ScanGeometry::default();
    for ranges in [vec![], vec![f32::NAN; 90], vec![f32::INFINITY; 90], vec![-1.0; 90], vec![0.0; 90]] {
        let scan = LaserScan::new(Stamp::default(), geometry, ranges).unwrap();
        let expected = UpdateOutcome::Skipped(SkipReason::TooFewReadings { usable: 0, needed: 5 });
        assert_eq!(mcl.update(&scan), Ok(expected));
        assert!(mcl.particles() == &before);
    }
    let mut world = Seed(1).stream(0, 0);
    let scan = scan_from(&Se2::new(4.0, 2.0, 0.0), &mut world);
    assert!(matches!(mcl.update(&scan), Ok(UpdateOutcome::Applied(_))));
    assert_eq!(mcl.update(&scan), Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion)));
    mcl.request_update();
    assert!(matches!(mcl.update(&scan), Ok(UpdateOutcome::Applied(_))));
}

/// The spread after a blind way is that of its parts of 0.2 m drawn one by one, whatever the rate of the odometry and the scans: not that of
/// one draw for all of it, which would be three times as wide after 2 m.
#[test]
fn a_blind_way_spreads_the_particles_as_its_parts_do() {
    let blind = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![f32::INFINITY; 90]).unwrap();
    let model = DifferentialOdometryModel::new(OdometryNoise::uniform(ALPHA)).unwrap();
    let start = UncertainPose::new(Se2::new(4.0, 2.0, 0.0), diagonal(1e-4, 1e-4, 1e-6)).unwrap();
    let part = increment(Se2::new(0.2, 0.0, 0.0));
    let part = UncertainPose::new(part.start_from_end, model.covariance(&part)).unwrap();
    let expected = (0..10).fold(start, |pose, _| pose.compose(&part));
    for steps_per_part in [1, 2, 8] {
        let mut mcl = filter(4000, 3);
        mcl.initialize(&PoseBelief::Around(start)).unwrap();
        for _ in 0..10 * steps_per_part {
            // A hair more than the threshold, so that rounding does not decide.
            mcl.predict(&increment(Se2::new(0.200_001 / f64::from(steps_per_part), 0.0, 0.0))).unwrap();
            assert!(matches!(mcl.update(&blind), Ok(UpdateOutcome::Skipped(SkipReason::TooFewReadings { .. }))));
        }
        let estimate = mcl.estimate().unwrap().pose;
        assert!(expected.mean().minus(estimate.mean()).norm() < 1e-3, "the odometry is the estimate's motion");
        let drawn = mcl.particles().estimate(Par::Seq).unwrap();
        for axis in 0..3 {
            let [want, said, got] = [&expected, &estimate, &drawn].map(|pose| pose.covariance()[(axis, axis)]);
            assert!((said / want - 1.0).abs() < 1e-3, "axis {axis}: {said} {want}");
            // A sample variance of 4000 is off by 2.2 % (one deviation).
            assert!((got / want - 1.0).abs() < 0.1, "axis {axis}: {got} {want}");
        }
    }
}

#[test]
fn the_estimate_says_what_time_it_refers_to() {
    let mut mcl = filter(300, 0);
    let start = Se2::new(4.0, 2.0, 0.0);
    let belief = PoseBelief::around(start, diagonal(0.1, 0.1, 0.1)).unwrap();
    let at = Stamp::from_seconds;
    mcl.initialize(&belief).unwrap();
    assert_eq!(mcl.estimate().unwrap().stamp, None);
    let mut scan = scan_from(&start, &mut Seed(1).stream(0, 0));
    let ranges: Vec<f32> = scan.ranges().to_vec();
    scan.refill(at(2.0), ranges.into_iter()).unwrap();
    mcl.update(&scan).unwrap();
    assert_eq!(mcl.estimate().unwrap().stamp, Some(at(2.0)));
    let motion = OdometryIncrement { start: at(2.0), end: at(3.0), ..increment(Se2::new(0.3, 0.0, 0.0)) };
    mcl.predict(&motion).unwrap();
    mcl.update(&scan).unwrap();
    assert_eq!(mcl.estimate().unwrap().stamp, Some(at(3.0)), "the scan counts as taken at the end of the motion");
    mcl.initialize(&belief).unwrap();
    assert_eq!(mcl.estimate().unwrap().stamp, None);
}

#[test]
fn driving_blind_and_off_the_map_stays_finite() {
    let mut mcl = filter(300, 0);
    mcl.initialize(&PoseBelief::around(Se2::new(4.0, 2.0, 0.0), diagonal(0.1, 0.1, 0.1)).unwrap()).unwrap();
    let mut world = Seed(1).stream(0, 0);
    let mut last = mcl.estimate().unwrap().covariance().trace();
    for _ in 0..50 {
        mcl.predict(&increment(Se2::new(0.15, 0.0, 0.0))).unwrap();
        let spread = mcl.estimate().unwrap().covariance().trace();
        assert!(spread > last, "prediction made the belief more certain: {last} to {spread}");
        last = spread;
    }
    mcl.predict(&increment(Se2::new(1000.0, 0.0, 0.0))).unwrap();
    mcl.update(&scan_from(&Se2::new(4.0, 2.0, 0.0), &mut world)).unwrap();
    let estimate = mcl.estimate().unwrap();
    assert!(estimate.map_from_base().is_finite() && estimate.covariance().iter().all(|v| v.is_finite()));
    assert!(matches!(mcl.status(), LocalizationStatus::Converging { .. } | LocalizationStatus::Lost { .. }));
}

#[test]
fn bad_parameters_are_named() {
    let build = |params: MclParams| {
        let mcl = filter(1, 0);
        Mcl::new(*mcl.motion(), mcl.sensor().clone(), FreeSpace::new(&room(), 0.2).unwrap(), params, Seed(0))
            .map(|_| ())
    };
    let good = MclParams::default();
    assert_eq!(build(MclParams { particles: 0, ..good }), Err(Error::Empty { name: "particles" }));
    assert!(matches!(build(MclParams { particles: usize::MAX, ..good }), Err(Error::TooMany { .. })));
    let mut bad = good;
    bad.update.distance = f64::NAN;
    assert!(build(bad).is_err());
    let mut bad = good;
    bad.resample.ratio = -0.5;
    assert!(build(bad).is_err());
}
