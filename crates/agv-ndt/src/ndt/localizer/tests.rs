use super::*;
use crate::scenes::{CORRIDOR, ROOM, cloud, scatter, sheets};
use agv_core::{
    compute::Seed,
    geometry::{Se2, So3, Twist2, Twist3},
    roles::{Correct, Doubt, SkipReason, Termination, UpdateOutcome, laws},
    sensors::SensorId,
    time::Stamp,
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams, OdometryErrors, Simulator3d, Vehicle, VehicleParams};
use nalgebra::{Vector3, Vector6};

type Rectangles<'a> = &'a [[[f64; 3]; 3]];

fn map_of(rectangles: Rectangles<'_>, per_area: f64) -> NdtMap {
    let mut map = NdtMap::new(NdtLocalizerParams::default().ndt.voxels).unwrap();
    map.insert(&cloud(&sheets(rectangles, per_area, 1), &Se3::default()), &Se3::default());
    map
}

fn seen(rectangles: Rectangles<'_>, per_area: f64, draw: u32, at: &Se3, stamp: Stamp) -> PointCloud {
    cloud(&sheets(rectangles, per_area, draw), at).with_stamp(stamp)
}

fn at(x: f64, y: f64, yaw: f64) -> Se3 {
    Se3::from_parts(Vector3::new(x, y, -1.0), So3::from_roll_pitch_yaw(0.0, 0.0, yaw))
}

fn around(pose: Se3, sigma: f64) -> PoseBelief<Se3> {
    PoseBelief::around(pose, Matrix6::identity() * sigma.powi(2)).unwrap()
}

fn room() -> NdtLocalizer {
    NdtLocalizer::new(&map_of(&ROOM, 100.0), NdtLocalizerParams::default()).unwrap()
}

fn estimate(localizer: &NdtLocalizer) -> PoseEstimate<Se3> {
    localizer.estimate().unwrap()
}

fn error(localizer: &NdtLocalizer, truth: &Se3) -> Vector6<f64> {
    estimate(localizer).map_from_base().minus(truth)
}

/// A motion ahead from one time to another.
fn ahead(from: f64, to: f64, x: f64) -> MotionIncrement<Se3> {
    let end = Se3::from(Se2::new(x, 0.0, 0.0));
    MotionIncrement::between(Stamp::from_seconds(from), &Se3::default(), Stamp::from_seconds(to), &end).unwrap()
}

#[test]
fn it_plays_its_role() {
    let mut localizer = room();
    laws::localizer(&mut localizer, &at(0.0, 0.0, 0.3), &(Matrix6::identity() * 0.001), &ahead(0.0, 0.5, 1.0)).unwrap();
    let place = *estimate(&localizer).map_from_base();
    let cloud = seen(&ROOM, 10.0, 2, &place, Stamp::from_seconds(0.5));
    laws::correct(&mut localizer, &PointCloud::default().with_stamp(cloud.stamp())).unwrap();
    let other = cloud.clone().with_sensor(SensorId(1));
    laws::two_sensors(&mut localizer, &cloud, &other).unwrap();
    assert_eq!(localizer.update(&cloud), Ok(UpdateOutcome::Skipped(SkipReason::Duplicate)));
}

#[test]
fn clouds_that_do_not_fit_leave_the_belief_untouched() {
    let (mut localizer, place) = (room(), at(0.5, 0.2, 0.4));
    localizer.initialize(&around(place, 0.05)).unwrap();
    localizer.predict(&ahead(1.0, 1.1, 0.0)).unwrap();
    let before = estimate(&localizer);
    let now = Stamp::from_seconds(1.1);
    let elsewhere = CORRIDOR;
    let far = at(0.9, 0.2, 0.4);
    let nan = PointCloud::from_points([Vector3::from_element(f32::NAN); 500]).with_stamp(now);
    for (name, cloud) in [
        ("empty", PointCloud::default().with_stamp(now)),
        ("one point", PointCloud::from_points([Vector3::x()]).with_stamp(now)),
        ("not finite", nan),
        ("too old", seen(&ROOM, 10.0, 3, &place, Stamp::from_seconds(0.1))),
        ("from the future", seen(&ROOM, 10.0, 3, &place, Stamp::from_seconds(9.0))),
        ("another scene", seen(&elsewhere, 3.0, 3, &place, now)),
        ("eight standard deviations off", seen(&ROOM, 10.0, 3, &far, now)),
    ] {
        let outcome = localizer.update(&cloud).unwrap();
        assert!(matches!(outcome, UpdateOutcome::Skipped(_)), "{name}: {outcome:?}");
        assert_eq!(estimate(&localizer), before, "{name}");
    }
    assert!(matches!(localizer.update(&seen(&ROOM, 10.0, 3, &place, now)), Ok(UpdateOutcome::Applied(_))));
    assert!(error(&localizer, &place).norm() < 0.02, "{}", error(&localizer, &place));
}

