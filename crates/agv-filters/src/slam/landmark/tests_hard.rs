//! What goes wrong on the way: too little time, two sensors at once, sharp ranges by blunt odometry, strangers that look like twins.

use super::*;
use crate::graph::PoseGraphSolverParams;
use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, UncertainVector},
    odometry::OdometryIncrement,
    solve::RobustKernel,
    time::Stamp,
};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};

fn motion(start_from_end: Se2, sigmas: [f64; 3]) -> OdometryIncrement {
    let now = Stamp::default();
    let covariance = Matrix3::from_diagonal(&sigmas.map(|sigma| sigma * sigma).into());
    OdometryIncrement { start: now, end: now, start_from_end, covariance }
}

/// A place without noise.
fn place(id: Option<u32>, from: &Se2, at: Vector2<f64>, variance: f64) -> LandmarkSighting {
    let seen = UncertainVector::new(from.inverse().act(&at), Matrix2::identity() * variance).unwrap();
    LandmarkSighting::new(id, LandmarkReading::Place(seen))
}

/// Forty posts half a metre apart, and a vehicle that is lost by as much, with no time to look at many pairs.
#[test]
fn little_time_leaves_an_assignment_all_the_same() {
    let posts: Vec<_> = (0..40).map(|k| Vector2::new(0.5 * f64::from(k % 8), 0.5 * f64::from(k / 8))).collect();
    let matched = |association, joint_work| {
        let params = LandmarkSlamParams { association, joint_work, ..Default::default() };
        let mut slam = LandmarkSlam::new(params).unwrap();
        let look = |from: &Se2| posts.iter().map(|post| place(None, from, *post, 1e-4)).collect::<Vec<_>>();
        slam.update(&look(&Se2::default())).unwrap();
        slam.predict(&motion(Se2::default(), [0.3, 0.3, 0.05])).unwrap();
        slam.update(&look(&Se2::new(0.1, -0.1, 0.02))).unwrap().matched
    };
    for work in [32, 100, 2000] {
        assert!(matched(Association::Joint, work) > 20, "{work}: {}", matched(Association::Joint, work));
    }
}

/// A vehicle that may be off by more than two posts are apart sees one of them: it may be either. Both together can only be themselves.
#[test]
fn one_post_that_may_be_either_tells_nothing() {
    let posts = [Vector2::new(5.0, 0.0), Vector2::new(5.0, 1.0)];
    let matched = |lead, seen: usize| {
        let mut slam = LandmarkSlam::new(LandmarkSlamParams { lead, ..Default::default() }).unwrap();
        let look = |from: &Se2, seen: &[Vector2<f64>]| -> Vec<_> {
            seen.iter().map(|post| place(None, from, *post, 1e-4)).collect()
        };
        slam.update(&look(&Se2::default(), &posts)).unwrap();
        slam.predict(&motion(Se2::default(), [0.5, 0.5, 0.01])).unwrap();
        let update = slam.update(&look(&Se2::new(0.0, 0.3, 0.0), &posts[..seen])).unwrap();
        assert_eq!(update.matched + update.left_out, seen, "none of them is new");
        update.matched
    };
    assert_eq!([matched(0.0, 1), matched(9.21, 1), matched(9.21, 2)], [1, 0, 2]);
}

/// What may have been seen each time is not forgotten for not having been seen.
#[test]
fn doubtful_looks_are_no_misses() {
    let posts = [Vector2::new(5.0, 0.0), Vector2::new(5.0, 1.0)];
    let view = Some(SensorView { range: 10.0, half_angle: 3.0 });
    let mut slam = LandmarkSlam::new(LandmarkSlamParams { view, ..Default::default() }).unwrap();
    slam.update(&posts.map(|post| place(None, &Se2::default(), post, 1e-4))).unwrap();
    slam.predict(&motion(Se2::default(), [0.5, 0.5, 0.01])).unwrap();
    for _ in 0..20 {
        let update = slam.update(&[place(None, &Se2::new(0.0, 0.3, 0.0), posts[0], 1e-4)]).unwrap();
        assert_eq!((update.matched, update.left_out, update.removed), (0, 1, 0));
    }
    // Nothing is seen at all.
    assert_eq!((0..20).map(|_| slam.update(&[]).unwrap().removed).sum::<usize>(), 2);
}

