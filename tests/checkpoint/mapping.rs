//! Maps of key frames and of tiles, and how places look.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::core::{compute::Seed, geometry::Se3, nalgebra::Vector3, sensors::PointCloud};
use agv_nav::ndt::{
    ndt::{NdtParams, NdtRegistration, NdtTiles, VoxelParams},
    places::{ScanContext, ScanContextParams, ScanContexts},
};
use agv_nav::pipeline::mapping::{KeyFrameMap, KeyFrameMapper, KeyFrameParams};
use laps::{Drift, Laps};
use serde_json::json;

#[path = "../scenes/laps.rs"]
mod laps;

/// Points on three planes, on no lattice.
fn corner() -> PointCloud {
    let spread = |i: u32, step: f64| 8.0 * (f64::from(i) * step).fract();
    let points = (0..900).flat_map(|i| {
        let (a, b) = (spread(i, 0.754_877_666_246_7), spread(i, 0.569_840_290_998_1));
        [[a, b, 0.3], [a, -1.3, b], [8.3, a, b]]
    });
    PointCloud::from_points(points.map(|p| Vector3::from(p).cast::<f32>()))
}

#[test]
fn tiles_come_back_and_go_on() {
    let mut tiles = NdtTiles::new(VoxelParams::default(), 4).unwrap();
    tiles.insert(&corner(), &Se3::default());
    let away = tiles.unload([0, 0]).unwrap();
    assert_kept("NdtTiles", &tiles);
    assert_kept("NdtTile", &away);
    let mut again = restored(&tiles);
    again.load(&restored(&away)).unwrap();
    tiles.load(&away).unwrap();
    assert!(again == tiles && tiles.away().count() == 0);
    assert_refused(
        "NdtTile",
        &away,
        &[
            ("/index/0", json!(1)),
            ("/tile_voxels", json!(0)),
            ("/tile_voxels", json!(3)),
            ("/map/params/resolution", json!(-1.0)),
        ],
    );
    let first = serde_json::to_value(&tiles).unwrap()["loaded"][0].clone();
    assert_refused(
        "NdtTiles",
        &tiles,
        &[("/loaded/1", first), ("/loaded/0/tile_voxels", json!(8)), ("/params/resolution", json!(0.5))],
    );
}

#[test]
fn places_come_back() {
    let mut places = ScanContexts::new(ScanContextParams::default()).unwrap();
    let mut context = ScanContext::default();
    places.describe_into(&corner(), &mut context);
    places.push(&context);
    assert_kept("ScanContextParams", places.params());
    assert_kept("ScanContexts", &places);
    assert_eq!(restored(&places), places);
    assert_refused(
        "ScanContexts",
        &places,
        &[
            ("/params/rings", json!(0)),
            ("/params/rings", json!(30)),
            ("/columns/0", json!(-1.0)),
            ("/columns/0", json!(null)),
            ("/ring_keys", json!([1.0])),
            ("/sector_keys", json!([])),
        ],
    );
}

/// Killed between two laps, a mapper goes on as if nothing had been.
#[test]
fn a_resumed_mapper_continues_with_the_same_bits() {
    let site = laps::hall(22.0, 9.0, 0.8, Seed(1));
    let laps = Laps::around(&site, 60, Drift { scale: 0.01, heading: 0.003 }, Seed(1));
    let registration = || NdtRegistration::new(NdtParams::default()).unwrap();
    let params = KeyFrameParams { distance: 2.5, leaf: 0.25, ..Default::default() };
    let mut mapper = KeyFrameMapper::new(registration(), params).unwrap();
    let go = |mapper: &mut KeyFrameMapper<NdtRegistration>, index: usize| {
        mapper.process(&laps.step(index), &laps.clouds[index]).unwrap()
    };
    // Amid the second lap, where a key frame of the first was met, which is followed then.
    let end = laps.clouds.len();
    let met = (0..end).find(|&index| go(&mut mapper, index).met.is_some_and(|_| index >= end * 11 / 20)).unwrap();
    assert_kept("KeyFrameMap", mapper.map());
    let stored: KeyFrameMap = restored(mapper.map());
    assert!(stored == *mapper.map());
    let mut resumed = KeyFrameMapper::resume(registration(), stored).unwrap();
    let [steps, again] =
        [&mut mapper, &mut resumed].map(|mapper| (met + 1..end).map(|index| go(mapper, index)).collect::<Vec<_>>());
    assert_eq!(steps, again);
    assert!(steps.iter().any(|step| step.key.is_some()) && steps.iter().any(|step| step.met.is_some()));
    assert!(steps.iter().map(|step| step.closures).sum::<usize>() > 0);
    assert!(mapper.map() == resumed.map());
    assert_refused(
        "KeyFrameMap",
        mapper.map(),
        &[
            ("/params/distance", json!(0.0)),
            ("/keys", json!([])),
            ("/keys/0/way", json!(-1.0)),
            ("/keys/1/cloud/x", json!([1.0])),
            ("/tracked", json!(null)),
            ("/trajectory/0/key", json!(1_000_000)),
            ("/followed", json!(1_000_000)),
            ("/tracked/since", json!(i64::MAX)),
            ("/tracked/stamp", json!(0)),
            ("/trajectory/1/stamp", json!(i64::MAX)),
            ("/graph/relations/0/to", json!(1_000_000)),
            ("/graph/held", json!([])),
            ("/way", json!(-1.0)),
            ("/doubt", json!(-1.0)),
        ],
    );
}
