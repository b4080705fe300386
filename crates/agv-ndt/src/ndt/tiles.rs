//! A map by tiles: squares of the floor that are loaded and unloaded, so that memory is bounded by what is around a vehicle.
//!
//! A tile is a value that holds the point sums of its voxels, from the floor to the roof. Since sums of voxels merge in any order to
//! the same bits, so do tiles: a map is the same whether it was built at once, by tile, by several vehicles, or with tiles away.
//! Writing a tile to a file is the caller's (feature `serde`), and to [`merge`](NdtTile::merge) what is unloaded of one tile later
//! with what was before: a sensor that reaches beyond the radius begins tiles anew that are away.

use super::gaussian::{VoxelParams, VoxelSums};
use super::map::NdtMap;
use crate::Error;
use agv_core::{
    check,
    geometry::Se3,
    sensors::{PointCloud, PointSource},
};
use nalgebra::{Vector2, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// Most voxels along a tile's edge.
const LONGEST: usize = 1 << 16;

/// A square of a map, with its sums.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawTile"))]
pub struct NdtTile {
    index: [i32; 2],
    tile_voxels: usize,
    map: NdtMap,
}

/// A tile as it is stored.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawTile {
    index: [i32; 2],
    tile_voxels: usize,
    map: NdtMap,
}

#[cfg(feature = "serde")]
impl TryFrom<RawTile> for NdtTile {
    type Error = Error;

    /// Refuses voxels that lie in another tile.
    fn try_from(RawTile { index, tile_voxels, map }: RawTile) -> Result<Self, Error> {
        check::in_range("tile_voxels", tile_voxels as f64, 1.0, LONGEST as f64)?;
        for (cell, _) in map.voxels() {
            for (own, expected) in tile_of(cell, tile_voxels).into_iter().zip(index) {
                check::in_range("tile of a voxel", f64::from(own), f64::from(expected), f64::from(expected))?;
            }
        }
        Ok(Self { index, tile_voxels, map })
    }
}

impl NdtTile {
    /// Which tile it is: `[i, j]` spans `i` to `i + 1` times the edge along x, and `j` along y.
    pub const fn index(&self) -> [i32; 2] {
        self.index
    }

    /// Its voxels, in the frame of the whole map.
    pub const fn map(&self) -> &NdtMap {
        &self.map
    }

    /// Adds the points of another part of the same tile, such as one that was unloaded later.
    ///
    /// # Errors
    /// [`Error::MapMismatch`] for another tile, another edge or other voxels; this one is then as it was.
    pub fn merge(&mut self, part: &Self) -> Result<(), Error> {
        self.map.check_like(&part.map)?;
        check_edges(self.tile_voxels, part.tile_voxels)?;
        for (name, own, other) in
            [("tiles along x", self.index[0], part.index[0]), ("tiles along y", self.index[1], part.index[1])]
        {
            if own != other {
                return Err(Error::MapMismatch { name, left: own.into(), right: other.into() });
            }
        }
        for (cell, sums) in part.map.voxels() {
            self.map.merge_voxel(cell, sums);
        }
        Ok(())
    }
}

fn check_edges(left: usize, right: usize) -> Result<(), Error> {
    if left == right {
        return Ok(());
    }
    Err(Error::MapMismatch { name: "voxels along a tile's edge", left: left as f64, right: right as f64 })
}

/// A map of normal distributions cut into tiles, of which some may be away.
///
/// ```
/// use agv_core::{geometry::Se3, nalgebra::{Vector2, Vector3}, sensors::PointCloud};
/// use agv_ndt::ndt::{NdtMap, NdtTiles, VoxelParams};
///
/// // A long floor, in tiles of 16 m.
/// let floor = PointCloud::from_points((0..20_000).map(|i| Vector3::new((i % 1000) as f32 * 0.1, (i / 1000) as f32 * 0.1, 0.2)));
/// let mut tiles = NdtTiles::new(VoxelParams::default(), 16)?;
/// tiles.insert(&floor, &Se3::default());
/// assert_eq!(tiles.loaded().count(), 7);
///
/// // What is far is put away, and known of; and fetched again when the vehicle comes near.
/// let mut shelf = tiles.unload_beyond(&Vector2::new(8.0, 1.0), 20.0);
/// assert_eq!(tiles.missing_within(&Vector2::new(60.0, 1.0), 5.0), [[3, 0], [4, 0]]);
/// while let Some(tile) = shelf.pop() {
///     tiles.load(&tile)?;
/// }
/// let mut whole = NdtMap::new(VoxelParams::default())?;
/// whole.insert(&floor, &Se3::default());
/// assert_eq!(tiles.assembled(), whole);
/// # Ok::<(), agv_ndt::Error>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawTiles", into = "RawTiles")
)]
pub struct NdtTiles {
    tile_voxels: usize,
    loaded: BTreeMap<[i32; 2], NdtMap>,
    /// Tiles that are stored elsewhere; one of them may have begun anew here.
    away: BTreeSet<[i32; 2]>,
    /// Where clouds are summed up before they are cut; without voxels in between.
    whole: NdtMap,
}

