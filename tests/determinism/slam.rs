//! Maps that are made on the way.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes,
};
use agv_nav::{
    core::geometry::Se2,
    filters::slam::graph::{GraphSlam, GraphSlamParams},
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
