//! A scan into a map: cells that beams pass, cells where they end, and the normals of the surfaces there.
//!
//! Beams free cells along the exact [`Traversal`] of the mapping grids, tile by tile, so that a shared tile is looked up (and copied
//! if it must be) once per beam that crosses it. Then the ends are counted, and the normals of the surfaces that were met are fitted
//! anew to the means of the surfaces around: the direction of least variance (as in 2D NDT), if there is one.

use super::{
    beams::Beams,
    map::{TileMap, TileRect},
    tile::{TILE_BITS, Tile},
    view::{AROUND, View, ViewMemory},
};
use crate::matching::{LineSums, room_of};
use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{Cell, Traversal},
};
use nalgebra::Vector2;

/// Memory of a particle, which serves from scan to scan.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    pub(super) view: ViewMemory,
    /// Cells in which beams ended, and the normals there.
    hits: Vec<(Cell, Vector2<f64>)>,
}

impl Scratch {
    /// Bytes of it.
    pub(super) const fn memory(&self) -> usize {
        self.view.capacity() * size_of::<Option<&Tile>>() + room_of(&self.hits)
    }
}

/// Inserts a scan taken at `pose`; there must be room for all that it reaches.
pub(super) fn insert(map: &mut TileMap, pose: &Se2, beams: &Beams, scratch: &mut Scratch) {
    let per_metre = 1.0 / map.resolution();
    let in_cells = |point: &Vector2<f64>| pose.act(point) * per_metre;
    let from = in_cells(&beams.origin);
    for end in &beams.ends {
        // There is room, so that no coordinate is too large.
        if let Ok(cells) = Traversal::new(&from, &in_cells(&end.point)) {
            free(map, cells);
        }
    }
    let Scratch { view, hits } = scratch;
    hits.clear();
    for end in beams.ends.iter().filter(|end| end.hit) {
        let place = in_cells(&end.point);
        let lower_left = place.map(f64::floor);
        let cell = Cell::new(lower_left.x as i32, lower_left.y as i32);
        map.tile_mut(tile_of(cell)).hit(cell.x, cell.y, &(place - lower_left));
        hits.push((cell, Vector2::zeros()));
    }
    hits.sort_unstable_by_key(|(cell, _)| (cell.y, cell.x));
    hits.dedup_by_key(|(cell, _)| (cell.y, cell.x));
    fit_normals(map, hits, view);
    for (cell, normal) in hits {
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

fn fit_normals(map: &TileMap, hits: &mut [(Cell, Vector2<f64>)], memory: &mut ViewMemory) {
    let corners = |(cell, _): &(Cell, Vector2<f64>)| ((cell.x, cell.y), (cell.x, cell.y));
    let Some((low, high)) = hits.iter().map(corners).reduce(|(low, high), (cell, _)| {
        ((low.0.min(cell.0), low.1.min(cell.1)), (high.0.max(cell.0), high.1.max(cell.1)))
    }) else {
        return;
    };
    let margin = AROUND + 1;
    let rect = TileRect::of_cells((low.0 - margin, low.1 - margin), (high.0 + margin, high.1 + margin));
    let view = View::new(map, &rect, memory);
    for (cell, normal) in hits {
        *normal = fitted(&view, *cell);
    }
    view.put_back(memory);
}

/// Normal of the line through the surfaces around a cell; zero if there is none.
fn fitted(view: &View<'_>, cell: Cell) -> Vector2<f64> {
    let middle = Vector2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5);
    let mut sums = LineSums::default();
    view.surfaces_around(cell.x, cell.y, |point| sums.add(&(point - middle)));
    sums.line().map_or_else(Vector2::zeros, |line| line.normal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::RbpfParams;
    use agv_core::{
        compute::Seed,
        grid::{EvidenceGrid, GridLayout, InverseModelParams},
        sensors::{LaserScan, ScanGeometry},
        time::Stamp,
    };
    use rand::RngExt;

    /// Scans of any shape from anywhere, across tiles and regions.
    fn scans() -> Vec<(Se2, LaserScan)> {
        let mut stream = Seed(3).stream(0, 0);
        (0..6)
            .map(|_| {
                let mut within = |low: f64, high: f64| stream.random_range(low..high);
                let pose = Se2::new(within(-20.0, 5.0), within(-3.0, 30.0), within(-3.0, 3.0));
                let ranges = (0..200).map(|i| if i % 9 == 0 { f32::INFINITY } else { within(0.1, 9.0) as f32 });
                let geometry = ScanGeometry { angle_increment: 0.03, range_max: 8.0, ..ScanGeometry::default() };
                (pose, LaserScan::new(Stamp::default(), geometry, ranges.collect()).unwrap())
            })
            .collect()
    }

    fn mapped(params: &RbpfParams) -> TileMap {
        let (mut map, mut beams) = (TileMap::new(params.resolution), Beams::default());
        for (pose, scan) in scans() {
            beams.read(&scan, &params.inverse_model().unwrap(), 1000);
            insert(&mut map, &pose, &beams, &mut Scratch::default());
        }
        map
    }

    #[test]
    fn cells_know_what_those_of_the_mapping_grid_know() {
        let params = RbpfParams { max_range: 7.0, ..RbpfParams::default() };
        let map = mapped(&params);
        let layout = map.layout().unwrap();
        let model = InverseModelParams { max_range: Some(7.0), protect_hits: false, ..InverseModelParams::default() };
        let mut grid = EvidenceGrid::new(GridLayout::new(8, 8, 0.05, Se2::default()).unwrap(), model).unwrap();
        for (pose, scan) in scans() {
            grid.insert_scan(&scan, &pose).unwrap();
        }
        let (mut same, mut cells) = (0, 0);
        map.for_each_cell(&layout, |cell, log_odds| {
            let there = grid.layout().cell_at(&layout.center(cell)).and_then(|cell| grid.log_odds(cell));
            same += usize::from(there.is_some_and(|there| (there - log_odds).abs() < 1e-9));
            cells += 1;
        });
        // The two round the ends of beams at different places: some lie on the other side of a line.
        assert!(cells > 50_000 && same + 30 >= cells, "{same} of {cells}");
        let known = grid.evidence().iter().filter(|&&evidence| evidence != 0).count();
        assert!(known <= cells && known + 200 > cells, "{known} {cells}");
    }

    #[test]
    fn the_nearest_surface_is_that_of_trying_all() {
        let map = mapped(&RbpfParams::default());
        let mut surfaces = Vec::new();
        for ((x, y), tile) in map.tiles() {
            for (i, evidence) in (0_i32..).zip(tile.evidence()) {
                let (x, y) = (x * 32 + i % 32, y * 32 + i / 32);
                if evidence.is_some_and(|evidence| evidence > 0) {
                    let mean = tile.ends(x, y).unwrap().mean();
                    surfaces.push(Vector2::new(f64::from(x), f64::from(y)) + mean);
                }
            }
        }
        assert!(surfaces.len() > 300, "{}", surfaces.len());
        let view = View::new(&map, &TileRect::of_cells((-700, -400), (400, 900)), &mut Vec::new());
        let mut stream = Seed(4).stream(0, 0);
        let (mut met, mut farther) = (0, 0.0_f64);
        for surface in surfaces.iter().cycle().take(3000) {
            let place = surface + Vector2::from_fn(|_, _| stream.random_range(-4.0..4.0));
            let cell = |v: &Vector2<f64>| v.map(f64::floor);
            let seen = surfaces.iter().filter(|s| (cell(s) - cell(&place)).amax() <= f64::from(AROUND));
            let least = seen.map(|s| (s - place).norm()).min_by(f64::total_cmp);
            let found = view.nearest(&place).map(|found| found.off.norm());
            assert_eq!(found.is_some(), least.is_some());
            if let (Some(found), Some(least)) = (found, least) {
                met += 1;
                farther = farther.max(found - least);
            }
        }
        assert!(met > 1000 && farther < 1e-12, "{met} {farther}");
    }

    #[test]
    fn walls_have_normals() {
        let (params, mut map, mut beams) = (RbpfParams::default(), TileMap::new(0.05), Beams::default());
        let geometry = ScanGeometry { angle_min: -0.5, angle_increment: 0.005, ..ScanGeometry::default() };
        // A wall 2 m ahead, whose normal is turned by 0.3 rad.
        let range = |a: f64| (2.0 / (a - 0.3).cos()) as f32;
        let ranges = (0..200).map(|i| range(geometry.angle(i))).collect();
        let scan = LaserScan::new(Stamp::default(), geometry, ranges).unwrap();
        beams.read(&scan, &params.inverse_model().unwrap(), 1000);
        insert(&mut map, &Se2::default(), &beams, &mut Scratch::default());
        let view = View::new(&map, &TileRect::of_cells((-10, -60), (80, 60)), &mut Vec::new());
        for end in &beams.points {
            let surface = view.nearest(&(end / 0.05)).unwrap();
            let expected = Vector2::new(0.3_f64.cos(), 0.3_f64.sin());
            assert!(surface.normal.dot(&expected).abs() > 0.99, "{}", surface.normal);
            assert!(surface.normal.dot(&surface.off).abs() < 0.2);
        }
    }
}
