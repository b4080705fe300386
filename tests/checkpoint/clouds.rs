//! Maps of normal distributions.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::core::{geometry::Se3, nalgebra::Vector3, sensors::PointCloud};
use agv_nav::ndt::ndt::{NdtMap, VoxelParams};
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
