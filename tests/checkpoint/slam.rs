//! Maps in the making: killed, and resumed from a text.

use crate::{
    scenes::{
        circle, landmarks,
        mapping::{graph_slam, map_by_graph, map_by_particles, particle_slam},
    },
    table::{assert_kept, assert_refused, restored},
};
use agv_nav::core::{
    compute::Par,
    geometry::{LieGroup, Se2},
    grid::OccupancyThresholds,
    solve::RobustKernel,
};
use agv_nav::filters::slam::landmark::{LandmarkGraphSlam, LandmarkGraphSlamParams, LandmarkSlamParams};
use serde_json::json;

/// Killed before its loop is closed, and after.
#[test]
fn graph_slam_goes_on_with_the_same_bits() {
    let drive = circle(150);
    let mut whole = graph_slam(Par::Seq);
    assert!(map_by_graph(&mut whole, &drive, 0) > 0, "the drive must close loops");
    for at in [61, 140] {
        let mut killed = graph_slam(Par::Seq);
        map_by_graph(&mut killed, &drive[..at], 0);
        // Threads are no part of the state.
        let mut resumed = restored(&killed).with_parallelism(Par::threads(2));
        map_by_graph(&mut resumed, &drive, at);
        assert!(resumed.trajectory().eq(whole.trajectory()), "{at}");
        assert!(resumed.map().unwrap() == whole.map().unwrap(), "{at}");
        assert_eq!(serde_json::to_string(&resumed).unwrap(), serde_json::to_string(&whole).unwrap(), "{at}");
    }
}

#[test]
fn particles_with_maps_go_on_with_the_same_bits() {
    let drive = circle(40);
    for with_wheels in [true, false] {
        let mut whole = particle_slam(Par::Seq);
        assert!(map_by_particles(&mut whole, &drive, with_wheels) > 0, "the drive must exercise resampling");
        let mut killed = particle_slam(Par::Seq);
        map_by_particles(&mut killed, &drive[..23], with_wheels);
        let mut resumed = particle_slam(Par::threads(2));
        resumed.restore(&restored(&killed.checkpoint())).unwrap();
        map_by_particles(&mut resumed, &drive[23..], with_wheels);
        assert!(resumed.trajectory() == whole.trajectory() && resumed.weights() == whole.weights());
        let maps = [&whole, &resumed].map(|slam| slam.fused_map(&OccupancyThresholds::default()).unwrap());
        assert!(maps[0] == maps[1]);
        let texts = [&whole, &resumed].map(|slam| serde_json::to_string(&slam.checkpoint()).unwrap());
        assert!(texts[0] == texts[1]);
    }
}

/// Another day: the map comes from a text, the vehicle is found in it, follows it without changing it, and then adds to it.
#[test]
fn a_map_is_loaded_localised_in_and_gone_on_with() {
    let drive = circle(150);
    let mut first = graph_slam(Par::Seq);
    map_by_graph(&mut first, &drive[..110], 0);
    let truth = |i: usize| drive[1..=i].iter().fold(Se2::identity(), |pose, step| pose * step.0.start_from_end);

    let (mut slam, keys) = (restored(&first), first.keys());
    slam.set_frozen(true).unwrap();
    let guess = truth(110) * Se2::new(0.3, -0.2, 0.2);
    assert!(slam.relocate(&drive[110].1, Some(&guess)).unwrap().is_some());
    for (i, (_, scan)) in drive.iter().enumerate().take(130).skip(110) {
        let step = slam.process(scan, Some(&truth(i))).unwrap();
        let off = truth(i).between(&step.map_from_base);
        assert!(off.translation().norm() < 0.1 && off.yaw().abs() < 0.05, "{off:?}");
    }
    assert_eq!(slam.keys(), keys);
    let map = slam.map().unwrap();
    assert!(map == first.map().unwrap());

    let mut slam = restored(&slam);
    slam.set_frozen(false).unwrap();
    for (i, (_, scan)) in drive.iter().enumerate().skip(130) {
        slam.process(scan, Some(&truth(i))).unwrap();
    }
    assert!(slam.keys() > keys + 3);
    let off = truth(149).between(&slam.map_from_base());
    assert!(off.translation().norm() < 0.1 && off.yaw().abs() < 0.05, "{off:?}");
}

/// Nothing as it is by default.
fn landmark_graph() -> LandmarkGraphSlam {
    let front = LandmarkSlamParams { confirmations: 2, range_scale_sigma: 0.01, ..Default::default() };
    let params = LandmarkGraphSlamParams {
        front,
        kernel: RobustKernel::Huber { scale: 1.5 },
        interval: 40,
        merge_probability: 0.9,
        least_sigmas: [2e-3, 2e-4],
    };
    LandmarkGraphSlam::new(params).unwrap()
}

/// Killed between a motion and its sightings: with a beacon that waits for its place, between two corrections, and at one.
#[test]
fn landmark_graphs_go_on_with_the_same_bits() {
    let looks = landmarks::rounds(130);
    let go_on = |slam: &mut LandmarkGraphSlam, mut from: usize, mid_motion: bool, to: usize| {
        if mid_motion {
            slam.update(&looks[from].1).unwrap();
            from += 1;
        }
        for (odometry, seen) in &looks[from..to] {
            slam.predict(odometry).unwrap();
            slam.update(seen).unwrap();
        }
    };
    let mut whole = landmark_graph();
    go_on(&mut whole, 0, false, looks.len());
    let end = serde_json::to_string(&whole).unwrap();
    let merged = whole.finish().unwrap();
    for stop in [0, 3, 60, 79, 80, 125] {
        let mut killed = landmark_graph();
        go_on(&mut killed, 0, false, stop);
        killed.predict(&looks[stop].0).unwrap();
        let mut resumed = restored(&killed);
        assert_eq!(resumed.place(), killed.place(), "{stop}");
        go_on(&mut resumed, stop, true, looks.len());
        assert!(serde_json::to_string(&resumed).unwrap() == end, "{stop}");
        assert_eq!(resumed.finish().unwrap(), merged, "{stop}");
        assert!(resumed.graph() == whole.graph(), "{stop}");
        assert!(resumed.landmarks().eq(whole.landmarks()), "{stop}");
    }
}

#[test]
fn spoilt_landmark_graphs_are_refused() {
    let mut slam = landmark_graph();
    for (odometry, seen) in landmarks::rounds(6) {
        slam.update(&seen).unwrap();
        slam.predict(&odometry).unwrap();
    }
    assert_kept("LandmarkGraphSlam", &slam);
    assert_refused(
        "LandmarkGraphSlam",
        &slam,
        &[
            ("/params/merge_probability", json!(1.0)),
            ("/params/least_sigmas/0", json!(0.0)),
            ("/params/kernel", json!({ "Huber": { "scale": -1.0 } })),
            ("/front/params/gate_probability", json!(1.5)),
            ("/front/next", json!(0)),
            ("/graph/range_scale", json!(-1.0)),
            ("/graph/landmarks", json!([])),
            ("/graph/ties/0/pose", json!(1000)),
            ("/graph/ties/0/landmark", json!(1000)),
            ("/graph/ties/0/pose", json!(5)),
            ("/graph/poses/relations", json!([])),
            ("/graph/poses/relations/1/to", json!(0)),
            ("/of_key", json!({ "0": 1000 })),
            ("/of_key", json!({ "1000": 0 })),
            ("/motion/covariance/0", json!(-1.0)),
            ("/since", json!(7)),
        ],
    );
}
