use super::*;
use crate::Error;
use agv_core::{
    geometry::{LieGroup, PoseSigma, Se2, Se3, So3},
    nalgebra::{Matrix6, Vector3, Vector6},
    roles::{Alignment, AlignmentError, LidarOdometryStep, Registration, Termination},
    sensors::{PointCloud, PointSource},
    time::Stamp,
};
use agv_filters::graph::PoseId;
use agv_ndt::{
    ndt::{NdtParams, NdtRegistration, VoxelParams},
    places::ScanContextParams,
};

/// Points on floor and walls of a room, on no lattice, seen from a pose.
fn seen(map_from_base: &Se3, seconds: f64) -> PointCloud {
    let spread = |i: u32, step: f64| (f64::from(i) * step).fract();
    let points = (0..4000).flat_map(|i| {
        let (a, b) = (spread(i, 0.754_877_666_246_7), spread(i, 0.569_840_290_998_1));
        [[14.0 * a, 9.0 * b, 0.0], [14.0 * a, 0.0, 3.0 * b], [14.0, 9.0 * a, 3.0 * b], [4.0 + 2.0 * a, 6.0, 2.0 * b]]
    });
    let base_from_map = map_from_base.inverse();
    PointCloud::from_points(points.map(|p| base_from_map.act(&Vector3::from(p)).cast()))
        .with_stamp(Stamp::from_seconds(seconds))
}

fn step(pose: Se3) -> LidarOdometryStep {
    LidarOdometryStep { odom_from_base: pose, alignment: None }
}

fn at(x: f64) -> Se3 {
    Se2::new(x, 0.0, 0.0).into()
}

/// What ties key frames together is what odometry said, all of it and no more; and finds, which are where the truth
/// says. The clouds' stamps are their numbers; `drive` gives truth and odometry of each.
fn check_relations(map: &KeyFrameMap, drive: impl Fn(i32) -> (Se3, Se3)) {
    let number = |key: PoseId| map.keys[key.index()].cloud().stamp().seconds().round() as i32;
    let mut finds = 0;
    for relation in map.relations() {
        let [(true_a, a), (true_b, b)] = [relation.from, relation.to].map(|key| drive(number(key)));
        let is_find = closures::is_find(relation);
        let (expected, limit) = if is_find { (true_a.between(&true_b), 0.1) } else { (a.between(&b), 1e-9) };
        let off = expected.between(&relation.from_from_to).log();
        assert!(off.norm() < limit, "{relation:?}: {off}");
        finds += usize::from(is_find);
    }
    assert!(map.closures().len() > 0 && map.closures().len() <= finds);
    // Odometry alone ties each key frame to the one before, whatever finds are taken out.
    let tied = |key: u32| {
        let of_odometry = map.relations().iter().filter(|relation| !closures::is_find(relation));
        of_odometry.filter(|relation| (relation.from.0 + 1, relation.to.0) == (key, key)).count()
    };
    assert!((1..map.keys.len() as u32).all(|key| tied(key) == 1));
}

fn mapper(params: &KeyFrameParams) -> KeyFrameMapper<NdtRegistration> {
    KeyFrameMapper::new(NdtRegistration::new(NdtParams::default()).unwrap(), *params).unwrap()
}

