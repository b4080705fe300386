//! Maps of normal distributions, and what localises in them.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::core::{
    geometry::{LieGroup, Se2, Se3},
    nalgebra::{Matrix6, Vector3},
    odometry::MotionIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
    sensors::PointCloud,
    time::Stamp,
};
use agv_nav::ndt::{
    convert::CloudToGridParams,
    ndt::{NdtLocalizer, NdtLocalizerParams, NdtMap, NdtScanMatcherParams, VoxelParams},
};
use serde_json::json;

#[test]
fn maps_come_back_and_go_on() {
    let wall = |shift: f32| {
        PointCloud::from_points(
            (0..500).map(move |i| Vector3::new((i % 50) as f32 * 0.1, shift, (i / 50) as f32 * 0.1)),
        )
    };
    let mut map = NdtMap::new(VoxelParams::default()).unwrap();
    map.insert(&wall(0.3), &Se3::default());
    assert_kept("NdtMap", &map);
    let mut again = restored(&map);
    assert_eq!(again, map);
    map.insert(&wall(0.4), &Se3::default());
    again.insert(&wall(0.4), &Se3::default());
    assert_eq!(again, map);
    // A voxel that is there twice.
    let first = serde_json::to_value(&map).unwrap()["voxels"][0][0].clone();
    assert_refused(
        "NdtMap",
        &map,
        &[
            ("/params/resolution".to_owned(), json!(0.0)),
            ("/params/min_points".to_owned(), json!(1)),
            ("/voxels/0/1/count".to_owned(), json!(1)),
            ("/voxels/0/1/linear/0".to_owned(), json!(u64::MAX)),
            ("/voxels/0/1/products/0".to_owned(), json!(0)),
            // Small products, and a sum that no such points have: its square needs more than 64 bits.
            (
                "/voxels/0/1".to_owned(),
                json!({"count": 100_000, "linear": [6_000_000_000_u64, 0, 0], "products": [1, 0, 0, 0, 0, 0]}),
            ),
            ("/voxels/0/1".to_owned(), json!({"count": 0, "linear": [0, 0, 0], "products": [0, 0, 0, 0, 0, 0]})),
            ("/voxels/0/0/1".to_owned(), json!(1 << 20)),
            ("/voxels/0/0/2".to_owned(), json!(-(1 << 20) - 1)),
            ("/voxels/1/0".to_owned(), first),
        ],
    );
}

/// A corner of a hall, seen from a place along x, by so many points on each of three sheets; evenly spread, and on no lattice.
fn corner(x: f64, count: u32) -> PointCloud {
    let sheets = [|a, b| [a, b, 0.3], |a, b| [a, -1.3, b], |a: f64, b: f64| [8.3, a, b]];
    let spread = |i: u32, step: f64| 8.0 * (f64::from(i) * step).fract();
    let points = (0..count).flat_map(move |i| {
        sheets.map(|sheet| Vector3::from(sheet(spread(i, 0.754_877_666_246_7), spread(i, 0.569_840_290_998_1))))
    });
    PointCloud::from_points(points.map(move |p| (p - Vector3::new(x, 0.0, 0.0)).cast::<f32>()))
}

#[test]
fn a_resumed_ndt_localizer_continues_with_the_same_bits() {
    let params = NdtLocalizerParams::default();
    let mut map = NdtMap::new(params.ndt.voxels).unwrap();
    map.insert(&corner(0.0, 6400), &Se3::default());
    let mut localizer = NdtLocalizer::new(&map, params).unwrap();
    localizer.initialize(&PoseBelief::around(Se3::default(), Matrix6::identity() * 1e-4).unwrap()).unwrap();
    let go_on = |localizer: &mut NdtLocalizer, steps: std::ops::Range<u32>| {
        for step in steps {
            let at = |step: u32| {
                (Stamp::from_seconds(0.1 * f64::from(step)), Se3::from(Se2::new(0.11 * f64::from(step), 0.0, 0.0)))
            };
            let ((start, a), (end, b)) = (at(step), at(step + 1));
            localizer.predict(&MotionIncrement::between(start, &a, end, &b).unwrap()).unwrap();
            let outcome = localizer.update(&corner(0.1 * f64::from(step + 1), 1600).with_stamp(end)).unwrap();
            assert!(matches!(outcome, UpdateOutcome::Applied(_)), "{step} {outcome:?}");
        }
    };
    go_on(&mut localizer, 0..4);
    assert_kept("NdtLocalizer", &localizer);
    let mut resumed = restored(&localizer);
    go_on(&mut localizer, 4..8);
    go_on(&mut resumed, 4..8);
    assert_eq!((resumed.estimate(), resumed.status()), (localizer.estimate(), localizer.status()));
    let x = localizer.estimate().unwrap().map_from_base().minus(&Se3::default()).x;
    assert!((x - 0.8).abs() < 0.02, "{x}");
    assert_refused(
        "NdtLocalizer",
        &localizer,
        &[
            ("/params/leaf".to_owned(), json!(0.0)),
            ("/params/ndt/voxels/resolution".to_owned(), json!(0.7)),
            ("/map/voxels".to_owned(), json!([])),
            ("/state/belief/pose/covariance/0".to_owned(), json!(-1.0)),
            ("/state/track/1/0".to_owned(), json!(-1)),
        ],
    );
}

#[test]
fn parameters_come_back() {
    assert_kept("NdtLocalizerParams", &NdtLocalizerParams::default());
    assert_kept("NdtScanMatcherParams", &NdtScanMatcherParams::default());
    assert_kept("CloudToGridParams", &CloudToGridParams::default());
}
