//! A square of a map of normal distributions, as a value that is stored and merged.

use super::map::NdtMap;
use crate::Error;
#[cfg(feature = "serde")]
use agv_core::check;

/// Most voxels along a tile's edge.
pub(super) const LONGEST: usize = 1 << 16;

/// A square of a map, with its sums.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawTile"))]
pub struct NdtTile {
    pub(super) index: [i32; 2],
    pub(super) tile_voxels: usize,
    pub(super) map: NdtMap,
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
            if tile_of(cell, tile_voxels) != index {
                return Err(Error::VoxelOutsideTile { voxel: cell, tile: index });
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
    /// [`Error::TileMismatch`] for another tile, [`Error::MapMismatch`] for another edge or other voxels; this one is then as it was.
    pub fn merge(&mut self, part: &Self) -> Result<(), Error> {
        self.map.check_like(&part.map)?;
        check_edges(self.tile_voxels, part.tile_voxels)?;
        if self.index != part.index {
            return Err(Error::TileMismatch { left: self.index, right: part.index });
        }
        for (cell, sums) in part.map.voxels() {
            self.map.merge_voxel(cell, sums);
        }
        Ok(())
    }
}

pub(super) fn check_edges(left: usize, right: usize) -> Result<(), Error> {
    if left == right {
        return Ok(());
    }
    Err(Error::MapMismatch { name: "voxels along a tile's edge", left: left as f64, right: right as f64 })
}

/// The tile of a voxel.
pub(super) fn tile_of([x, y, _]: [i32; 3], tile_voxels: usize) -> [i32; 2] {
    [x, y].map(|voxel| voxel.div_euclid(tile_voxels as i32))
}