/// 20 m along a corridor without ends, with odometry that reads 2 % too far: the match holds what the walls fix, says what they do
/// not, and neither jumps nor gets surer along it.
#[test]
fn a_long_corridor_is_followed_by_odometry_lengthwise() {
    let mut localizer = NdtLocalizer::new(&map_of(&CORRIDOR, 60.0), NdtLocalizerParams::default()).unwrap();
    localizer.initialize(&around(at(-10.0, 0.1, 0.02), 0.01)).unwrap();
    let (mut lengthwise, steps) = (0.01, 40);
    for i in 1..=steps {
        let (from, to) = (0.1 * f64::from(i - 1), 0.1 * f64::from(i));
        localizer.predict(&ahead(from, to, 0.51)).unwrap();
        let truth = at(-10.0 + 0.5 * f64::from(i), 0.1, 0.0);
        let before = *estimate(&localizer).map_from_base();
        let outcome = localizer.update(&seen(&CORRIDOR, 4.0, 10 + i as u32, &truth, Stamp::from_seconds(to)));
        assert!(matches!(outcome, Ok(UpdateOutcome::Applied(_))), "{outcome:?}");
        let alignment = localizer.alignment().unwrap();
        assert_eq!(alignment.unobserved.trace().round(), 1.0);
        assert!(alignment.unobserved[(0, 0)] > 0.95, "{}", alignment.unobserved);
        let moved = estimate(&localizer).map_from_base().minus(&before);
        assert!(moved.x.abs() < 0.01, "a jump along the corridor: {moved}");
        let sigma = estimate(&localizer).covariance()[(0, 0)].sqrt();
        assert!(sigma > lengthwise, "{sigma} after {lengthwise}");
        lengthwise = sigma;
    }
    let (last, covariance) = (error(&localizer, &at(10.0, 0.1, 0.0)), *estimate(&localizer).covariance());
    assert!((last.x - 0.4).abs() < 0.1, "odometry alone: {last}");
    assert!(last.y.abs() < 0.02 && last.z.abs() < 0.02 && last[5].abs() < 0.003, "{last}");
    assert!(covariance[(0, 0)] > 50.0 * covariance[(1, 1)], "{covariance}");
}

/// Nobody has told how far along the corridor: what the walls fix is corrected all the same, and nothing else.
#[test]
fn a_belief_that_is_wide_along_a_corridor_is_corrected_across_it() {
    let map = map_of(&CORRIDOR, 60.0);
    for wide in [1.2_f64, 3.0] {
        let mut localizer = NdtLocalizer::new(&map, NdtLocalizerParams::default()).unwrap();
        let sigma = Vector6::new(wide, 0.1, 0.05, 0.02, 0.02, 0.03);
        let told = at(-9.4, 0.15, 0.0);
        let belief = PoseBelief::around(told, Matrix6::from_diagonal(&sigma.map(|s| s * s)));
        localizer.initialize(&belief.unwrap()).unwrap();
        for i in 1..=8 {
            let (from, to) = (0.1 * f64::from(i - 1), 0.1 * f64::from(i));
            localizer.predict(&ahead(from, to, 0.5)).unwrap();
            let truth = at(-10.0 + 0.5 * f64::from(i), 0.1, 0.0);
            let outcome = localizer.update(&seen(&CORRIDOR, 4.0, 30 + i as u32, &truth, Stamp::from_seconds(to)));
            assert!(matches!(outcome, Ok(UpdateOutcome::Applied(_))), "{wide}: {outcome:?}");
            let off = error(&localizer, &truth);
            assert!((off.x - 0.6).abs() < 0.1 * wide && off.y.abs() < 0.03 && off[5].abs() < 0.005, "{wide}: {off}");
        }
    }
}

