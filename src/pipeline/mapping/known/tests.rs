use super::*;
use crate::pipeline::mapping::{KeyFrameMapper, KeyFrameParams, KeyFrameStep, LoopParams, closures::closure};
use agv_core::{
    geometry::Se2,
    nalgebra::{SMatrix, Vector3},
    roles::{Alignment, AlignmentError, LidarOdometryStep, Registration, Termination},
    sensors::{PointCloud, PointSource},
    time::Stamp,
};
use agv_filters::graph::{PoseGraphSolver, PoseGraphSolverParams};

/// Finds every cloud where it is sought, but for those that are sought aside.
struct Lane;

impl Registration for Lane {
    fn set_target(&mut self, _: &dyn PointSource) -> Result<(), AlignmentError> {
        Ok(())
    }

    fn align(&mut self, _: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        let mut found = Alignment::unknown(*guess, Termination::Converged);
        found.information = Matrix6::identity() * 1e4;
        found.unobserved = Matrix6::zeros();
        found.inlier_ratio = if guess.translation().y.abs() < 0.5 { 1.0 } else { 0.0 };
        Ok(found)
    }
}

fn at(x: f64, y: f64) -> Se3 {
    Se2::new(x, y, 0.0).into()
}

fn mapper() -> KeyFrameMapper<Lane> {
    let params = KeyFrameParams { loops: LoopParams { min_way: 8.0, ..Default::default() }, ..Default::default() };
    KeyFrameMapper::new(Lane, params).unwrap()
}

/// A second later there.
fn go(mapper: &mut KeyFrameMapper<Lane>, pose: Se3) -> KeyFrameStep {
    let cloud = PointCloud::from_points((0..2000_u16).map(|i| {
        let (a, b) = (f32::from(i % 50), f32::from(i / 50));
        Vector3::new(0.2 * a - 5.0, 0.2 * b - 4.0, 1.0 + (0.7 * a).sin())
    }));
    let stamp = Stamp::from_seconds(mapper.map().trajectory().len() as f64);
    mapper.process(&LidarOdometryStep { odom_from_base: pose, alignment: None }, &cloud.with_stamp(stamp)).unwrap()
}

/// Nine metres out and three back: to where key frame 5 is met next.
fn out_and_back(mapper: &mut KeyFrameMapper<Lane>) {
    for x in (0..10).chain((6..9).rev()) {
        assert_eq!(go(mapper, at(f64::from(x), 0.0)).met, None);
    }
    assert_eq!(mapper.map().keys.len(), 13);
}

/// As far, and one metre on, where key frame 5 is met, and aside from there.
fn driven(mapper: &mut KeyFrameMapper<Lane>, aside: f64) -> [Se3; 4] {
    out_and_back(mapper);
    let met = go(mapper, at(5.0, 0.0));
    assert_eq!((met.key, met.met), (None, Some(5)));
    assert_eq!(go(mapper, at(5.0, aside)).key, Some(13));
    [at(5.0, 0.0), at(6.0, 0.0), at(5.0, aside), at(5.0, 0.0)]
}

/// Information about four poses from relations whose residuals are zero.
fn joint(poses: &[Se3; 4], relations: &[(usize, usize, Matrix6<f64>)]) -> SMatrix<f64, 24, 24> {
    let mut sum = SMatrix::<f64, 24, 24>::zeros();
    for (from, to, information) in relations {
        let (by_from, by_to) = poses[*from].between_jacobians(&poses[*to]);
        for (i, a) in [(*from, by_from), (*to, by_to)] {
            for (j, b) in [(*from, by_from), (*to, by_to)] {
                let mut block = sum.fixed_view_mut::<6, 6>(6 * i, 6 * j);
                block += a.transpose() * information * b;
            }
        }
    }
    sum
}

/// Of the way back, the find and the way aside the graph knows no more than what a graph knows that has each of them
/// once; and not much less.
#[test]
fn what_was_found_counts_once() {
    let mut mapper = mapper();
    let params = *mapper.map().params();
    // Key frames 5, 12 and 13, and where the one was that was not kept.
    let poses = driven(&mut mapper, 1.5);
    let number = |key: u32| [5, 12, 13].iter().position(|kept| *kept == key);
    let told = mapper
        .map()
        .relations()
        .iter()
        .filter_map(|relation| Some((number(relation.from.0)?, number(relation.to.0)?, relation.information)));
    let told: Vec<_> = told.collect();
    assert_eq!(told.len(), 3);
    // Of the second and the third relative to the first.
    let told = joint(&poses, &told).fixed_view::<12, 12>(6, 6).into_owned();
    let way = |from: usize, to: usize| {
        let covariance = *params.drift.of(&poses[from].between(&poses[to]), None).covariance();
        (from, to, Se3::inverse_of(&covariance).unwrap())
    };
    let found = Lane.align(&PointCloud::default(), &Se3::identity()).unwrap();
    let find = closure(&found, 0, 3, &params).unwrap();
    let known = joint(&poses, &[way(1, 3), (0, 3, find.information), way(3, 2)]);
    // Without the pose that was not kept.
    let (own, cross) = (known.fixed_view::<6, 6>(18, 18).into_owned(), known.fixed_view::<12, 6>(6, 18).into_owned());
    let known = known.fixed_view::<12, 12>(6, 6) - cross * own.try_inverse().unwrap() * cross.transpose();
    let root = known.cholesky().unwrap().l().try_inverse().unwrap();
    let shares = (root * told * root.transpose()).symmetric_eigenvalues();
    assert!(shares.max() < 1.0 + 1e-6 && shares.min() > 0.4, "{shares}");
}

