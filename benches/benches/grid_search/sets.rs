//! Maps and queries: the shared sets W, D and C, or a synthetic warehouse where they are not there.

use crate::search;
use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
use agv_plan::grid::{GridParams, GridSpace, Workspace, Zero};
use agv_support::movingai::{Query, read_map, read_scenario};
use std::path::PathBuf;

pub(crate) struct Set {
    pub(crate) name: &'static str,
    pub(crate) costmap: Costmap,
    pub(crate) space: GridSpace,
    pub(crate) queries: Vec<Query>,
}

pub(crate) fn sets() -> Vec<Set> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/gridplan"));
    let files = [("W", "warehouse-20-40-10-2-2"), ("D", "brc202d"), ("C", "Berlin_1_1024")];
    let mut sets: Vec<Set> = files
        .into_iter()
        .filter_map(|(name, map)| {
            let costmap = Costmap::from_map(&read_map(folder.join(format!("movingai/{map}.map.gz"))).ok()?);
            let queries = read_scenario(folder.join(format!("bench/{name}.scen.gz"))).ok()?;
            Some(set(name, costmap, queries))
        })
        .collect();
    if sets.is_empty() {
        eprintln!("the shared maps are not there: a synthetic warehouse stands in");
        sets.push(synthetic());
    }
    sets
}

fn set(name: &'static str, costmap: Costmap, queries: Vec<Query>) -> Set {
    let mut space = GridSpace::new(GridParams::default()).unwrap();
    space.update(&costmap);
    Set { name, costmap, space, queries }
}

/// Blocks of racks with aisles of two cells, 340 x 164 as the public warehouse; optima by Dijkstra.
fn synthetic() -> Set {
    let layout = GridLayout::new(340, 164, 1.0, Se2::default()).unwrap();
    let rack = |c: Cell| c.x % 14 >= 2 && c.y % 4 >= 2 && (10..330).contains(&c.x) && (4..160).contains(&c.y);
    let state = |i| if rack(layout.cell(i)) { CellState::Occupied } else { CellState::Free };
    let costmap = Costmap::from_map(&Grid::new(layout, (0..layout.len()).map(state).collect()).unwrap());
    let free: Vec<Cell> = (0..layout.len()).map(|i| layout.cell(i)).filter(|&c| !rack(c)).collect();
    let pick = |k: usize| free[k * 7919 % free.len()];
    let size = (layout.width(), layout.height());
    let query = |k: usize| Query {
        bucket: 0,
        map: "synthetic".into(),
        size,
        start: pick(2 * k),
        goal: pick(2 * k + 1),
        optimal_length: f64::NAN,
    };
    let queries = (0..200).map(query).collect();
    let mut set = set("synthetic", costmap, queries);
    let mut workspace = Workspace::default();
    for i in 0..set.queries.len() {
        let query = set.queries[i].clone();
        search(&set.space, &mut workspace, &Zero, &query);
        let mut way = Vec::new();
        workspace.trace_into(&set.space.uniform(), set.space.node(query.goal).unwrap(), &mut way);
        set.queries[i].optimal_length = set.space.path_cost(&way);
    }
    set
}