#[test]
fn a_map_grows_by_the_last_cloud() {
    let (mut localizer, place) = (room(), at(0.5, 0.2, 0.4));
    localizer.initialize(&around(place, 0.05)).unwrap();
    let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 0.5), So3::from_roll_pitch_yaw(0.0, 0.0, 1.0));
    let cloud = seen(&ROOM, 12.0, 7, &place.compose(&mount), Stamp::from_seconds(0.0)).with_mount(mount).unwrap();
    assert!(matches!(localizer.update(&cloud), Ok(UpdateOutcome::Applied(_))));
    let mut expected = localizer.map().clone();
    expected.insert(&cloud, &place.compose(&mount));
    assert!(localizer.insert_straightened(&at(f64::NAN, 0.0, 0.0)).is_err());
    assert_eq!(localizer.insert_straightened(&place), Ok(cloud.len()));
    assert_eq!(localizer.map(), &expected);
    // Once, and no ghost of it with a cloud that was not taken.
    assert_eq!(localizer.insert_straightened(&place), Ok(0));
    let next = cloud.clone().with_stamp(Stamp::from_seconds(0.1));
    assert!(matches!(localizer.update(&next), Ok(UpdateOutcome::Applied(_))));
    assert!(matches!(localizer.update(&next), Ok(UpdateOutcome::Skipped(SkipReason::Duplicate))));
    assert_eq!(localizer.insert_straightened(&at(0.7, 0.2, 0.4)), Ok(0));
    assert_eq!(localizer.into_map(), expected);
}

/// With fewer starts than places and headings, the room's places are tried a few metres apart: the basin is as wide.
#[test]
fn a_search_tries_no_more_starts_than_it_may() {
    let search = SearchParams { max_starts: 400, ..SearchParams::default() };
    let params = NdtLocalizerParams { search: Some(search), ..NdtLocalizerParams::default() };
    let mut localizer = NdtLocalizer::new(&map_of(&ROOM, 100.0), params).unwrap();
    assert!(localizer.places().len() * search.headings > 1200);
    localizer.initialize(&PoseBelief::Anywhere).unwrap();
    let truth = at(5.0, 4.0, -1.4);
    localizer.update(&seen(&ROOM, 12.0, 45, &truth, Stamp::from_seconds(0.0))).unwrap();
    assert!((300..=401).contains(&localizer.search.starts()), "{}", localizer.search.starts());
    assert!(error(&localizer, &truth).norm() < 0.02, "{}", error(&localizer, &truth));
    let none = SearchParams { max_starts: 15, ..search };
    assert!(NdtLocalizerParams { search: Some(none), ..params }.validate().is_err());
}

#[test]
fn a_localizer_without_a_search_follows_alone() {
    let params = NdtLocalizerParams { search: None, ..NdtLocalizerParams::default() };
    let mut localizer = NdtLocalizer::new(&map_of(&ROOM, 100.0), params).unwrap();
    assert!(localizer.initialize(&PoseBelief::Anywhere).is_err());
    let start = at(-3.0, 3.0, 0.0);
    localizer.initialize(&around(start, 0.05)).unwrap();
    for k in 0..8 {
        let cloud = seen(&ROOM, 12.0, 90 + k, &at(4.5, -1.5, 2.0), Stamp::from_seconds(f64::from(k)));
        assert!(matches!(localizer.update(&cloud), Ok(UpdateOutcome::Skipped(_))));
    }
    assert_eq!(*estimate(&localizer).map_from_base(), start);
}

#[test]
fn a_vehicle_that_may_be_anywhere_is_found() {
    let mut localizer = room();
    for (i, &(x, y, yaw)) in [(0.0, 0.0, 2.9), (5.0, 4.0, -1.4), (-4.6, 3.1, 0.7)].iter().enumerate() {
        localizer.initialize(&PoseBelief::Anywhere).unwrap();
        assert!(matches!(localizer.status(), LocalizationStatus::Converging { .. }));
        let truth = at(x, y, yaw);
        for k in 0..3 {
            let stamp = Stamp::from_seconds(f64::from(k));
            let cloud = seen(&ROOM, 12.0, 40 + 5 * i as u32 + k as u32, &truth, stamp);
            let outcome = localizer.update(&cloud).unwrap();
            assert!(matches!(outcome, UpdateOutcome::Applied(_)), "{x} {y} {yaw}: {outcome:?}");
        }
        assert!(error(&localizer, &truth).norm() < 0.02, "{}", error(&localizer, &truth));
        assert_eq!(localizer.status(), LocalizationStatus::Tracking);
    }
}

