//! A scan into a map: cells that beams pass, cells where they end, and the normals of the surfaces there.
//!
//! Beams free cells along the exact [`Traversal`] of the mapping grids, tile by tile, so that a shared tile is looked up (and copied
//! if it must be) once per beam that crosses it. Then the ends are counted, and the normals of the surfaces that were met are fitted
//! anew to the means of the surfaces around: the direction of least variance (as in 2D NDT), if there is one.

use super::{
    beams::Beams,
    map::{TileMap, TileRect},
    tile::TILE_BITS,
    view::{AROUND, View},
};
use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{Cell, Traversal},
};
use nalgebra::Vector2;

/// Variance across a surface, beside that along it, from which on surfaces are no line.
const THICKNESS: f64 = 0.1;

/// Inserts a scan taken at `pose`; there must be room for all that it reaches.
pub(super) fn insert(map: &mut TileMap, pose: &Se2, beams: &Beams) {
    let per_metre = 1.0 / map.resolution();
    let in_cells = |point: &Vector2<f64>| pose.act(point) * per_metre;
    let from = in_cells(&beams.origin);
    for end in &beams.ends {
        // There is room, so that no coordinate is too large.
        if let Ok(cells) = Traversal::new(&from, &in_cells(&end.point)) {
            free(map, cells);
        }
    }
    let mut hits = Vec::with_capacity(beams.ends.len());
    for end in beams.ends.iter().filter(|end| end.hit) {
        let place = in_cells(&end.point);
        let lower_left = place.map(f64::floor);
        let cell = Cell::new(lower_left.x as i32, lower_left.y as i32);
        map.tile_mut(tile_of(cell)).hit(cell.x, cell.y, &(place - lower_left));
        hits.push((cell, Vector2::zeros()));
    }
    hits.sort_unstable_by_key(|(cell, _)| (cell.y, cell.x));
    hits.dedup_by_key(|(cell, _)| (cell.y, cell.x));
    fit_normals(map, &mut hits);
    for (cell, normal) in &hits {
        map.tile_mut(tile_of(*cell)).set_normal(cell.x, cell.y, normal);
    }
}

#[inline]
const fn tile_of(cell: Cell) -> (i32, i32) {
    (cell.x >> TILE_BITS, cell.y >> TILE_BITS)
}

/// Passes all cells but the last.
fn free(map: &mut TileMap, mut cells: Traversal) {
    let Some(mut cell) = cells.next() else { return };
    loop {
        let at = tile_of(cell);
        let tile = map.tile_mut(at);
        loop {
            let Some(next) = cells.next() else { return };
            tile.pass(cell.x, cell.y);
            cell = next;
            if tile_of(cell) != at {
                break;
            }
        }
    }
}

fn fit_normals(map: &TileMap, hits: &mut [(Cell, Vector2<f64>)]) {
    let corners = |(cell, _): &(Cell, Vector2<f64>)| ((cell.x, cell.y), (cell.x, cell.y));
    let Some((low, high)) = hits.iter().map(corners).reduce(|(low, high), (cell, _)| {
        ((low.0.min(cell.0), low.1.min(cell.1)), (high.0.max(cell.0), high.1.max(cell.1)))
    }) else {
        return;
    };
    let margin = AROUND + 1;
    let rect = TileRect::of_cells((low.0 - margin, low.1 - margin), (high.0 + margin, high.1 + margin));
    let view = View::new(map, &rect);
    for (cell, normal) in hits {
        *normal = fitted(&view, *cell);
    }
}

/// Normal of the line through the surfaces around a cell; zero if there is none.
fn fitted(view: &View<'_>, cell: Cell) -> Vector2<f64> {
    let middle = Vector2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5);
    let (mut count, mut sum) = (0.0, Vector2::zeros());
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    view.surfaces_around(cell.x, cell.y, |point| {
        let d = point - middle;
        (count, sum) = (count + 1.0, sum + d);
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    });
    if count < 3.0 {
        return Vector2::zeros();
    }
    let mean = sum / count;
    let (xx, xy, yy) = (xx / count - mean.x * mean.x, xy / count - mean.x * mean.y, yy / count - mean.y * mean.y);
    // Half of the angle of (xx - yy, 2 xy) is the direction of the line (closed form of the eigenvectors).
    let (difference, twice) = (xx - yy, 2.0 * xy);
    let (trace, spread) = (xx + yy, (difference * difference + twice * twice).sqrt());
    if trace - spread > THICKNESS * (trace + spread) {
        return Vector2::zeros();
    }
    let along = 0.5 * twice.atan2(difference);
    Vector2::new(-along.sin(), along.cos())
}
