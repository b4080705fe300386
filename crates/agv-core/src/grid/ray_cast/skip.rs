//! How far a ray may run unseen: free wedges.
//!
//! All rays through a cell whose slope lies in one sector stay, over the next `n` columns, in a wedge of cells. The
//! table holds, per sector and cell, a number of columns for which that wedge is free. With sectors of slope
//! `[a/p, (a+1)/p]` a ray is, after `p` columns, `a` or `a + 1` rows on, so
//!
//! ```text
//! n(c) = 0 if one of the cells of the next p columns is occupied, else p + min(n(c + (p, a)), n(c + (p, a + 1)))
//! ```
//!
//! which one sweep against the direction fills.

use super::{Raster, Ray};

/// Slope sectors per octant.
pub(super) const SECTORS: usize = 2;

/// Free columns ahead, by sector and cell.
#[derive(Debug, Clone)]
pub(super) struct Wedges {
    tables: Vec<Vec<u8>>,
}

/// Which table serves a ray.
#[inline]
fn sector(ray: &Ray) -> usize {
    let part = ((ray.slope.unsigned_abs() * SECTORS as u64) >> 32) as usize;
    let octant = usize::from(ray.along_x) | usize::from(ray.step > 0) << 1 | usize::from(ray.slope >= 0) << 2;
    octant * SECTORS + part.min(SECTORS - 1)
}

impl Wedges {
    pub(super) fn new(raster: &Raster) -> Self {
        let table = |index: usize| {
            let octant = index / SECTORS;
            build(raster, octant & 1 != 0, octant & 2 != 0, octant & 4 != 0, index % SECTORS)
        };
        Self { tables: (0..8 * SECTORS).map(table).collect() }
    }

    #[inline]
    pub(super) fn of(&self, ray: &Ray) -> &[u8] {
        &self.tables[sector(ray)]
    }
}

fn build(raster: &Raster, along_x: bool, forward: bool, rising: bool, part: usize) -> Vec<u8> {
    let (columns, rows) = if along_x { (raster.width, raster.height) } else { (raster.height, raster.width) };
    let at =
        |column: usize, row: usize| if along_x { row * raster.width + column } else { column * raster.width + row };
    // Wedge coordinates count along the ray's direction; the border of the raster is occupied.
    let place = |i: usize, j: usize| {
        (i < columns && j < rows)
            .then(|| at(if forward { i } else { columns - 1 - i }, if rising { j } else { rows - 1 - j }))
    };
    let mut table = vec![0_u8; raster.cells.len()];
    for i in (0..columns).rev() {
        for j in (0..rows).rev() {
            let free = (0..SECTORS).all(|k| {
                let (low, high) = (part * k / SECTORS, ((part + 1) * (k + 1)).div_ceil(SECTORS));
                (low..=high).all(|r| place(i + k, j + r).is_some_and(|p| raster.cells[p] == 0))
            });
            if free {
                let next = |r: usize| place(i + SECTORS, j + r).map_or(0, |p| table[p]);
                let ahead = next(part).min(next(part + 1));
                if let Some(p) = place(i, j) {
                    table[p] = ahead.saturating_add(SECTORS as u8);
                }
            }
        }
    }
    table
}