/// Maps are equal if they hold the same sums, and the same tiles are away.
impl PartialEq for NdtTiles {
    fn eq(&self, other: &Self) -> bool {
        self.tile_voxels == other.tile_voxels
            && self.params() == other.params()
            && self.loaded == other.loaded
            && self.away == other.away
    }
}

/// A map as it is stored.
#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct RawTiles {
    params: VoxelParams,
    tile_voxels: usize,
    loaded: Vec<NdtTile>,
    away: BTreeSet<[i32; 2]>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawTiles> for NdtTiles {
    type Error = Error;

    fn try_from(raw: RawTiles) -> Result<Self, Error> {
        let mut tiles = Self::new(raw.params, raw.tile_voxels)?;
        for (number, tile) in raw.loaded.into_iter().enumerate() {
            check::at_least("voxels of a tile", tile.map.len(), 1)?;
            tiles.merge_tile(&tile)?;
            // One that was there already is none the more.
            check::length("tiles that differ", tiles.loaded.len(), number + 1)?;
        }
        tiles.away = raw.away;
        Ok(tiles)
    }
}

#[cfg(feature = "serde")]
impl From<NdtTiles> for RawTiles {
    fn from(tiles: NdtTiles) -> Self {
        let NdtTiles { tile_voxels, loaded, away, whole } = tiles;
        let loaded = loaded.into_iter().map(|(index, map)| NdtTile { index, tile_voxels, map }).collect();
        Self { params: *whole.params(), tile_voxels, loaded, away }
    }
}

/// The tile of a voxel.
fn tile_of([x, y, _]: [i32; 3], tile_voxels: usize) -> [i32; 2] {
    [x, y].map(|voxel| voxel.div_euclid(tile_voxels as i32))
}

impl NdtTiles {
    /// A map without points, in tiles of `tile_voxels` voxels along each edge.
    ///
    /// # Errors
    /// As [`NdtMap::new`], and tiles that are not from 1 to 65536 voxels long.
    pub fn new(params: VoxelParams, tile_voxels: usize) -> Result<Self, Error> {
        check::in_range("tile_voxels", tile_voxels as f64, 1.0, LONGEST as f64)?;
        Ok(Self { tile_voxels, loaded: BTreeMap::new(), away: BTreeSet::new(), whole: NdtMap::new(params)? })
    }

    /// The parameters of the voxels.
    pub const fn params(&self) -> &VoxelParams {
        self.whole.params()
    }

    /// Edge of a tile, in metres.
    pub fn tile_edge(&self) -> f64 {
        self.tile_voxels as f64 * self.params().resolution
    }

