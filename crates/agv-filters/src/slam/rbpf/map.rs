//! A map in tiles that particles share until they change them.
//!
//! Tiles hang in regions, regions in a sheet, each behind a counted reference: a copy of a map is one reference, whatever its size,
//! and the first change to a tile of a copy copies that tile and the two tables above it. So resampling costs a reference per
//! particle, and memory grows with the area seen and with what particles see differently since they parted.

use super::tile::{TILE, TILE_BITS, Tile};
use agv_core::{
    Error,
    geometry::Se2,
    grid::{Cell, CellState, Grid, GridLayout, OccupancyThresholds, QUANTUM},
};
use std::sync::Arc;

/// Tiles along the edge of a region, and the binary logarithm of it.
const REGION: i32 = 1 << REGION_BITS;
const REGION_BITS: u32 = 4;
const REGION_TILES: usize = (REGION * REGION) as usize;

/// Most regions of a sheet: 26 km each way at 0.05 m.
const MAX_REGIONS: i64 = 1 << 20;

/// A table of tiles.
#[derive(Debug, Clone)]
pub(super) struct Region {
    tiles: [Option<Arc<Tile>>; REGION_TILES],
}

/// A table of regions: a rectangle, row by row from `corner`.
#[derive(Debug, Clone, Default)]
pub(super) struct Sheet {
    corner: (i32, i32),
    width: i32,
    height: i32,
    regions: Vec<Option<Arc<Region>>>,
}

/// Least and greatest tile along both axes, of a rectangle of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TileRect {
    pub(super) low: (i32, i32),
    pub(super) high: (i32, i32),
}

impl TileRect {
    /// The tiles of the cells from `low` to `high`.
    pub(super) const fn of_cells(low: (i32, i32), high: (i32, i32)) -> Self {
        Self { low: (low.0 >> TILE_BITS, low.1 >> TILE_BITS), high: (high.0 >> TILE_BITS, high.1 >> TILE_BITS) }
    }
}

/// A particle's map: occupancy of square cells on the lattice of the map frame, made of the scans along its trajectory.
///
/// A copy costs one counted reference, and shares with the original whatever neither changes.
#[derive(Debug, Clone)]
pub struct TileMap {
    resolution: f64,
    sheet: Arc<Sheet>,
}

impl Sheet {
    fn index(&self, tile: (i32, i32)) -> Option<usize> {
        let (x, y) = ((tile.0 >> REGION_BITS) - self.corner.0, (tile.1 >> REGION_BITS) - self.corner.1);
        let inside = x >= 0 && y >= 0 && x < self.width && y < self.height;
        inside.then(|| (y * self.width + x) as usize)
    }

    /// The rectangle that holds the present regions and these tiles: corner, width and height.
    fn grown(&self, tiles: &TileRect) -> ((i32, i32), i64, i64) {
        let region = |t: (i32, i32)| (t.0 >> REGION_BITS, t.1 >> REGION_BITS);
        let (mut low, mut high) = (region(tiles.low), region(tiles.high));
        if !self.regions.is_empty() {
            low = (low.0.min(self.corner.0), low.1.min(self.corner.1));
            high = (high.0.max(self.corner.0 + self.width - 1), high.1.max(self.corner.1 + self.height - 1));
        }
        (low, i64::from(high.0) - i64::from(low.0) + 1, i64::from(high.1) - i64::from(low.1) + 1)
    }

    fn grow(&mut self, tiles: &TileRect) {
        let (corner, width, height) = self.grown(tiles);
        let mut regions = vec![None; (width * height) as usize];
        for (i, region) in self.regions.drain(..).enumerate() {
            let (x, y) = (i as i32 % self.width + self.corner.0, i as i32 / self.width + self.corner.1);
            regions[((y - corner.1) * width as i32 + x - corner.0) as usize] = region;
        }
        *self = Self { corner, width: width as i32, height: height as i32, regions };
    }
}

#[inline]
const fn place(tile: (i32, i32)) -> usize {
    ((tile.1 & (REGION - 1)) << REGION_BITS | (tile.0 & (REGION - 1))) as usize
}

impl TileMap {
    /// An empty map of cells of `resolution` metres, which is positive.
    pub(super) fn new(resolution: f64) -> Self {
        Self { resolution, sheet: Arc::default() }
    }

