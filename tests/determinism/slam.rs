//! Maps that are made on the way.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes,
};
use agv_nav::{
    core::geometry::Se2,
    filters::slam::{
        graph::{GraphSlam, GraphSlamParams},
        landmark::{LandmarkGraphSlam, LandmarkGraphSlamParams},
    },
};

#[test]
fn graph_slam() {
    // More than once around, so that loops are closed.
    let drive = scenes::circle(150);
    assert_same_bits("GraphSlam", |par| {
        let mut slam = GraphSlam::new(GraphSlamParams::default()).unwrap().with_parallelism(par);
        let mut odometry = Se2::default();
        for (motion, scan) in &drive {
            odometry = odometry * motion.start_from_end * Se2::new(0.002, 0.0, 0.001);
            slam.process(scan, Some(&odometry)).unwrap();
        }
        let poses: Vec<Se2> = slam.trajectory().map(|(_, pose)| pose).collect();
        Digest::new().poses(&poses).integers(slam.map().unwrap().evidence().iter().copied())
    });
}

/// Sequential: the bits of one build are those of the other.
#[test]
fn landmark_slam() {
    let looks = scenes::landmarks::rounds(130);
    assert_same_bits("LandmarkSlam", |_| {
        let mut slam = scenes::landmarks::filter();
        scenes::landmarks::run(&mut slam, &looks);
        let places = slam.landmarks().flat_map(|landmark| landmark.place.mean().map(f64::to_bits).data.0[0]);
        Digest::new().poses(&[slam.map_from_base()]).bits(places.collect::<Vec<_>>())
    });
    assert_same_bits("LandmarkGraphSlam", |_| {
        let mut slam = LandmarkGraphSlam::new(LandmarkGraphSlamParams::default()).unwrap();
        for (odometry, seen) in &looks {
            slam.predict(odometry).unwrap();
            slam.update(seen).unwrap();
        }
        slam.finish().unwrap();
        Digest::new().poses(slam.graph().poses())
    });
}