    /// Tiles that are here, with their voxels, by index.
    pub fn loaded(&self) -> impl Iterator<Item = ([i32; 2], &NdtMap)> + '_ {
        self.loaded.iter().map(|(index, map)| (*index, map))
    }

    /// Tiles that were unloaded and not loaded since, by index.
    pub fn away(&self) -> impl Iterator<Item = [i32; 2]> + '_ {
        self.away.iter().copied()
    }

    /// Voxels with points that are here.
    pub fn len(&self) -> usize {
        self.loaded.values().map(NdtMap::len).sum()
    }

    /// Whether there are no points here.
    pub fn is_empty(&self) -> bool {
        self.loaded.is_empty()
    }

    /// Forgets all points, and all tiles that are away.
    pub fn clear(&mut self) {
        self.loaded.clear();
        self.away.clear();
    }

    /// Adds the points of a cloud whose pose in the map is `map_from_source`, and says how many, as [`NdtMap::insert`] does. Those of
    /// tiles that are away wait here for the tile to come back.
    pub fn insert(&mut self, points: &(impl PointSource + ?Sized), map_from_source: &Se3) -> usize {
        let empty = NdtMap::alike(self.params());
        let mut whole = std::mem::replace(&mut self.whole, empty);
        let inserted = whole.insert(points, map_from_source);
        self.cut(&whole);
        whole.clear();
        self.whole = whole;
        inserted
    }

    /// Adds all points of a map of the same voxels.
    ///
    /// # Errors
    /// [`Error::MapMismatch`]; the map is then as it was.
    pub fn merge(&mut self, map: &NdtMap) -> Result<(), Error> {
        self.whole.check_like(map)?;
        self.cut(map);
        Ok(())
    }

    /// Adds all points of a tile: another vehicle's, of the same place.
    ///
    /// # Errors
    /// [`Error::MapMismatch`] for another edge or other voxels; the map is then as it was.
    pub fn merge_tile(&mut self, tile: &NdtTile) -> Result<(), Error> {
        check_edges(self.tile_voxels, tile.tile_voxels)?;
        self.merge(&tile.map)
    }

    fn cut(&mut self, map: &NdtMap) {
        let params = *self.params();
        for (cell, sums) in map.voxels() {
            let tile = self.loaded.entry(tile_of(cell, self.tile_voxels)).or_insert_with(|| NdtMap::alike(&params));
            tile.merge_voxel(cell, sums);
        }
    }

    /// Puts a tile away: who keeps it may [`load`](Self::load) it again. `None` if it is not here.
    ///
    /// Of a tile that was away already and begun anew this is a further part, to be [merged](NdtTile::merge) with the one that is kept.
    pub fn unload(&mut self, index: [i32; 2]) -> Option<NdtTile> {
        let map = self.loaded.remove(&index)?;
        self.away.insert(index);
        Some(NdtTile { index, tile_voxels: self.tile_voxels, map })
    }

    /// Takes back a tile that is away, with all its parts in one; points that were added at its place since then are kept.
    ///
    /// # Errors
    /// [`Error::TileNotAway`] for a tile that would count twice, and as [`merge_tile`](Self::merge_tile); the map is then as it was.
    pub fn load(&mut self, tile: &NdtTile) -> Result<(), Error> {
        let [x, y] = tile.index;
        if !self.away.contains(&tile.index) {
            return Err(Error::TileNotAway { x, y });
        }
        self.merge_tile(tile)?;
        self.away.remove(&tile.index);
        Ok(())
    }

    /// Puts away all tiles that are farther than `radius` metres from a place, and further parts as [`unload`](Self::unload) does: no
    /// more is here then than what is around that place.
    pub fn unload_beyond(&mut self, center: &Vector2<f64>, radius: f64) -> Vec<NdtTile> {
        let far = |index: &[i32; 2]| !self.is_within(*index, center, radius);
        let beyond: Vec<_> = self.loaded.keys().copied().filter(far).collect();
        beyond.into_iter().filter_map(|index| self.unload(index)).collect()
    }

    /// Tiles no farther than `radius` metres from a place that are away, by index: what to load.
    pub fn missing_within(&self, center: &Vector2<f64>, radius: f64) -> Vec<[i32; 2]> {
        self.away().filter(|index| self.is_within(*index, center, radius)).collect()
    }

    /// Whether a tile is no farther than `radius` metres from a place.
    fn is_within(&self, index: [i32; 2], center: &Vector2<f64>, radius: f64) -> bool {
        let edge = self.tile_edge();
        let off = [(index[0], center.x), (index[1], center.y)].map(|(index, at)| {
            let low = f64::from(index) * edge;
            (low - at).max(at - low - edge).max(0.0)
        });
        off[0].hypot(off[1]) <= radius
    }

    /// All that is here as one map: what registrations and localizers take.
    pub fn assembled(&self) -> NdtMap {
        let mut map = NdtMap::alike(self.params());
        for (cell, sums) in self.in_order() {
            map.merge_voxel(cell, sums);
        }
        map
    }

    /// One point for each voxel that is here, the mean of its points: a thinned cloud, in an order that does not depend on how the map
    /// came about. Sensor and mount of `out` are kept.
    pub fn means_into(&self, out: &mut PointCloud) {
        let resolution = self.params().resolution;
        let (stamp, sensor, mount) = (out.stamp(), out.sensor(), out.base_from_sensor());
        let mean = |(cell, sums): ([i32; 3], &VoxelSums)| {
            let (mean, _) = sums.moments()?;
            Some(((Vector3::from(cell.map(f64::from)) + mean) * resolution).cast::<f32>())
        };
        let points = PointCloud::from_points(self.in_order().filter_map(mean));
        *out = points.with_stamp(stamp).with_sensor(sensor).with_mount(mount).unwrap_or_default();
    }

    /// Voxels by tile, and in each by cell.
    fn in_order(&self) -> impl Iterator<Item = ([i32; 3], &VoxelSums)> + '_ {
        self.loaded.values().flat_map(|map| {
            let mut voxels: Vec<_> = map.voxels().collect();
            voxels.sort_unstable_by_key(|(cell, _)| *cell);
            voxels
        })
    }
}

#[cfg(test)]
mod tests {
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
        assert!(
            tiles.loaded().find(|(index, _)| *index == [0, 0]) == twice.loaded().find(|(index, _)| *index == [0, 0])
        );
        tiles = before.clone();
        let other = tiles.loaded().map(|(index, _)| index).find(|index| *index != [0, 0]).unwrap();
        let kept = both.clone();
        assert!(matches!(both.merge(&tiles.unload(other).unwrap()), Err(Error::MapMismatch { .. })) && both == kept);
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
}