/// Ranges that wait for their beacon's place are let go when something tells it, and none begin to wait that are of a place that is known.
#[test]
fn no_range_waits_for_a_place_that_is_known() {
    let beacon = Vector2::new(4.0, 3.0);
    let mut slam = LandmarkSlam::new(LandmarkSlamParams::default()).unwrap();
    for _ in 0..3 {
        let range = (beacon - slam.map_from_base().translation()).norm();
        slam.update(&[LandmarkSighting::new(Some(7), LandmarkReading::range(range, 0.1).unwrap())]).unwrap();
        slam.predict(&motion(Se2::new(0.5, 0.0, 0.0), [0.01, 0.01, 0.001])).unwrap();
    }
    assert!(slam.waiting.len() == 1 && !slam.state.points.is_empty());
    slam.update(&[place(Some(7), &slam.map_from_base(), beacon, 1e-2)]).unwrap();
    assert!(slam.waiting.is_empty() && slam.state.points.len() == 1, "no anchor is left behind");

    // Two antennas a step apart, one of which settles the place.
    let mut slam = LandmarkSlam::new(LandmarkSlamParams::default()).unwrap();
    for step in 0..80 {
        let pose = Se2::exp(&(Vector3::new(0.25, 0.0, 0.06) * f64::from(step)));
        let ranges = [-0.4, 0.4].map(|ahead| {
            let mount = Se2::new(ahead, 0.0, 0.0);
            let range = (beacon - pose.compose(&mount).translation()).norm();
            LandmarkSighting::new(Some(7), LandmarkReading::range(range, 0.05).unwrap()).with_mount(mount)
        });
        slam.update(&ranges).unwrap();
        slam.predict(&motion(Se2::exp(&Vector3::new(0.25, 0.0, 0.06)), [0.01, 0.01, 0.001])).unwrap();
    }
    assert!(slam.waiting.is_empty() && slam.state.points.len() == 1, "no anchor is left behind");
}

/// A lidar ahead and one behind, with one stamp.
#[test]
fn updates_without_a_motion_share_a_pose() {
    let posts = [Vector2::new(4.0, 2.0), Vector2::new(-3.0, 1.0)];
    let mut slam = LandmarkGraphSlam::new(LandmarkGraphSlamParams { interval: 0, ..Default::default() }).unwrap();
    let mut truth = Se2::default();
    for _ in 0..5 {
        for (id, post) in (0..).zip(posts) {
            slam.update(&[place(Some(id), &truth, post, 1e-4)]).unwrap();
        }
        truth = truth * Se2::new(0.5, 0.0, 0.1);
        slam.predict(&motion(Se2::new(0.5, 0.0, 0.1), [0.02, 0.01, 0.01])).unwrap();
    }
    assert_eq!((slam.graph().poses().len(), slam.graph().ties().len()), (5, 10));
    slam.finish().unwrap();
    assert_eq!(slam.landmarks().count(), 2);
}

