use super::*;
use crate::ndt::{NdtParams, NdtRegistration};
use crate::scenes::{ROOM, cloud, sheets};
use agv_core::{
    geometry::{LieGroup, Se2},
    roles::Registration,
};
use proptest::prelude::*;

fn tiles(tile_voxels: usize) -> NdtTiles {
    NdtTiles::new(VoxelParams::default(), tile_voxels).unwrap()
}

fn room(draw: u32) -> PointCloud {
    PointCloud::from_points(sheets(&ROOM, 40.0, draw).iter().map(|p| p.cast()))
}

proptest! {
    /// In any tiles, in parts and any order, with tiles away in between: the sums are those of the whole.
    #[test]
    fn a_map_of_tiles_is_the_whole_map(
        points in prop::collection::vec(prop::array::uniform3(-40.0..40.0_f32), 1..200),
        cut in 0..200_usize, tile_voxels in 1..40_usize, center in prop::array::uniform2(-40.0..40.0_f64), radius in 0.0..50.0_f64,
    ) {
        let points: Vec<_> = points.into_iter().map(Vector3::from).collect();
        let mut whole = NdtMap::new(VoxelParams::default()).unwrap();
        whole.insert(points.as_slice(), &Se3::default());
        let (first, second) = points.split_at(cut.min(points.len()));
        let mut tiles = tiles(tile_voxels);
        tiles.insert(second, &Se3::default());
        let away = tiles.unload_beyond(&Vector2::from(center), radius);
        let mut needed = tiles.missing_within(&Vector2::from(center), 1e6);
        prop_assert!(tiles.missing_within(&Vector2::from(center), radius).is_empty());
        tiles.insert(first, &Se3::default());
        for tile in away.into_iter().rev() {
            prop_assert_eq!(needed.pop(), Some(tile.index()));
            prop_assert!(tile.map().voxels().all(|(cell, _)| tile_of(cell, tile_voxels) == tile.index()));
            tiles.load(&tile).unwrap();
        }
        prop_assert_eq!(tiles.assembled(), whole);
        prop_assert_eq!(tiles.away().count(), 0);
    }
}

proptest! {
    /// What is missing around a place is what a look at all that is away says, in the same order.
    #[test]
    fn nothing_that_is_missing_is_missed(
        points in prop::collection::vec(prop::array::uniform3(-900.0..900.0_f32), 1..100),
        tile_voxels in 1..40_usize, center in prop::array::uniform2(-1000.0..1000.0_f64), radius in 0.0..1500.0_f64,
    ) {
        let points: Vec<_> = points.into_iter().map(Vector3::from).collect();
        let mut tiles = tiles(tile_voxels);
        tiles.insert(points.as_slice(), &Se3::default());
        let (nowhere, loaded) = (Vector2::new(f64::NAN, 0.0), tiles.loaded().count());
        prop_assert!(tiles.unload_beyond(&nowhere, 1.0).is_empty() && tiles.loaded().count() == loaded);
        tiles.unload_beyond(&Vector2::from(center), -1.0);
        prop_assert!(tiles.is_empty() && tiles.missing_within(&nowhere, 1.0).is_empty());
        for center in [center, [0.0, 0.0], [1e300, -1e300]].map(Vector2::from) {
            for radius in [radius, 0.0, 1e300, f64::INFINITY, -1.0, f64::NAN] {
                let all: Vec<_> = tiles.away().filter(|index| tiles.is_within(*index, &center, radius)).collect();
                prop_assert_eq!(tiles.missing_within(&center, radius), all);
            }
        }
    }
}

#[test]
fn what_is_aligned_with_tiles_has_the_bits_of_the_whole() {
    let mut whole = NdtMap::new(VoxelParams::default()).unwrap();
    whole.insert(&room(1), &Se3::default());
    let mut tiles = tiles(4);
    tiles.merge(&whole).unwrap();
    assert!(tiles.loaded().count() > 8 && tiles.len() == whole.len());
    let pose = Se3::from(Se2::new(0.3, -0.2, 0.05));
    let source = cloud(&sheets(&ROOM, 10.0, 2), &pose);
    let [a, b] = [whole, tiles.assembled()].map(|map| {
        let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap();
        ndt.set_map(&map).unwrap();
        ndt.align(&source, &Se3::default()).unwrap()
    });
    assert!(a == b && a.converged() && a.target_from_source.between(&pose).translation().norm() < 0.02);
}

