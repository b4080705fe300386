//! Maps in the making: killed, and resumed from a text.

use crate::{
    scenes::{
        circle,
        mapping::{graph_slam, map_by_graph, map_by_particles, particle_slam},
    },
    table::restored,
};
use agv_nav::core::{
    compute::Par,
    geometry::{LieGroup, Se2},
    grid::OccupancyThresholds,
};

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