#[test]
fn key_frames_follow_the_motion() {
    let start = Se3::from(Se2::new(2.0, 3.0, 0.3));
    let params = KeyFrameParams { time: Some(5.0), ..KeyFrameParams::default() };
    let mut mapper = mapper(&params);
    let mut go =
        |pose: Se3, seconds: f64| mapper.process(&step(pose), &seen(&start.compose(&pose), seconds)).unwrap().key;
    assert_eq!(go(at(0.0), 0.0), Some(0));
    assert_eq!(go(at(0.0), 100.0), None, "standing still makes none");
    assert_eq!(go(at(0.9), 101.0), Some(1), "some way, and late");
    assert_eq!(go(at(1.4), 102.0), None);
    assert_eq!(go(at(2.0), 103.0), Some(2));
    assert_eq!(go(at(2.0).compose(&Se2::new(0.0, 0.0, 0.4).into()), 103.0), Some(3), "of the same time, turned");
    let map = mapper.into_map();
    assert_eq!((map.key_frames().len(), map.trajectory().len(), map.closures().len()), (4, 6, 0));
    let poses: Vec<_> = map.trajectory().map(|(_, pose)| pose.translation().x).collect();
    assert!(poses.iter().zip([0.0, 0.0, 0.9, 1.4, 2.0, 2.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{poses:?}");
    assert!(map.key_frames().all(|(key, _)| key.cloud().len() <= params.max_points));
}

/// To the end of the room and back, with an odometry that is a third of a metre off by then: three key frames say so.
#[test]
fn a_place_that_is_met_again_corrects_the_way() {
    let params = KeyFrameParams { loops: LoopParams { min_way: 8.0, ..Default::default() }, ..Default::default() };
    let mut mapper = mapper(&params);
    let (start, mut closures, mut last) = (Se3::from(Se2::new(2.0, 3.0, 0.0)), 0, None);
    for i in 0..20_i32 {
        let x = f64::from(if i < 10 { i } else { 18 - i }).max(0.0);
        let aside = 0.02 * f64::from(i);
        let before: Vec<Se3> = mapper.map().key_frames().map(|(_, pose)| *pose).collect();
        let made = mapper.process(&step(Se2::new(x, aside, 0.0).into()), &seen(&start.compose(&at(x)), f64::from(i)));
        let made = made.unwrap();
        let moved = mapper.map().key_frames().zip(&before).any(|((_, pose), before)| pose != before);
        assert!(made.corrected || !moved, "poses of the map moved unsaid");
        closures += made.closures;
        last = Some(made);
    }
    let last = last.unwrap();
    // The last find may be two steps ago, each of which the odometry is two centimetres off.
    assert!(closures >= 3 && last.map_from_base.translation().norm() < 0.06, "{closures} {last:?}");
    assert!((last.map_from_odom.translation().y + 0.36).abs() < 0.06, "{last:?}");
    let wave = |i: i32| f64::from(if i < 10 { i } else { 18 - i }).max(0.0);
    check_relations(mapper.map(), |i| (at(wave(i)), Se2::new(wave(i), 0.02 * f64::from(i), 0.0).into()));
    let cloud = mapper.map().thinned_cloud(0.2).unwrap();
    let walls: Vec<_> = cloud.points().filter(|p| p.z > 0.5 && p.y < -2.8).collect();
    assert!(walls.len() > 300 && walls.iter().all(|p| (p.y + 3.0).abs() < 0.15), "one wall, not two");
    assert!(mapper.map().tiles(VoxelParams::default(), 8).unwrap().loaded().count() >= 4);
}

/// To and fro day after day: in the end there are no more key frames, relations or finds that wait, and the vehicle is
/// where it is, however much the odometry errs. With all key frames kept, their number is that of the metres.
#[test]
fn a_known_site_gets_no_more_key_frames() {
    let loops = LoopParams { min_way: 8.0, ..Default::default() };
    let bounded = KeyFrameParams { loops, ..Default::default() };
    for params in [bounded, KeyFrameParams { reach: None, ..bounded }] {
        let mut mapper = mapper(&params);
        let (start, mut met, mut sizes) = (Se3::from(Se2::new(2.0, 3.0, 0.0)), 0, Vec::new());
        for i in 0..144_i32 {
            let x = f64::from((i % 18 - 9).abs());
            let odometry = Se2::new(x, 0.02 * f64::from(i), 0.0);
            let seen = seen(&start.compose(&at(x)), f64::from(i));
            let made = mapper.process(&step(odometry.into()), &seen).unwrap();
            assert!(made.met.is_none() || made.key.is_none());
            met += usize::from(made.met.is_some());
            let off = made.map_from_base.translation() - at(x).translation();
            assert!(i < 18 || off.norm() < 0.1, "{i}: {off}");
            if i % 18 == 17 {
                let map = mapper.map();
                sizes.push((map.key_frames().len(), map.relations().len(), map.pending.len()));
            }
        }
        if params.reach.is_some() {
            // Ten places a metre apart, which are met from both sides.
            assert!(met >= 80 && sizes[7].0 <= 20 && sizes[7] == sizes[5] && sizes[7].2 == 0, "{met} {sizes:?}");
        } else {
            assert!(met == 0 && sizes[7].0 == 144, "{met} {sizes:?}");
        }
        let wave = |i: i32| f64::from((i % 18 - 9).abs());
        check_relations(mapper.map(), |i| (at(wave(i)), Se2::new(wave(i), 0.02 * f64::from(i), 0.0).into()));
        assert_eq!(mapper.map().trajectory().len(), 144);
        assert_eq!(mapper.map().places.len(), mapper.map().keys.len());
    }
}

/// Of a lidar that is covered at first.
#[test]
fn the_way_before_the_first_key_frame_is_kept() {
    let mut mapper = mapper(&KeyFrameParams::default());
    for i in 0..5_i32 {
        let x = f64::from(i);
        let cloud = if i < 2 { PointCloud::default() } else { seen(&at(3.0 + x), x) };
        let made = mapper.process(&step(at(x)), &cloud.with_stamp(Stamp::from_seconds(x))).unwrap();
        assert_eq!(made.key.is_some(), i >= 2);
    }
    let poses: Vec<_> = mapper.map().trajectory().map(|(_, pose)| pose.translation().x).collect();
    assert!(poses.iter().enumerate().all(|(i, x)| (x - i as f64).abs() < 1e-9), "{poses:?}");
}

/// Finds every cloud where it is sought, as a bare corridor does.
struct Corridor;

impl Registration for Corridor {
    fn set_target(&mut self, _: &dyn PointSource) -> Result<(), AlignmentError> {
        Ok(())
    }

    fn align(&mut self, _: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        let mut found = Alignment::unknown(*guess, Termination::Degenerate);
        let axis = Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        found.unobserved = axis * axis.transpose();
        found.information = (Matrix6::identity() - found.unobserved) * 1e4;
        found.inlier_ratio = 1.0;
        Ok(found)
    }
}

/// To and fro: finds that leave the way open take no doubt about it, and do not contradict each other along it.
#[test]
fn a_corridor_closes_no_loop_along_itself() {
    let params = KeyFrameParams { loops: LoopParams { min_way: 8.0, ..Default::default() }, ..Default::default() };
    let mut mapper = KeyFrameMapper::new(Corridor, params).unwrap();
    let mut closures = 0;
    for i in 0..20_i32 {
        let x = f64::from(if i < 10 { i } else { 18 - i }).max(0.0);
        closures += mapper.process(&step(at(x)), &seen(&at(3.0 + x), f64::from(i))).unwrap().closures;
    }
    let map = mapper.map();
    assert!(closures > 0 && map.doubt > 0.5, "{closures} {}", map.doubt);
    let unobserved = Corridor.align(&PointCloud::default(), &Se3::identity()).unwrap().unobserved;
    let to = map.keys.len() as u32 - 1;
    let find = |x: f64, y: f64, unobserved: Matrix6<f64>, inlier_ratio: f64| closures::Closure {
        from: 0,
        to,
        from_from_to: Se2::new(x, y, 0.0).into(),
        information: Matrix6::identity(),
        inlier_ratio,
        unobserved,
    };
    let (along, aside) = (find(1.0, 0.0, unobserved, 0.9), find(0.0, 1.0, unobserved, 0.9));
    let (open, whole) = (find(0.0, 0.0, unobserved, 0.95), find(3.0, 0.0, Matrix6::zeros(), 0.9));
    assert_eq!(map.unambiguous(&[open, along]), Some(open));
    assert_eq!(map.unambiguous(&[open, aside]), None);
    assert_eq!(map.unambiguous(&[open, whole, along]), Some(whole));
    assert!(!map.is_expected(&find(0.0, 0.0, unobserved, 0.9)));
    assert!(map.is_expected(&closures::Closure { from_from_to: map.map_from_base(), ..whole }));
}

/// A wall that a sweep passes in a turn comes out flat.
#[test]
fn clouds_are_straightened_by_the_motion() {
    let moved = |seconds: f64| Se3::exp(&(Vector6::new(1.0, 0.2, 0.0, 0.0, 0.0, 0.8) * seconds));
    let mut mapper = mapper(&KeyFrameParams::default());
    for seconds in [0.0, 1.0] {
        let times: Vec<f32> = (0..400_u16).map(|i| f32::from(i) * 0.000_25).collect();
        let points = (0..400_u16).map(|i| {
            let at_the_wall = Vector3::new(10.0, f64::from(i) * 0.025 - 5.0, 1.0 + f64::from(i % 7) * 0.3);
            moved(seconds + f64::from(i) * 0.000_25).inverse().act(&at_the_wall).cast::<f32>()
        });
        let cloud = PointCloud::from_points(points).with_time(times).unwrap();
        mapper.process(&step(moved(seconds)), &cloud.with_stamp(Stamp::from_seconds(seconds))).unwrap();
    }
    let (key, pose) = mapper.map().key_frames().nth(1).unwrap();
    let off = key.cloud().points().map(|p| (pose.act(&p.cast::<f64>()).x - 10.0).abs()).fold(0.0, f64::max);
    assert!(key.cloud().len() > 100 && off < 0.01, "{off}");
}

/// Along a corridor that hides the way, odometry is believed less, and along it only.
#[test]
fn what_clouds_do_not_see_is_left_open() {
    let drift = LidarDrift::default();
    let mut found = Alignment::unknown(Se3::default(), Termination::Degenerate);
    let axis = Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    found.unobserved = axis * axis.transpose();
    let [clear, hidden] = [None, Some(&found)].map(|found| *drift.of(&at(1.0), found).covariance());
    assert!((hidden[(0, 0)] - clear[(0, 0)] - 0.09).abs() < 1e-9 && hidden[(1, 1)] == clear[(1, 1)]);
    found.termination = Termination::PoorFit;
    let lost = *drift.of(&at(1.0), Some(&found)).covariance();
    assert!((lost[(1, 1)] - clear[(1, 1)] - 0.09).abs() < 1e-9, "{lost}");
    assert_eq!(*drift.of(&Se3::identity(), None).covariance(), Matrix6::zeros(), "standing still is known");
    found.unobserved = Matrix6::repeat(f64::NAN);
    found.termination = Termination::Converged;
    assert!(drift.of(&at(1.0), Some(&found)).covariance().iter().all(|entry| entry.is_finite()));
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let mut mapper = mapper(&KeyFrameParams::default());
    for i in 0..3 {
        mapper.process(&step(at(f64::from(i))), &seen(&at(3.0 + f64::from(i)), f64::from(i))).unwrap();
    }
    let before = mapper.map().clone();
    let cloud = seen(&at(6.0), 3.0);
    for bad in [f64::NAN, f64::INFINITY] {
        let nowhere = Se3::from_parts(Vector3::new(bad, 0.0, 0.0), So3::default());
        assert!(mapper.process(&step(nowhere), &cloud).is_err());
        let spun = Se3::from_parts(Vector3::zeros(), So3::from_roll_pitch_yaw(bad, 0.0, 0.0));
        assert!(mapper.process(&step(spun), &cloud).is_err());
    }
    let early = mapper.process(&step(at(3.0)), &seen(&at(6.0), 1.5));
    assert!(matches!(early, Err(Error::Core(agv_core::Error::TimeBackwards { .. }))));
    assert!(*mapper.map() == before);
    // Clouds that show nothing make no key frames; the way goes on.
    let unseen = PointCloud::from_points((0..500).map(|_| Vector3::repeat(f32::NAN)));
    for (i, blind) in [PointCloud::default(), unseen].into_iter().enumerate() {
        let (x, seconds) = (4.0 + i as f64, 4.0 + i as f64);
        let made = mapper.process(&step(at(x)), &blind.with_stamp(Stamp::from_seconds(seconds))).unwrap();
        assert!(made.key.is_none() && (made.map_from_base.translation().x - x).abs() < 1e-9);
    }
    assert_eq!(mapper.map().key_frames().len(), 3);
    assert!(mapper.map().thinned_cloud(0.0).is_err() && mapper.map().tiles(VoxelParams::default(), 0).is_err());
}

#[test]
fn bad_parameters_are_named() {
    let good = KeyFrameParams::default();
    assert_eq!(good.validate(), Ok(()));
    let loops = |change: fn(&mut LoopParams)| {
        let mut params = good;
        change(&mut params.loops);
        params
    };
    let none = PoseSigma { translation: 0.0, rotation: 0.1 };
    for bad in [
        KeyFrameParams { distance: 0.0, ..good },
        KeyFrameParams { turn: f64::NAN, ..good },
        KeyFrameParams { time: Some(0.0), ..good },
        KeyFrameParams { reach: Some(none), ..good },
        KeyFrameParams { min_range: -1.0, ..good },
        KeyFrameParams { min_range: 61.0, ..good },
        KeyFrameParams { max_range: f64::INFINITY, ..good },
        KeyFrameParams { leaf: 0.0, ..good },
        KeyFrameParams { source_leaf: 0.05, ..good },
        KeyFrameParams { min_points: 9, ..good },
        KeyFrameParams { max_points: 99, ..good },
        KeyFrameParams { drift: LidarDrift { floor: none, ..good.drift }, ..good },
        KeyFrameParams { drift: LidarDrift { unobserved: none, ..good.drift }, ..good },
        KeyFrameParams { places: ScanContextParams { rings: 0, ..good.places }, ..good },
        loops(|loops| loops.min_way = -1.0),
        loops(|loops| loops.least_window = f64::NAN),
        loops(|loops| loops.growth = -0.1),
        loops(|loops| loops.window = 0.5),
        loops(|loops| loops.max_distance = 1.1),
        loops(|loops| loops.min_inlier_ratio = -0.1),
        loops(|loops| loops.margin = f64::NAN),
        loops(|loops| loops.neighbours = usize::MAX),
        loops(|loops| loops.candidates = 101),
        loops(|loops| loops.look_alikes = 101),
        loops(|loops| loops.confirmations = 0),
        loops(|loops| loops.agreement.rotation = 0.0),
        loops(|loops| loops.gate = 0.0),
        loops(|loops| loops.floor.translation = f64::INFINITY),
    ] {
        assert!(KeyFrameMap::new(bad).is_err(), "{bad:?}");
    }
}
