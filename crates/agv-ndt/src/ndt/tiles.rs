//! A map by tiles: squares of the floor that are loaded and unloaded, so that memory is bounded by what is around a vehicle.
//!
//! A tile is a value that holds the point sums of its voxels, from the floor to the roof. Since sums of voxels merge in any order to
//! the same bits, so do tiles: a map is the same whether it was built at once, by tile, by several vehicles, or with tiles away.
//! Writing a tile to a file is the caller's (feature `serde`), and to [`merge`](NdtTile::merge) what is unloaded of one tile later
//! with what was before: a sensor that reaches beyond the radius begins tiles anew that are away.

use super::gaussian::{VoxelParams, VoxelSums};
use super::map::NdtMap;
use super::tile::{LONGEST, NdtTile, check_edges, tile_of};
use crate::Error;
use agv_core::{
    check,
    geometry::Se3,
    sensors::{PointCloud, PointSource},
};
use nalgebra::{Vector2, Vector3};
use std::collections::{BTreeMap, BTreeSet};

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
        for tile in raw.loaded {
            check::at_least("voxels of a tile", tile.map.len(), 1)?;
            let [x, y] = tile.index;
            if tiles.loaded.contains_key(&tile.index) {
                return Err(Error::TileNotAway { x, y });
            }
            tiles.merge_tile(&tile)?;
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
    /// more is here then than what is around that place. None for a place that is not finite.
    pub fn unload_beyond(&mut self, center: &Vector2<f64>, radius: f64) -> Vec<NdtTile> {
        if !is_place(center, radius) {
            return Vec::new();
        }
        let far = |index: &[i32; 2]| !self.is_within(*index, center, radius);
        let beyond: Vec<_> = self.loaded.keys().copied().filter(far).collect();
        beyond.into_iter().filter_map(|index| self.unload(index)).collect()
    }

    /// Tiles no farther than `radius` metres from a place that are away, by index: what to load. The cost is that of the tiles around the
    /// place and of the columns of tiles through them, not of all that are away. None for a place that is not finite.
    pub fn missing_within(&self, center: &Vector2<f64>, radius: f64) -> Vec<[i32; 2]> {
        if !is_place(center, radius) {
            return Vec::new();
        }
        // Indices are cut to those that there are, and rounding may leave one more on each side.
        let cell = |at: f64, aside: f64| ((at / self.tile_edge()).floor() + aside) as i32;
        let [low, high] = [(-radius, -1.0), (radius, 1.0)].map(|(off, aside)| center.map(|at| cell(at + off, aside)));
        let mut missing = Vec::new();
        let mut next = [low.x, low.y];
        while let Some(&[x, y]) = self.away.range(next..).next().filter(|[x, _]| *x <= high.x) {
            if y < low.y {
                next = [x, low.y];
                continue;
            }
            if y <= high.y {
                if self.is_within([x, y], center, radius) {
                    missing.push([x, y]);
                }
                if let Some(above) = y.checked_add(1) {
                    next = [x, above];
                    continue;
                }
            }
            let Some(beside) = x.checked_add(1) else { break };
            next = [beside, low.y];
        }
        missing
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

fn is_place(center: &Vector2<f64>, radius: f64) -> bool {
    center.x.is_finite() && center.y.is_finite() && !radius.is_nan()
}

#[cfg(test)]
mod tests;
