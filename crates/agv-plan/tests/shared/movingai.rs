//! Just enough of the `MovingAI` formats for tests and benches: a map as a costmap, a scenario as queries.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
use std::{fs::File, io::Read, path::Path};

/// A query of a scenario, in cells; y counts as in the file, which is also how the costmap is laid out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Query {
    /// Where it starts.
    pub(crate) start: Cell,
    /// Where it ends.
    pub(crate) goal: Cell,
    /// Stated length of the shortest path, in cells.
    pub(crate) optimum: f64,
}

fn text(path: &Path) -> Option<String> {
    let mut text = String::new();
    flate2::read::GzDecoder::new(File::open(path).ok()?).read_to_string(&mut text).ok()?;
    Some(text)
}

/// A `.map.gz` as a costmap of 1 m cells; none if there is no such file.
pub(crate) fn read_map(path: &Path) -> Option<Costmap> {
    let text = text(path)?;
    let rows: Vec<&str> = text.lines().skip_while(|line| line.trim() != "map").skip(1).collect();
    let (width, height) = (rows.first()?.trim_end().len(), rows.iter().filter(|r| !r.trim().is_empty()).count());
    let layout = GridLayout::new(width, height, 1.0, Se2::default()).ok()?;
    let states = rows.iter().flat_map(|row| row.trim_end().bytes());
    let state = |b| if matches!(b, b'.' | b'G' | b'S') { CellState::Free } else { CellState::Occupied };
    Some(Costmap::from_map(&Grid::new(layout, states.map(state).collect()).ok()?))
}

/// The queries of a `.scen.gz`; none if there is no such file.
pub(crate) fn read_scenario(path: &Path) -> Option<Vec<Query>> {
    let query = |line: &str| {
        let fields: Vec<&str> = line.split('\t').map(str::trim).collect();
        let cell = |x: &str, y: &str| Some(Cell::new(x.parse().ok()?, y.parse().ok()?));
        let [_, _, _, _, sx, sy, gx, gy, optimum] = fields[..] else { return None };
        Some(Query { start: cell(sx, sy)?, goal: cell(gx, gy)?, optimum: optimum.parse().ok()? })
    };
    Some(text(path)?.lines().filter_map(query).collect())
}