    /// Edge of a cell, in metres.
    pub const fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Whether tiles of this rectangle can be added.
    pub(super) fn check_room(&self, tiles: &TileRect) -> Result<(), Error> {
        let (_, width, height) = self.sheet.grown(tiles);
        if width > MAX_REGIONS || height > MAX_REGIONS || width * height > MAX_REGIONS {
            let len = usize::try_from(width.saturating_mul(height)).unwrap_or(usize::MAX);
            return Err(Error::TooMany { name: "regions of the map", len, max: MAX_REGIONS as usize });
        }
        Ok(())
    }

    #[inline]
    pub(super) fn tile(&self, tile: (i32, i32)) -> Option<&Tile> {
        self.sheet.regions.get(self.sheet.index(tile)?)?.as_ref()?.tiles[place(tile)].as_deref()
    }

    /// The tile to change, made if it is not there; there must be room for it.
    pub(super) fn tile_mut(&mut self, tile: (i32, i32)) -> &mut Tile {
        Arc::make_mut(self.slot(tile).get_or_insert_default())
    }

    fn slot(&mut self, tile: (i32, i32)) -> &mut Option<Arc<Tile>> {
        let sheet = Arc::make_mut(&mut self.sheet);
        let index = sheet.index(tile).unwrap_or_else(|| {
            sheet.grow(&TileRect { low: tile, high: tile });
            sheet.index(tile).unwrap_or_default()
        });
        let region =
            sheet.regions[index].get_or_insert_with(|| Arc::new(Region { tiles: [const { None }; REGION_TILES] }));
        &mut Arc::make_mut(region).tiles[place(tile)]
    }

    /// What tells apart maps that share everything from those that do not.
    #[cfg(feature = "serde")]
    pub(super) fn address(&self) -> usize {
        Arc::as_ptr(&self.sheet).addr()
    }

    /// Hangs a tile in; there must be room for it.
    #[cfg(feature = "serde")]
    pub(super) fn put(&mut self, tile: (i32, i32), content: Arc<Tile>) {
        *self.slot(tile) = Some(content);
    }

    /// All tiles with their coordinates, in a fixed order.
    pub(super) fn tiles(&self) -> impl Iterator<Item = ((i32, i32), &Arc<Tile>)> {
        let sheet = &*self.sheet;
        let regions = sheet.regions.iter().enumerate().filter_map(|(i, region)| Some((i as i32, region.as_ref()?)));
        regions.flat_map(move |(i, region)| {
            let (x, y) = (i % sheet.width + sheet.corner.0, i / sheet.width + sheet.corner.1);
            region.tiles.iter().enumerate().filter_map(move |(j, tile)| {
                let j = j as i32;
                let (tx, ty) = ((x << REGION_BITS) + (j & (REGION - 1)), (y << REGION_BITS) + (j >> REGION_BITS));
                Some(((tx, ty), tile.as_ref()?))
            })
        })
    }

    /// Calls `visit` with every cell that a beam has met, counted from the lower-left of `layout`, and its log-odds of occupancy.
    pub(super) fn for_each_cell(&self, layout: &GridLayout, mut visit: impl FnMut(Cell, f64)) {
        let (left, bottom) = corner_cell(layout);
        for ((x, y), tile) in self.tiles() {
            for (i, evidence) in (0_i32..).zip(tile.evidence()) {
                if let Some(evidence) = evidence {
                    let cell = Cell::new(x * TILE + (i & (TILE - 1)) - left, y * TILE + (i >> TILE_BITS) - bottom);
                    visit(cell, f64::from(evidence) * QUANTUM);
                }
            }
        }
    }

    /// The least rectangle of whole tiles that holds all that was seen.
    ///
    /// # Errors
    /// [`Error::Empty`] for a map without a tile, [`Error::TooMany`] for one that is too wide for a grid.
    pub fn layout(&self) -> Result<GridLayout, Error> {
        let rect = rect_of(self.tiles().map(|(tile, _)| tile)).ok_or(Error::Empty { name: "map" })?;
        layout_of(&rect, self.resolution)
    }

    /// The map for localizers and planners. O(cells).
    ///
    /// # Errors
    /// As [`layout`](Self::layout).
    pub fn states(&self, thresholds: &OccupancyThresholds) -> Result<Grid<CellState>, Error> {
        let layout = self.layout()?;
        let mut states = Grid::filled(layout, CellState::Unknown);
        self.for_each_cell(&layout, |cell, log_odds| {
            states.set(cell, thresholds.state_of_log_odds(log_odds));
        });
        Ok(states)
    }

