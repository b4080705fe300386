//! Lidar odometry that drifts, and what closing loops makes of it, among racks that look alike.

#[path = "../scenes/laps.rs"]
mod laps;

use agv_nav::core::{
    compute::Seed,
    geometry::{LieGroup, PoseSigma, Se3},
};
use agv_nav::ndt::ndt::{NdtParams, NdtRegistration};
use agv_nav::pipeline::mapping::{KeyFrameMap, KeyFrameMapper, KeyFrameParams, LoopParams};
use laps::{Drift, Laps, hall};

/// The map and its closures.
///
/// At each place that is met again the vehicle is where it is said to be. Relative to the key frame that was met:
/// within three standard deviations of what a find is taken to be off besides its noise (`LoopParams::floor`, 6 cm and
/// half a degree). In the map: within half of what odometry was off until the first loop closed, and that. A random
/// walk that is tied at both ends is in its middle half as uncertain as its end was, and nowhere more.
fn mapped(laps: &Laps, params: &KeyFrameParams) -> (KeyFrameMap, usize) {
    let registration = NdtRegistration::new(NdtParams::default()).unwrap();
    let mut mapper = KeyFrameMapper::new(registration, *params).unwrap();
    let (mut closures, mut met, mut drifted) = (0, 0, 0.0_f64);
    let (mut worst, mut worst_turn, mut worst_in_map) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (index, cloud) in laps.clouds.iter().enumerate() {
        let made = mapper.process(&laps.step(index), cloud).unwrap();
        if closures == 0 {
            drifted = drifted.max(laps.error(index, &laps.odometry[index]));
        }
        closures += made.closures;
        let Some(key) = made.met else { continue };
        let (kept, map_from_key) = mapper.map().key_frames().nth(key).unwrap();
        let kept = kept.cloud().stamp().seconds().round() as usize;
        let off = laps.truth[kept].between(&laps.truth[index]).between(&map_from_key.between(&made.map_from_base));
        met += 1;
        worst = worst.max(off.translation().norm());
        worst_turn = worst_turn.max(off.rotation().log().norm());
        worst_in_map = worst_in_map.max(laps.error(index, &made.map_from_base));
    }
    if met > 0 {
        println!(
            "{met} met: at most {worst:.3} m and {worst_turn:.4} rad off the key frame, {worst_in_map:.2} m in the map"
        );
        println!("odometry was {drifted:.2} m off until the first loop closed");
    }
    let PoseSigma { translation, rotation } = params.loops.floor;
    assert!(worst <= 3.0 * translation && worst_turn <= 3.0 * rotation, "{worst} m, {worst_turn} rad");
    assert!(worst_in_map <= 0.5 * drifted + 3.0 * translation, "{worst_in_map} m of {drifted}");
    (mapper.into_map(), closures)
}

fn corrected(map: &KeyFrameMap) -> impl Iterator<Item = Se3> + '_ {
    map.trajectory().map(|(_, pose)| pose)
}

/// Two laps with goods on the racks, and with none, where all bays are the same: loops close, none falsely, and the end
/// is where it is. Half of the key frames of two laps are of places that are known.
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

/// To and fro through aisles of empty racks, each as the other, with windows that hold three of them: no place is met
/// twice, and none is taken for another.
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