/// A room without furniture that half a turn maps onto itself: nothing is decided.
#[test]
fn of_two_places_that_look_alike_neither_is_taken() {
    let bare = |per_area, draw| {
        let points = sheets(&ROOM[..5], per_area, draw).into_iter().map(|p| p - Vector3::new(0.7, 0.8, 0.0));
        points.flat_map(|p| [p, Vector3::new(-p.x, -p.y, p.z)]).collect::<Vec<_>>()
    };
    let mut map = NdtMap::new(NdtLocalizerParams::default().ndt.voxels).unwrap();
    map.insert(&cloud(&bare(50.0, 1), &Se3::default()), &Se3::default());
    let mut localizer = NdtLocalizer::new(&map, NdtLocalizerParams::default()).unwrap();
    localizer.initialize(&PoseBelief::Anywhere).unwrap();
    let before = estimate(&localizer);
    let outcome = localizer.update(&cloud(&bare(6.0, 4), &at(2.0, 1.0, 0.3)));
    assert_eq!(outcome, Ok(UpdateOutcome::Skipped(SkipReason::Unexplained)));
    assert_eq!(estimate(&localizer), before);
}

#[test]
fn a_vehicle_that_was_carried_away_is_lost_and_found() {
    let mut localizer = room();
    let start = at(-3.0, 3.0, 0.0);
    localizer.initialize(&around(start, 0.05)).unwrap();
    for k in 0..4 {
        localizer.update(&seen(&ROOM, 12.0, 50 + k, &start, Stamp::from_seconds(f64::from(k) - 9.0))).unwrap();
    }
    assert_eq!(localizer.status(), LocalizationStatus::Tracking);
    let (truth, mut was_lost) = (at(4.5, -1.5, 2.0), false);
    for k in 0..20 {
        let cloud = seen(&ROOM, 12.0, 60 + k as u32, &truth, Stamp::from_seconds(f64::from(k)));
        localizer.update(&cloud).unwrap();
        was_lost |= matches!(localizer.status(), LocalizationStatus::Lost { doubt: Doubt::Unexplained { .. } });
        if was_lost && localizer.status() == LocalizationStatus::Tracking {
            break;
        }
    }
    assert!(was_lost && localizer.status() == LocalizationStatus::Tracking, "{:?}", localizer.status());
    assert!(error(&localizer, &truth).norm() < 0.02, "{}", error(&localizer, &truth));
}

#[test]
fn a_start_that_was_wrong_is_mended() {
    let mut localizer = room();
    localizer.initialize(&around(at(-3.0, 3.0, 0.0), 0.05)).unwrap();
    let truth = at(4.5, -1.5, 2.0);
    for k in 0..12 {
        localizer.update(&seen(&ROOM, 12.0, 90 + k, &truth, Stamp::from_seconds(f64::from(k)))).unwrap();
    }
    assert_eq!(localizer.status(), LocalizationStatus::Tracking);
    assert!(error(&localizer, &truth).norm() < 0.02, "{}", error(&localizer, &truth));
}

struct Drive {
    errors: Vec<Vector6<f64>>,
    variances: Vec<Vector6<f64>>,
    nees: Vec<f64>,
}

/// Along an aisle of a factory at this speed, clouds bent by the motion and odometry with noise.
fn drive(factory: &Factory, map: &NdtMap, speed: f64, seed: u64, par: Par) -> Drive {
    let mount = Se3::from_parts(Vector3::new(0.2, 0.0, 1.5), So3::default());
    let lidar = LidarParams { columns: 450, range_sigma: 0.02, ..LidarParams::vlp16().with_mount(mount) };
    let lidar = Lidar::new(lidar, Seed(seed)).unwrap();
    let errors = OdometryErrors { alphas: [1e-4, 1e-5, 1e-4, 1e-5], ..OdometryErrors::NONE };
    let mut params = VehicleParams { odometry: errors, ..VehicleParams::default() };
    (params.limits.forward_speed, params.limits.acceleration) = (speed, 3.0);
    let start = factory.aisles()[1];
    let vehicle = Vehicle::new(params, start, Seed(seed)).unwrap();
    let mut simulator = Simulator3d::new(factory.world(), vehicle, 0.02).unwrap().with_lidar(lidar).unwrap();
    let mut localizer = NdtLocalizer::new(map, NdtLocalizerParams::default()).unwrap().with_parallelism(par);
    let sigma = Vector6::new(0.05, 0.05, 0.02, 0.01, 0.01, 0.03);
    let off = Vector6::from_fn(|i, _| sigma[i] * 3.4 * (scatter(97 * seed as u32 + i as u32) - 0.5));
    let belief = PoseBelief::around(Se3::from(start).plus(&off), Matrix6::from_diagonal(&sigma.map(|s| s * s)));
    localizer.initialize(&belief.unwrap()).unwrap();
    let mut drive = Drive { errors: vec![], variances: vec![], nees: vec![] };
    for i in 0..120 {
        let command = Twist2::new(speed, 0.0, 0.05 * (0.1 * f64::from(i)).sin());
        let seen = simulator.step(&command).unwrap();
        localizer.predict(&(&seen.odometry).into()).unwrap();
        for (cloud, _) in seen.clouds() {
            let outcome = localizer.update(cloud).unwrap();
            assert!(matches!(outcome, UpdateOutcome::Applied(_)), "{outcome:?}");
            let estimate = estimate(&localizer);
            let e = seen.truth.map_from_base.pipe_minus(estimate.map_from_base());
            drive.nees.push(e.dot(&(estimate.covariance().try_inverse().unwrap() * e)));
            drive.variances.push(estimate.covariance().diagonal());
            drive.errors.push(e);
        }
    }
    drive
}