/// A find that is taken out leaves the key frame after it where odometry says.
#[test]
fn odometry_holds_what_a_find_held() {
    let mut mapper = mapper();
    driven(&mut mapper, 1.5);
    let mut map = mapper.into_map();
    let of_odometry = |relation: &&Relation<Se3>| relation.to.0 == 13 && !is_find(relation);
    let held: Vec<_> = map.relations().iter().filter(of_odometry).collect();
    let [held] = held[..] else { panic!("{held:?}") };
    let off = held.from_from_to.between(&at(-1.0, 1.5)).log();
    assert!(held.from.0 == 12 && off.norm() < 1e-9, "{held:?}");
    // As if the vehicle had been farther back than where it was found.
    let mut solver = PoseGraphSolver::new(PoseGraphSolverParams::default()).unwrap();
    let mut off = |map: &mut KeyFrameMap| {
        solver.optimize(&mut map.graph).unwrap();
        map.graph.poses()[13].between(&at(5.0, 1.5)).log().norm()
    };
    assert!(off(&mut map) < 1e-6);
    let finds: Vec<_> = map.relations().iter().copied().filter(is_find).collect();
    map.graph.retain_relations(|relation| !is_find(relation));
    for find in &finds {
        let from_from_to = at(0.3, 0.0).compose(&find.from_from_to);
        map.graph.add_relation(Relation { from_from_to, ..*find }).unwrap();
    }
    assert!(off(&mut map) > 0.1, "the finds held it elsewhere");
    map.graph.retain_relations(|relation| !is_find(relation));
    assert!(off(&mut map) < 1e-6, "{:?}", map.graph.poses()[13]);
}

/// Neighbours of one drive are related; odometry over a long way does not keep a find from relating its ends.
#[test]
fn key_frames_are_related_by_finds_and_short_ways() {
    let mut mapper = mapper();
    driven(&mut mapper, 1.5);
    let mut map = mapper.into_map();
    assert!(map.is_related(13, 12) && map.is_related(5, 12) && !map.is_related(13, 4));
    map.keys[13].way += 100.0;
    assert!(!map.is_related(12, 13) && map.is_related(5, 13));
}

/// A find that claims another pose of a key frame than the graph has.
fn claim(map: &KeyFrameMap, from: u32, to: u32, map_from_to: &Se3) -> Closure {
    let information = Matrix6::identity() * 1e4;
    let (from_from_to, unobserved) = (map.graph.poses()[from as usize].between(map_from_to), Matrix6::zeros());
    Closure { from, to, from_from_to, information, inlier_ratio: 0.9, unobserved }
}

/// What ties a key frame to the one that was met before it is the way between them: it confirms no find of the one at
/// the other.
#[test]
fn a_find_waits_though_the_way_relates_its_key_frames() {
    let mut mapper = mapper();
    driven(&mut mapper, 1.5);
    for x in [4.0, 3.0] {
        assert!(go(&mut mapper, at(x, 1.5)).key.is_some());
    }
    let mut map = mapper.into_map();
    assert!(map.relations().iter().any(|relation| (relation.from.0, relation.to.0) == (5, 13) && is_find(relation)));
    let finds = [(5, 13, 5.0), (4, 14, 4.0), (3, 15, 3.0)].map(|(from, to, x)| claim(&map, from, to, &at(x, 2.5)));
    assert!(map.believed(&finds[0]).is_empty() && map.believed(&finds[1]).is_empty());
    assert_eq!(map.pending, finds[..2]);
    assert_eq!(map.believed(&finds[2]), finds);
}

/// Where a meet relates two key frames, a find of the same two waits no more; others do.
#[test]
fn a_meet_ends_the_waiting_of_finds_that_it_makes_up_for() {
    let mut mapper = mapper();
    out_and_back(&mut mapper);
    let mut map = mapper.into_map();
    let [same, other] = [5, 4].map(|from| claim(&map, from, 12, &at(6.0, 2.0)));
    map.pending = vec![same, other];
    let mut mapper = KeyFrameMapper::resume(Lane, map).unwrap();
    assert_eq!(go(&mut mapper, at(5.0, 0.0)).met, Some(5));
    assert_eq!(mapper.map().pending, [other]);
}