    /// Calls `visit(address, bytes)` for the tables and tiles of the map; it tells whether to visit what hangs in that table.
    pub(super) fn for_each_part(&self, mut visit: impl FnMut(usize, usize) -> bool) {
        let sheet = &*self.sheet;
        if !visit(Arc::as_ptr(&self.sheet).addr(), size_of::<Sheet>() + sheet.regions.len() * size_of::<usize>()) {
            return;
        }
        for region in sheet.regions.iter().flatten() {
            if visit(Arc::as_ptr(region).addr(), size_of::<Region>()) {
                for tile in region.tiles.iter().flatten() {
                    visit(Arc::as_ptr(tile).addr(), tile.bytes());
                }
            }
        }
    }
}

/// The least rectangle that holds these tiles.
pub(super) fn rect_of(tiles: impl Iterator<Item = (i32, i32)>) -> Option<TileRect> {
    tiles.map(|tile| TileRect { low: tile, high: tile }).reduce(|a, b| TileRect {
        low: (a.low.0.min(b.low.0), a.low.1.min(b.low.1)),
        high: (a.high.0.max(b.high.0), a.high.1.max(b.high.1)),
    })
}

/// The grid of the cells of these tiles.
pub(super) fn layout_of(tiles: &TileRect, resolution: f64) -> Result<GridLayout, Error> {
    let size = |low: i32, high: i32| (i64::from(high) - i64::from(low) + 1) as usize * TILE as usize;
    let corner = |tile: i32| f64::from(tile) * f64::from(TILE) * resolution;
    let origin = Se2::new(corner(tiles.low.0), corner(tiles.low.1), 0.0);
    GridLayout::new(size(tiles.low.0, tiles.high.0), size(tiles.low.1, tiles.high.1), resolution, origin)
}

/// The lattice cell of a layout's lower-left.
fn corner_cell(layout: &GridLayout) -> (i32, i32) {
    let corner = (layout.map_from_grid().translation() / layout.resolution()).map(f64::round);
    (corner.x as i32, corner.y as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use std::collections::HashSet;

    fn bytes(maps: &[&TileMap]) -> usize {
        let (mut known, mut sum) = (HashSet::new(), 0);
        for map in maps {
            map.for_each_part(|address, size| {
                let is_new = known.insert(address);
                sum += if is_new { size } else { 0 };
                is_new
            });
        }
        sum
    }

    fn hit(map: &mut TileMap, tile: (i32, i32)) {
        map.tile_mut(tile).hit(3, 4, &Vector2::new(0.5, 0.5));
    }

    #[test]
    fn copies_share_what_neither_changes() {
        let mut map = TileMap::new(0.05);
        let places: Vec<_> = (-40..40).flat_map(|x| (-3..20).map(move |y| (x, y))).collect();
        for &place in &places {
            hit(&mut map, place);
        }
        assert!(map.tiles().map(|(place, _)| place).collect::<HashSet<_>>() == places.iter().copied().collect());
        let alone = bytes(&[&map]);
        assert!(alone > places.len() * 2048);
        let mut copy = map.clone();
        assert_eq!(bytes(&[&map, &copy]), alone);
        hit(&mut copy, (5, 5));
        let (tile, tables) = (copy.tile((5, 5)).unwrap().bytes(), size_of::<Region>() + size_of::<Sheet>());
        let regions = copy.sheet.regions.len() * size_of::<usize>();
        assert_eq!(bytes(&[&map, &copy]), alone + tile + tables + regions);
        // The one that was copied has not changed, and growing to any side moves nothing.
        assert_eq!(map.tile((5, 5)), map.tile((4, 4)));
        assert_ne!(copy.tile((5, 5)), map.tile((5, 5)));
        hit(&mut copy, (-400, 300));
        assert!(places.iter().filter(|&&place| place != (5, 5)).all(|&place| copy.tile(place) == map.tile(place)));
        assert_eq!((copy.tile((-400, 300)), map.tile((-400, 300))), (map.tile((0, 0)), None));
        assert_eq!(copy.layout().unwrap().width(), 440 * 32);
    }

    #[test]
    fn maps_that_are_absurdly_wide_are_refused() {
        let mut map = TileMap::new(0.05);
        assert_eq!(map.layout(), Err(Error::Empty { name: "map" }));
        hit(&mut map, (0, 0));
        let far = |x, y| map.check_room(&TileRect { low: (x, y), high: (x, y) });
        assert_eq!((far(1 << 20, 0), far(0, -(1 << 20))), (Ok(()), Ok(())));
        assert!(matches!(far(1 << 20, 1 << 20), Err(Error::TooMany { .. })));
        assert!(matches!(far(i32::MIN, i32::MAX), Err(Error::TooMany { .. })));
    }
}