/// Two vehicles, the second of which came from the other side: the thinned cloud is the same to the bit.
#[test]
fn the_thinned_cloud_does_not_depend_on_the_order() {
    let params = VoxelParams { resolution: 0.2, ..VoxelParams::default() };
    let build = |draws: [u32; 2]| {
        let mut tiles = NdtTiles::new(params, 32).unwrap();
        for draw in draws {
            tiles.insert(&room(draw), &Se3::default());
        }
        let mut cloud = PointCloud::default();
        tiles.means_into(&mut cloud);
        (cloud, tiles.len())
    };
    let ((a, voxels), (b, _)) = (build([1, 2]), build([2, 1]));
    assert_eq!((a.len(), &a), (voxels, &b));
    assert!(a.points().any(|p| (p.x - 7.7).abs() < 0.02), "the far wall is where it is");
}

/// Along a way, with a lidar that reaches farther than what is kept: no more is here than what is around, and no point is lost.
#[test]
fn what_is_here_stays_bounded() {
    let (mut tiles, mut whole) = (tiles(4), NdtMap::new(VoxelParams::default()).unwrap());
    let mut shelf: BTreeMap<[i32; 2], NdtTile> = BTreeMap::new();
    let seen: Vec<_> = (0..120).map(|i| Vector3::new((i - 60) as f32, 2.0 * (i as f32).sin(), 1.0)).collect();
    for i in 0..100 {
        let x = 5.0 * f64::from(i);
        let pose = Se3::from(Se2::new(x, 0.0, 0.0));
        tiles.insert(seen.as_slice(), &pose);
        whole.insert(seen.as_slice(), &pose);
        for tile in tiles.unload_beyond(&Vector2::new(x, 0.0), 20.0) {
            match shelf.get_mut(&tile.index()) {
                Some(kept) => kept.merge(&tile).unwrap(),
                None => assert_eq!(shelf.insert(tile.index(), tile), None),
            }
        }
        assert!(tiles.loaded().count() <= 2 * (2 + (40.0 / tiles.tile_edge()) as usize), "after {i}");
    }
    for tile in shelf.values() {
        tiles.load(tile).unwrap();
    }
    assert_eq!((tiles.assembled(), tiles.away().count()), (whole, 0));
}

#[test]
fn no_tile_counts_twice() {
    let mut tiles = tiles(8);
    tiles.insert(&room(1), &Se3::default());
    let before = tiles.clone();
    assert_eq!(tiles.unload([99, 0]), None);
    let tile = tiles.unload([0, 0]).unwrap();
    assert_eq!(tiles.away().collect::<Vec<_>>(), [[0, 0]]);
    tiles.insert(&room(1), &Se3::default());
    let mut both = tiles.unload([0, 0]).unwrap();
    assert_eq!((&both, tiles.unload([0, 0])), (&tile, None), "a further part of the same points");
    both.merge(&tile).unwrap();
    tiles.load(&both).unwrap();
    let mut twice = before.clone();
    twice.merge_tile(&tile).unwrap();
    assert!(tiles.loaded().find(|(index, _)| *index == [0, 0]) == twice.loaded().find(|(index, _)| *index == [0, 0]));
    tiles = before.clone();
    let other = tiles.loaded().map(|(index, _)| index).find(|index| *index != [0, 0]).unwrap();
    let kept = both.clone();
    let error = both.merge(&tiles.unload(other).unwrap()).unwrap_err();
    assert!(
        matches!(error, Error::TileMismatch { left, right } if left == kept.index() && right == other) && both == kept
    );
    tiles = before.clone();
    tiles.unload([0, 0]).unwrap();
    tiles.load(&tile).unwrap();
    assert_eq!(tiles, before);
    assert_eq!(tiles.load(&tile), Err(Error::TileNotAway { x: 0, y: 0 }));
    let mut others = NdtTiles::new(VoxelParams::default(), 9).unwrap();
    assert!(matches!(others.merge_tile(&tile), Err(Error::MapMismatch { .. })));
    let mut finer = NdtTiles::new(VoxelParams { resolution: 0.5, ..Default::default() }, 8).unwrap();
    assert!(matches!(finer.merge_tile(&tile), Err(Error::MapMismatch { .. })));
    assert_eq!(tiles, before);
    for bad in [0, LONGEST + 1] {
        assert!(NdtTiles::new(VoxelParams::default(), bad).is_err());
    }
    tiles.clear();
    assert!(tiles.is_empty() && tiles.away().next().is_none());
}