trait PipeMinus {
    fn pipe_minus(self, estimate: &Se3) -> Vector6<f64>;
}

impl PipeMinus for Se2 {
    /// The estimate's error.
    fn pipe_minus(self, estimate: &Se3) -> Vector6<f64> {
        -Se3::from(self).minus(estimate)
    }
}

fn factory_map(factory: &Factory) -> NdtMap {
    let mount = Se3::from_parts(Vector3::new(0.2, 0.0, 1.5), So3::default());
    let params = LidarParams { columns: 900, range_sigma: 0.02, ..LidarParams::vlp16().with_mount(mount) };
    let mut lidar = Lidar::new(params, Seed(9)).unwrap();
    let mut map = NdtMap::new(NdtLocalizerParams::default().ndt.voxels).unwrap();
    for i in 0..12 {
        let pose = Se3::from(Se2::new(2.0 + 1.7 * f64::from(i), factory.aisles()[1].y() + 0.1 * f64::from(i % 2), 0.0));
        let cloud = lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::default()).unwrap();
        map.insert(cloud, &pose.compose(&mount));
    }
    map
}

/// Five drives: a few millimetres, and errors as large as their covariances say, in each direction to a factor of two. The mean of
/// the normalised errors of independent estimates would be 6 ± 1.2 with this many; those of one drive share the map's errors.
#[test]
fn errors_in_a_factory_are_small_and_those_of_the_covariance() {
    let factory =
        Factory::generate(FactoryParams { length: 30.0, width: 16.0, ..Default::default() }, Seed(3)).unwrap();
    let map = factory_map(&factory);
    let (mut nees, mut count, mut mean, mut ratio) = (0.0, 0.0, Vector6::zeros(), Vector6::zeros());
    for seed in 0..5 {
        let drive = drive(&factory, &map, 2.0 + 0.75 * seed as f64, seed, Par::Seq);
        count += drive.nees.len() as f64;
        nees += drive.nees.iter().sum::<f64>();
        let ratios = drive.errors.iter().zip(&drive.variances).map(|(e, v)| e.component_mul(e).component_div(v));
        ratio += ratios.sum::<Vector6<f64>>() / drive.errors.len() as f64 / 5.0;
        mean += drive.errors.iter().map(Vector6::abs).sum::<Vector6<f64>>();
    }
    let (nees, mean) = (nees / count, mean / count);
    assert!(mean.x < 0.005 && mean.y < 0.005 && mean[5] < 0.05_f64.to_radians(), "{mean}");
    assert!((3.0..9.0).contains(&nees), "{nees}");
    assert!(ratio.iter().all(|ratio| (0.25..4.0).contains(ratio)), "{ratio}");
}

#[test]
fn threads_change_no_bit() {
    let factory =
        Factory::generate(FactoryParams { length: 24.0, width: 16.0, ..Default::default() }, Seed(3)).unwrap();
    let map = factory_map(&factory);
    let [one, two] = [Par::Seq, Par::threads(2)].map(|par| drive(&factory, &map, 2.0, 1, par).errors);
    assert_eq!(one, two);
}