/// Without odometry, three posts that all poses see say where all of them are beside the first.
#[test]
fn ties_alone_move_all_poses_but_one() {
    let posts = [Vector2::new(4.0, 2.0), Vector2::new(-3.0, 1.0), Vector2::new(1.0, -5.0)];
    let truths: Vec<_> = (0..4).map(|k| Se2::new(0.6 * f64::from(k), 0.1, 0.2 * f64::from(k))).collect();
    let mut graph = LandmarkGraph::new();
    let marks = posts.map(|post| graph.add_landmark(post + Vector2::new(0.1, -0.1)).unwrap());
    for (k, truth) in truths.iter().enumerate() {
        let off = if k == 0 { Se2::default() } else { Se2::new(0.2, -0.1, 0.1) };
        let pose = graph.add_pose(truth.compose(&off)).unwrap();
        for (landmark, post) in marks.into_iter().zip(posts) {
            let tie = Tie { pose, landmark, sighting: place(None, truth, post, 1e-4), kernel: RobustKernel::Square };
            graph.add_tie(tie).unwrap();
        }
    }
    let report = LandmarkGraphSolver::new(PoseGraphSolverParams::default()).unwrap().optimize(&mut graph).unwrap();
    assert!(report.cost < 1e-9, "{}", report.cost);
    for (pose, truth) in graph.poses().iter().zip(&truths) {
        assert!(pose.minus(truth).norm() < 1e-5, "{pose:?} {truth:?}");
    }
}

/// Ranges to two centimetres from places that odometry knows to decimetres beside each other: none of them is an outlier.
#[test]
fn sharp_ranges_wait_for_blunt_odometry() {
    let normal = |stream: &mut Stream| -> f64 { StandardNormal.sample(stream) };
    let beacon = Vector2::new(9.0, 10.0);
    let mut squares = Vec::new();
    for seed in 0..8 {
        let mut stream = Seed(seed).stream(0, 0);
        let params = LandmarkSlamParams::default();
        let (mut slam, mut truth, sigmas) = (LandmarkSlam::new(params).unwrap(), Se2::default(), [0.05, 0.02, 0.01]);
        for _ in 0..60 {
            let step = Se2::exp(&Vector3::new(1.0, 0.0, 0.12));
            truth = truth * step;
            let noise = Vector3::from(sigmas.map(|sigma| sigma * normal(&mut stream)));
            slam.predict(&motion(step.plus(&noise), sigmas)).unwrap();
            let range = (beacon - truth.translation()).norm() + 0.02 * normal(&mut stream);
            let seen = LandmarkSighting::new(Some(0), LandmarkReading::range(range, 0.02).unwrap());
            if slam.update(&[seen]).unwrap().added > 0 {
                break;
            }
        }
        let Some(found) = slam.landmarks().next() else { panic!("seed {seed}: never placed") };
        // Beside where the vehicle is: the map's own origin is exact, so the place's error is its own.
        let error = found.place.mean() - beacon;
        squares.push(error.dot(&(found.place.covariance().try_inverse().unwrap() * error)));
    }
    // Sixteen degrees of freedom at 99.99 %.
    assert!(squares.iter().sum::<f64>() < 44.0, "{squares:?}");
}

/// Out along one row of trees and back along the next, by odometry that could be off by more than they are apart.
#[test]
fn rows_that_are_never_one_stay_two() {
    for shift in [0.0, 1.0, 2.0] {
        let mut slam = LandmarkGraphSlam::new(LandmarkGraphSlamParams::default()).unwrap();
        let mut truth = Se2::default();
        let trees = |row: u32| {
            (0..8).map(move |k| {
                let x = 4.0 * f64::from(k) + f64::from(row) * shift;
                (100 * row + k, Vector2::new(x, if row == 0 { -1.0 } else { 4.0 }))
            })
        };
        for step in 0..62 {
            let row = u32::from(step > 30);
            let near = |(_, tree): &(u32, Vector2<f64>)| (tree - truth.translation()).norm() < 4.5;
            let seen: Vec<_> = trees(row).filter(near).map(|(id, tree)| place(Some(id), &truth, tree, 1e-3)).collect();
            slam.update(&seen).unwrap();
            let go = if step == 30 { Se2::new(0.0, 3.0, std::f64::consts::PI) } else { Se2::new(1.0, 0.0, 0.0) };
            truth = truth * go;
            slam.predict(&motion(go, if step == 30 { [3.0, 3.0, 0.05] } else { [0.05, 0.05, 0.005] })).unwrap();
        }
        assert_eq!(slam.finish().unwrap(), 0, "{shift}");
        assert_eq!(slam.landmarks().count(), 16, "{shift}");
    }
}
