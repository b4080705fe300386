//! Lidar odometry that drifts, and what closing loops makes of it, among racks that look alike.

#[path = "../scenes/laps.rs"]
mod laps;

use agv_nav::core::{compute::Seed, geometry::Se3};
use agv_nav::ndt::ndt::{NdtParams, NdtRegistration};
use agv_nav::pipeline::mapping::{KeyFrameMap, KeyFrameMapper, KeyFrameParams, LoopParams};
use laps::{Drift, Laps, hall};

fn mapped(laps: &Laps, params: &KeyFrameParams) -> (KeyFrameMap, usize) {
    let registration = NdtRegistration::new(NdtParams::default()).unwrap();
    let mut mapper = KeyFrameMapper::new(registration, *params).unwrap();
    let mut closures = 0;
    for (index, cloud) in laps.clouds.iter().enumerate() {
        closures += mapper.process(&laps.step(index), cloud).unwrap().closures;
    }
    (mapper.into_map(), closures)
}

fn corrected(map: &KeyFrameMap) -> impl Iterator<Item = Se3> + '_ {
    map.trajectory().map(|(_, pose)| pose)
}

/// Two laps with goods on the racks, and with none, where all bays are the same: loops close, none falsely, and the end is where it is.
/// Half of the key frames of two laps are of places that are known.
#[test]
fn closed_loops_correct_every_drive() {
    for (fill, seeds) in [(0.8, 0..2), (0.0, 4..5)] {
        for seed in seeds {
            let site = hall(32.0, 14.0, fill, Seed(seed));
            let laps = Laps::around(&site, 360, Drift { scale: 0.01, heading: 0.003 }, Seed(seed));
            let all = KeyFrameParams { reach: None, ..KeyFrameParams::default() };
            let [kept, every] = [KeyFrameParams::default(), all].map(|params| {
                let (map, closures) = mapped(&laps, &params);
                let (before, after) = (laps.errors(laps.odometry.iter().copied()), laps.errors(corrected(&map)));
                let keys = map.key_frames().len();
                println!(
                    "fill {fill}, seed {seed}: {keys} key frames, {closures} closures; worst and end {before:?} m, then {after:?} m"
                );
                assert!(closures >= 10 && laps.false_closures(&map) == 0, "seed {seed}: {closures}");
                assert!(after.0 <= before.0 && after.1 <= before.1.min(0.15), "seed {seed}: {before:?} {after:?}");
                keys
            });
            assert!(kept < every * 7 / 10, "seed {seed}: {kept} of {every}");
        }
    }
}

/// To and fro through aisles of empty racks, each as the other, with windows that hold three of them: no place is met twice, and none
/// is taken for another.
#[test]
fn aisles_that_look_alike_close_no_loop() {
    for seed in 0..2 {
        let site = hall(32.0, 24.0, 0.0, Seed(seed));
        let laps = Laps::once_each(&site, 360, Drift { scale: 0.02, heading: 0.004 }, Seed(seed));
        let loops = LoopParams { growth: 0.1, ..LoopParams::default() };
        let params = KeyFrameParams { loops, ..KeyFrameParams::default() };
        for params in [params, KeyFrameParams { reach: None, ..params }] {
            let (map, closures) = mapped(&laps, &params);
            let (before, after) = (laps.errors(laps.odometry.iter().copied()), laps.errors(corrected(&map)));
            let keys = map.key_frames().len();
            println!(
                "seed {seed}: {keys} key frames, {closures} closures; worst and end {before:?} m, then {after:?} m"
            );
            assert_eq!(laps.false_closures(&map), 0, "seed {seed}");
            // Neighbouring aisles see each other through the racks: what they say of one another is right.
            assert!(after.0 <= before.0 + 0.05, "seed {seed}: {before:?} {after:?}");
        }
    }
}