#[test]
fn bad_parameters_and_maps_are_named() {
    let (good, map) = (NdtLocalizerParams::default(), map_of(&ROOM, 20.0));
    let search = SearchParams::default();
    for bad in [
        NdtLocalizerParams { leaf: 0.0, ..good },
        NdtLocalizerParams { leaf: f32::NAN, ..good },
        NdtLocalizerParams { min_points: 0, ..good },
        NdtLocalizerParams { independent: 0.0, ..good },
        NdtLocalizerParams { independent: 1.1, ..good },
        NdtLocalizerParams { gate: 0.0, ..good },
        NdtLocalizerParams { gate: f64::NAN, ..good },
        NdtLocalizerParams { history: -1.0, ..good },
        NdtLocalizerParams { extrapolation: f64::INFINITY, ..good },
        NdtLocalizerParams { drift: DriftParams { position: -1.0, ..good.drift }, ..good },
        NdtLocalizerParams { drift: DriftParams { turning: f64::NAN, ..good.drift }, ..good },
        NdtLocalizerParams { search: Some(SearchParams { spacing: 0.0, ..search }), ..good },
        NdtLocalizerParams { search: Some(SearchParams { headings: 0, ..search }), ..good },
        NdtLocalizerParams { search: Some(SearchParams { finalists: 0, ..search }), ..good },
        NdtLocalizerParams { search: Some(SearchParams { lead: 2.0, ..search }), ..good },
        NdtLocalizerParams { search: Some(SearchParams { radius: 0.0, ..search }), ..good },
    ] {
        assert!(NdtLocalizer::new(&map, bad).is_err(), "{bad:?}");
    }
    let other = NdtMap::new(crate::ndt::VoxelParams { resolution: 0.5, ..good.ndt.voxels }).unwrap();
    assert!(matches!(NdtLocalizer::new(&other, good), Err(Error::MapMismatch { .. })));
    assert!(NdtLocalizer::new(&NdtMap::new(good.ndt.voxels).unwrap(), good).is_err());
    let localizer = NdtLocalizer::new(&map, good).unwrap();
    assert!(localizer.clone().with_places([]).is_err());
    assert!(localizer.with_places([at(f64::NAN, 0.0, 0.0)]).is_err());
}

/// Logs of real vehicles have clocks that stand, and that step back.
#[test]
fn a_clock_that_steps_back_does_no_harm() {
    let (mut localizer, place) = (room(), at(0.0, 0.0, 0.0));
    localizer.initialize(&around(place, 0.02)).unwrap();
    for (from, to) in [(5.0, 5.1), (5.1, 5.1), (3.0, 2.0), (2.0, 2.1), (2.3, 2.4), (2.4, 2.5)] {
        localizer.predict(&ahead(from, to, 0.0)).unwrap();
        let outcome = localizer.update(&seen(&ROOM, 10.0, 8, &place, Stamp::from_seconds(to)));
        assert!(
            matches!(outcome, Ok(UpdateOutcome::Applied(_) | UpdateOutcome::Skipped(SkipReason::Duplicate))),
            "{to}: {outcome:?}"
        );
        assert_eq!(localizer.alignment().map(|a| a.termination), Some(Termination::Converged));
    }
    assert!(error(&localizer, &place).norm() < 0.02);
}

/// At 5 m/s a cloud of 0.1 s ago lies half a metre behind, also if a motion was told of that took no time.
#[test]
fn a_motion_without_time_keeps_the_track() {
    let (mut localizer, place) = (room(), at(-2.0, 0.0, 0.0));
    localizer.initialize(&around(place, 0.02)).unwrap();
    for (from, to, x) in [(0.0, 0.1, 0.5), (0.1, 0.2, 0.5), (0.2, 0.2, 0.0), (0.15, 0.2, 0.0)] {
        localizer.predict(&ahead(from, to, x)).unwrap();
    }
    let cloud = |stamp: f64, x: f64| seen(&ROOM, 10.0, 8, &at(x, 0.0, 0.0), Stamp::from_seconds(stamp));
    assert!(matches!(localizer.update(&cloud(0.1, -1.5)), Ok(UpdateOutcome::Applied(_))));
    assert!(error(&localizer, &at(-1.0, 0.0, 0.0)).norm() < 0.02, "{}", error(&localizer, &at(-1.0, 0.0, 0.0)));

    // After the clock stepped back nothing is known of another time than that one.
    localizer.predict(&ahead(-5.0, -4.9, 0.0)).unwrap();
    let outcome = localizer.update(&cloud(0.15, -1.0));
    assert!(matches!(outcome, Ok(UpdateOutcome::Skipped(SkipReason::OutsideHistory { .. }))), "{outcome:?}");
    assert!(matches!(localizer.update(&cloud(-4.9, -1.0)), Ok(UpdateOutcome::Applied(_))));
}
