//! Maps that are made on the way.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::{
        self,
        mapping::{graph_slam, map_by_graph, map_by_particles, particle_slam},
    },
};
use agv_nav::{
    core::{geometry::Se2, grid::OccupancyThresholds},
    filters::slam::landmark::{LandmarkGraphSlam, LandmarkGraphSlamParams},
};

#[test]
fn graph_slam_does_not_depend_on_threads() {
    // More than once around, so that loops are closed.
    let drive = scenes::circle(150);
    assert_same_bits("GraphSlam", |par| {
        let mut slam = graph_slam(par);
        assert!(map_by_graph(&mut slam, &drive, 0) > 0, "the drive must close loops");
        let poses: Vec<Se2> = slam.trajectory().map(|(_, pose)| pose).collect();
        Digest::new().poses(&poses).integers(slam.map().unwrap().evidence().iter().copied())
    });
}

#[test]
fn particles_with_maps_do_not_depend_on_threads() {
    let drive = scenes::circle(40);
    for (name, with_wheels) in [("Rbpf", true), ("Rbpf without odometry", false)] {
        assert_same_bits(name, |par| {
            let mut slam = particle_slam(par);
            assert!(map_by_particles(&mut slam, &drive, with_wheels) > 0, "the drive must exercise resampling");
            let poses: Vec<Se2> = slam.trajectory().into_iter().map(|(_, pose)| pose).collect();
            let fused = slam.fused_map(&OccupancyThresholds::default()).unwrap();
            Digest::new()
                .poses(&poses)
                .bits(slam.weights().iter().map(|weight| weight.to_bits()))
                .integers(fused.values().iter().map(|state| *state as i32))
        });
    }
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
