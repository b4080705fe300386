//! A map as scan matching reads it: the nearest surface to a place.
//!
//! The tiles that a scan can meet are looked up once. Around a place seven by seven bits tell where surfaces are, and masks of equal
//! distance which of them are worth a look: mostly two or three cells instead of 49.

use super::{
    map::{TileMap, TileRect},
    tile::{TILE, TILE_BITS, Tile},
};
use nalgebra::Vector2;

/// Cells to each side of a place that are looked at.
pub(super) const AROUND: i32 = 3;
const SIDE: u32 = 2 * AROUND as u32 + 1;

/// Cells from the origin beyond which no map has any.
const FARTHEST_PLACE: f64 = 1e9;

/// A surface near a place, in cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surface {
    /// From the surface's point to the place.
    pub(super) off: Vector2<f64>,
    /// Unit normal of the surface; zero if it is on no line.
    pub(super) normal: Vector2<f64>,
}

/// Memory of views, which serves one after the other: always empty.
pub(super) type ViewMemory = Vec<Option<&'static Tile>>;

/// The tiles of a rectangle.
pub(super) struct View<'a> {
    low: (i32, i32),
    width: i32,
    tiles: Vec<Option<&'a Tile>>,
}

/// The same memory for tiles of another map. Collecting from a vector into one of the same layout takes its memory.
fn emptied<'b>(mut tiles: Vec<Option<&Tile>>) -> Vec<Option<&'b Tile>> {
    tiles.clear();
    tiles.into_iter().map(|_| None).collect()
}

/// Cells by their distance from the middle: bits of those equally near, nearest first.
const RINGS: [u64; 10] = rings();

/// Least squared distance of points in the two cells, for each ring.
const NEAREST: [f64; 10] = [0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 4.0, 4.0, 5.0, 8.0];

const fn rings() -> [u64; 10] {
    let squares = [0, 1, 2, 4, 5, 8, 9, 10, 13, 18];
    let mut rings = [0; 10];
    let mut i = 0;
    while i < 10 {
        let mut bit = 0;
        while bit < SIDE * SIDE {
            let (x, y) = ((bit % SIDE) as i32 - AROUND, (bit / SIDE) as i32 - AROUND);
            if x * x + y * y == squares[i] {
                rings[i] |= 1 << bit;
            }
            bit += 1;
        }
        i += 1;
    }
    rings
}

impl<'a> View<'a> {
    /// The tiles of `map` in this rectangle, which must not be absurdly large, in `memory` until that is given back.
    pub(super) fn new(map: &'a TileMap, rect: &TileRect, memory: &mut ViewMemory) -> Self {
        let width = rect.high.0 - rect.low.0 + 1;
        let rows = rect.low.1..=rect.high.1;
        let mut tiles = emptied(std::mem::take(memory));
        tiles.extend(rows.flat_map(|y| (rect.low.0..=rect.high.0).map(move |x| map.tile((x, y)))));
        Self { low: rect.low, width, tiles }
    }

    /// Gives the memory back.
    pub(super) fn put_back(self, memory: &mut ViewMemory) {
        *memory = emptied(self.tiles);
    }

    #[inline]
    fn tile(&self, x: i32, y: i32) -> Option<&'a Tile> {
        let (column, row) = ((x >> TILE_BITS) - self.low.0, (y >> TILE_BITS) - self.low.1);
        if column < 0 || column >= self.width || row < 0 {
            return None;
        }
        *self.tiles.get(row as usize * self.width as usize + column as usize)?
    }

    /// Bits of the surfaces around a cell, row by row from the lower-left.
    #[inline]
    fn bits(&self, x: i32, y: i32) -> u64 {
        let (left, bottom) = (x - AROUND, y - AROUND);
        let (column, mut bits) = ((left & (TILE - 1)) as u32, 0);
        for row in 0..SIDE {
            let at = bottom + row as i32;
            let mut word = self.tile(left, at).map_or(0, |tile| u64::from(tile.surfaces(at)));
            if column + SIDE > TILE as u32 {
                word |= self.tile(left + SIDE as i32, at).map_or(0, |tile| u64::from(tile.surfaces(at))) << TILE;
            }
            bits |= ((word >> column) & ((1 << SIDE) - 1)) << (row * SIDE);
        }
        bits
    }

    /// The surface nearest to a place in cells, among those of the cells around.
    #[inline]
    pub(super) fn nearest(&self, place: &Vector2<f64>) -> Option<Surface> {
        // So that coordinates around it are numbers too.
        if place.amax() > FARTHEST_PLACE {
            return None;
        }
        let (x, y) = (place.x.floor() as i32, place.y.floor() as i32);
        let bits = self.bits(x, y);
        if bits == 0 {
            return None;
        }
        let (mut best, mut least) = (None, f64::INFINITY);
        for (ring, nearest) in RINGS.iter().zip(NEAREST) {
            // Place and mean may lie anywhere in their cells.
            if least <= nearest {
                break;
            }
            let mut candidates = bits & ring;
            while candidates != 0 {
                let bit = candidates.trailing_zeros();
                candidates &= candidates - 1;
                let (cx, cy) = (x - AROUND + (bit % SIDE) as i32, y - AROUND + (bit / SIDE) as i32);
                let Some(ends) = self.tile(cx, cy).and_then(|tile| tile.ends(cx, cy)) else { continue };
                let off = place - (Vector2::new(f64::from(cx), f64::from(cy)) + ends.mean());
                let squared = off.norm_squared();
                if squared < least {
                    (best, least) = (Some((off, ends)), squared);
                }
            }
        }
        best.map(|(off, ends)| Surface { off, normal: ends.normal() })
    }

    /// Calls `visit` with the mean of each surface around a cell, in cells.
    pub(super) fn surfaces_around(&self, x: i32, y: i32, mut visit: impl FnMut(Vector2<f64>)) {
        let mut bits = self.bits(x, y);
        while bits != 0 {
            let bit = bits.trailing_zeros();
            bits &= bits - 1;
            let (cx, cy) = (x - AROUND + (bit % SIDE) as i32, y - AROUND + (bit / SIDE) as i32);
            if let Some(ends) = self.tile(cx, cy).and_then(|tile| tile.ends(cx, cy)) {
                visit(Vector2::new(f64::from(cx), f64::from(cy)) + ends.mean());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_serves_one_view_after_the_other() {
        let (mut memory, rect) = (ViewMemory::new(), TileRect { low: (-3, 2), high: (8, 9) });
        let (first, second) = (TileMap::new(0.05), TileMap::new(0.1));
        let view = View::new(&first, &rect, &mut memory);
        let (place, room) = (view.tiles.as_ptr().addr(), view.tiles.capacity());
        view.put_back(&mut memory);
        assert_eq!((memory.as_ptr().addr(), memory.capacity(), memory.len()), (place, room, 0));
        let view = View::new(&second, &rect, &mut memory);
        assert_eq!((view.tiles.as_ptr().addr(), view.tiles.len()), (place, 12 * 8));
    }
}
