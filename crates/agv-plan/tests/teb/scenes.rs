//! Worlds of cylinders and of walls, and paths through them.

use agv_core::{
    compute::Seed,
    geometry::Se2,
    grid::{
        Cell, CellState, Costmap, Footprint, Grid, GridLayout, Inflation, InflationParams, LocalMap, LocalMapParams,
        cost,
    },
    nalgebra::Vector2,
    path::Path,
    roles::{GlobalPlanner, PlanOutcome},
};
use agv_plan::{
    grid::{AStar, AStarParams, GridParams},
    smooth::{KeyNodes, LineOfSightParams, PathSmoother},
};
use rand_distr::{Bernoulli, Distribution};

pub(crate) fn footprint() -> Footprint {
    Footprint::rectangle(-0.254, 0.254, 0.43).unwrap()
}

/// An empty hall of 0.05 m cells.
pub(crate) fn hall(width: f64, height: f64) -> Costmap {
    let layout = GridLayout::new((width / 0.05) as usize, (height / 0.05) as usize, 0.05, Se2::default()).unwrap();
    Costmap::from_map(&Grid::filled(layout, CellState::Free))
}

/// Marks the cells of a disc as lethal.
pub(crate) fn disc(costmap: &mut Costmap, center: Vector2<f64>, radius: f64) {
    let layout = *costmap.layout();
    for i in 0..layout.len() {
        let cell = layout.cell(i);
        if (layout.center(cell) - center).norm() <= radius {
            costmap.set(cell, cost::LETHAL);
        }
    }
}

/// A field of cylinders between two free ends, as the BARN data set makes them: random cells of 0.15 m, smoothed by a cellular
/// automaton.
pub(crate) fn cylinders(seed: u64, fill: f64) -> Costmap {
    let (width, height) = (30_usize, 40_usize);
    let mut stream = Seed(seed).stream(0, 0);
    let filled = Bernoulli::new(fill).unwrap();
    let mut cells: Vec<bool> = (0..width * height).map(|_| filled.sample(&mut stream)).collect();
    for _ in 0..4 {
        let old = cells.clone();
        for (i, cell) in cells.iter_mut().enumerate() {
            let (x, y) = ((i % width) as i32, (i / width) as i32);
            let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + dx, y + dy)));
            let count = around
                .filter(|&(a, b)| (a, b) != (x, y) && a >= 0 && b >= 0 && a < width as i32 && b < height as i32)
                .filter(|&(a, b)| old[b as usize * width + a as usize])
                .count();
            *cell = if old[i] { count >= 2 } else { count >= 5 };
        }
    }
    let mut costmap = hall(4.5, 10.0);
    for row in 0..200 {
        costmap.set(Cell::new(0, row), cost::LETHAL);
        costmap.set(Cell::new(89, row), cost::LETHAL);
    }
    for (i, _) in cells.iter().enumerate().filter(|(_, filled)| **filled) {
        let center = Vector2::new((i % width) as f64 * 0.15 + 0.075, (i / width) as f64 * 0.15 + 2.0);
        disc(&mut costmap, center, 0.075);
    }
    costmap
}

/// The way from the lower to the upper end that keeps 0.3 m of clearance if it can; none if there is none.
pub(crate) fn path_through(costmap: &Costmap, start: &Se2, goal: &Se2) -> Option<Path> {
    let states = costmap.costs().iter().map(|&c| if c == cost::LETHAL { CellState::Occupied } else { CellState::Free });
    let map = Grid::new(*costmap.layout(), states.collect()).unwrap();
    let params = InflationParams { inscribed_radius: 0.34, inflation_radius: 0.6, ..InflationParams::default() };
    let inflated = Inflation::new(params).unwrap().inflate(&map).unwrap();
    let grid = GridParams { cost_weight: 3.0, ..GridParams::default() };
    let mut planner = AStar::new(AStarParams { grid, ..AStarParams::default() }).unwrap();
    let mut path = Path::new();
    match planner.plan_into(&inflated, start, goal, &mut path) {
        Ok(PlanOutcome::Found { .. }) => {
            let mut smooth = Path::new();
            let sight = LineOfSightParams { max_cost: 120, ..LineOfSightParams::default() };
            KeyNodes::new(sight).unwrap().smooth_into(&inflated, &path, &mut smooth).unwrap();
            Some(smooth)
        }
        _ => None,
    }
}

pub(crate) fn local(costmap: &Costmap) -> LocalMap {
    LocalMap::new(costmap, LocalMapParams::default()).unwrap()
}

/// A wall across the hall with a gap.
pub(crate) fn wall(costmap: &mut Costmap, x: f64, gap: (f64, f64)) {
    let layout = *costmap.layout();
    let column = (x / 0.05) as i32;
    for row in 0..layout.height() as i32 {
        let y = layout.center(Cell::new(column, row)).y;
        if y < gap.0 || y > gap.1 {
            costmap.set(Cell::new(column, row), cost::LETHAL);
        }
    }
}
