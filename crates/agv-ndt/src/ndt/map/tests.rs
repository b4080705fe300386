use super::super::level::Level;
use super::*;
use agv_core::geometry::So3;
use agv_core::sensors::PointCloud;
use proptest::prelude::*;

fn map(points: &[[f32; 3]]) -> NdtMap {
    let mut map = NdtMap::new(VoxelParams { resolution: 0.5, ..VoxelParams::default() }).unwrap();
    map.insert(&PointCloud::from_points(points.iter().map(|&p| Vector3::from(p))), &Se3::default());
    map
}

fn points() -> impl Strategy<Value = Vec<[f32; 3]>> {
    prop::collection::vec(prop::array::uniform3(-1.0..1.0_f32), 0..200)
}

proptest! {
    #[test]
    fn maps_merge_in_any_order_to_the_same_bits(a in points(), b in points(), c in points()) {
        let merged = |parts: [&Vec<[f32; 3]>; 3]| {
            let mut sum = map(parts[0]);
            sum.merge(&map(parts[1])).unwrap();
            sum.merge(&map(parts[2])).unwrap();
            sum
        };
        let all = merged([&a, &b, &c]);
        prop_assert_eq!(&all, &merged([&c, &a, &b]));
        prop_assert_eq!(&all, &map(&[a, b, c].concat()));
    }

    /// A coarse level's distributions are those of the points themselves in coarse voxels.
    #[test]
    fn coarse_levels_are_those_of_the_points(points in points()) {
        let fine = map(&points);
        let mut coarse = NdtMap::new(VoxelParams { resolution: 2.0, ..VoxelParams::default() }).unwrap();
        coarse.insert(&PointCloud::from_points(points.iter().map(|&p| Vector3::from(p))), &Se3::default());
        let (mut level, mut expected) = (Level::default(), Level::default());
        level.rebuild(&fine, 2);
        expected.rebuild(&coarse, 0);
        for cell in (-1..1).flat_map(|x| (-1..1).flat_map(move |y| (-1..1).map(move |z| [x, y, z]))) {
            match (level.get(cell), expected.get(cell)) {
                (Some(a), Some(b)) => {
                    let close = |a: &[f32], b: &[f32], tolerance: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance);
                    prop_assert!(close(&a.mean, &b.mean, 1e-4));
                    prop_assert!(close(&a.information, &b.information, 0.02 * b.information.iter().fold(1.0, |m, v| v.abs().max(m))));
                }
                (a, b) => prop_assert_eq!(a.is_some(), b.is_some()),
            }
        }
    }

    /// What is kept is what a map of those points alone holds.
    #[test]
    fn removed_voxels_are_gone(points in points()) {
        let mut cut = map(&points);
        cut.retain(|cell| cell[0] >= 0);
        let kept: Vec<_> = points.into_iter().filter(|p| p[0] >= 0.0).collect();
        prop_assert_eq!(cut, map(&kept));
    }
}

#[test]
fn a_moved_cloud_lies_where_its_pose_says_and_memory_is_kept() {
    let cloud = PointCloud::from_points((0..100).map(|i| Vector3::new(0.1 + i as f32 * 0.003, 0.2, 0.1)));
    let pose = Se3::from_parts(Vector3::new(1000.0, -500.0, 3.0), So3::from_roll_pitch_yaw(0.0, 0.0, 1.0));
    let mut map = NdtMap::new(VoxelParams::default()).unwrap();
    assert_eq!(map.insert(&cloud, &pose), 100);
    let total: u32 = map.voxels().map(|(_, sums)| sums.count()).sum();
    assert_eq!(total, 100);
    let middle = cloud.points().map(|p| pose.act(&p.cast())).sum::<Vector3<f64>>() / 100.0;
    let weighed = |(cell, sums): ([i32; 3], &VoxelSums)| {
        let gaussian = map.gaussian(cell).unwrap();
        assert_eq!(map.cell_at(&gaussian.mean), Some(cell));
        gaussian.mean * f64::from(sums.count()) / 100.0
    };
    assert!((map.voxels().map(weighed).sum::<Vector3<f64>>() - middle).norm() < 1e-4);
    let cell = map.cell_at(&middle).unwrap();
    let memory = map.sums.as_ptr();
    map.clear();
    assert!(map.is_empty() && map.gaussian(cell).is_none());
    map.insert(&cloud, &pose);
    assert_eq!(map.sums.as_ptr(), memory);
}

#[test]
fn bad_points_are_skipped_and_other_maps_refused() {
    let mut map = NdtMap::new(VoxelParams::default()).unwrap();
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e6, -3e6];
    let cloud = PointCloud::from_points(bad.map(|v| Vector3::new(0.5, v, 0.5)));
    assert_eq!(map.insert(&cloud, &Se3::default()), 0);
    let nowhere = Se3::from_parts(Vector3::repeat(f64::NAN), So3::default());
    assert_eq!(map.insert(&PointCloud::from_points([Vector3::zeros()]), &nowhere), 0);
    assert!(map.is_empty());
    assert_eq!(map.cell_at(&Vector3::new(0.0, f64::NAN, 0.0)), None);
    let other = NdtMap::new(VoxelParams { resolution: 2.0, ..VoxelParams::default() }).unwrap();
    assert!(matches!(map.merge(&other), Err(Error::MapMismatch { name: "resolution", .. })));
}
