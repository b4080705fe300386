//! Maps with start, goal and optima: of a folder, or seeded ones of the paper's sizes and densities.

use super::{
    Result,
    trials::{Spread, Summary},
};
use agv_nav::{
    core::{
        compute::Seed,
        geometry::Se2,
        grid::{Cell, CellState, Costmap, Grid, GridLayout},
        path::Path,
        roles::{GlobalPlanner, PlanOutcome},
    },
    plan::grid::{AStar, AStarParams, Anya, GridPlannerParams},
};
use agv_support::{Input, movingai::read_map};
use rand::RngExt;
use std::fmt::Write as _;

/// One query.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) map: Grid<CellState>,
    pub(crate) costmap: Costmap,
    pub(crate) start: Se2,
    pub(crate) goal: Se2,
    /// Length of the shortest octile path that cuts no corner, in metres.
    pub(crate) octile: f64,
    /// Length of the shortest path of any angle, in metres.
    pub(crate) any_angle: f64,
}

/// Queries that are counted together.
pub(crate) struct Set {
    pub(crate) key: &'static str,
    pub(crate) title: String,
    pub(crate) cases: Vec<Case>,
}

/// Columns and rows of the cells where the paper starts and ends, y upwards.
const CORNERS_20: [(i32, i32); 2] = [(0, 19), (19, 0)];
const TABLE_3: [(i32, i32); 2] = [(1, 0), (18, 18)];
const TABLE_4: [(i32, i32); 2] = [(3, 0), (47, 45)];
const CORNERS_50: [(i32, i32); 2] = [(0, 49), (49, 0)];
/// The paper's best length without key nodes: 10 + 14 √2.
const PAPER_OPTIMUM: f64 = 10.0 + 14.0 * std::f64::consts::SQRT_2;

impl Case {
    /// The query, if start and goal are free and joined.
    fn new(name: impl Into<String>, map: &Grid<CellState>, [start, goal]: [(i32, i32); 2]) -> Result<Option<Self>> {
        let cells = [start, goal].map(|(x, y)| Cell::new(x, y));
        let costmap = Costmap::from_map(map);
        if cells.iter().any(|&cell| !costmap.is_traversable(cell)) {
            return Ok(None);
        }
        let [start, goal] = cells.map(|cell| map.layout().center(cell)).map(|point| Se2::new(point.x, point.y, 0.0));
        let outcome = AStar::new(AStarParams::default())?.plan_into(&costmap, &start, &goal, &mut Path::new())?;
        let PlanOutcome::Found { cost: octile, .. } = outcome else { return Ok(None) };
        let outcome = Anya::new(GridPlannerParams::default())?.plan_into(&costmap, &start, &goal, &mut Path::new())?;
        let PlanOutcome::Found { cost: any_angle, .. } = outcome else { return Ok(None) };
        Ok(Some(Self { name: name.into(), map: map.clone(), costmap, start, goal, octile, any_angle }))
    }
}

/// The maps of a folder, sorted into the sets by their size. Optima are computed, and must be those of `reference.csv`.
pub(crate) fn read(folder: &std::path::Path) -> Result<Vec<Set>> {
    let reference = Input::read(folder.join("reference.csv"))?;
    let mut sets = empty_sets();
    for line in reference.data_lines().skip(1) {
        let (number, text) = line?;
        let fields: Vec<&str> = text.split(',').collect();
        let value = |column: usize, name: &str| {
            let field = fields.get(column).and_then(|field| field.trim().parse::<f64>().ok());
            field
                .filter(|v| v.is_finite())
                .ok_or_else(|| reference.line_error(number, format_args!("no number for {name}")))
        };
        let name = *fields.first().unwrap_or(&"");
        let map = read_map(folder.join(format!("{name}.map")))?;
        let (width, height) = (map.layout().width(), map.layout().height());
        if (value(1, "width")?, value(2, "height")?) != (width as f64, height as f64) {
            return Err(reference.line_error(number, "the map has another size").into());
        }
        let top = height as i32 - 1;
        let cell = |x: f64, y: f64| (x as i32, top - y as i32);
        let ends = [cell(value(3, "sx")?, value(4, "sy")?), cell(value(5, "gx")?, value(6, "gy")?)];
        let Some(case) = Case::new(name, &map, ends)? else {
            return Err(reference.line_error(number, "start and goal are not joined").into());
        };
        for (column, what, ours) in [(8, "octile_nocut", case.octile), (12, "any_angle_exact", case.any_angle)] {
            let stated = value(column, what)?;
            if (stated - ours).abs() > 1e-6 {
                return Err(reference.line_error(number, format_args!("{what} is {stated}, computed {ours}")).into());
            }
        }
        let is_large = width == 50;
        let pair = if is_large { TABLE_4 } else { TABLE_3 };
        sets[if is_large { 3 } else { 0 }].cases.push(case);
        if !name.starts_with("tutorial")
            && let Some(case) = Case::new(name, &map, pair)?
        {
            sets[if is_large { 2 } else { 1 }].cases.push(case);
        }
    }
    Ok(sets.into_iter().filter(|set| !set.cases.is_empty()).collect())
}

fn empty_sets() -> [Set; 4] {
    let set = |key, title: &str| Set { key, title: title.to_owned(), cases: Vec::new() };
    [
        set("table1", "Table 1: 20 x 20, (0.5, 19.5) to (19.5, 0.5)"),
        set("table3", "Table 3: 20 x 20, (1.5, 0.5) to (18.5, 18.5)"),
        set("table4", "Table 4: 50 x 50, (3.5, 0.5) to (47.5, 45.5)"),
        set("corners50", "50 x 50, corner to corner, 20 and 25 % blocked"),
    ]
}

/// Seeded maps: no files needed.
pub(crate) fn shipped() -> Result<Vec<Set>> {
    let mut sets = empty_sets();
    // The first seed whose optimum is the paper's.
    for seed in 0.. {
        let map = random_map(20, 0.25, seed, &CORNERS_20)?;
        if let Some(case) = Case::new(format!("random20-25-{seed}"), &map, CORNERS_20)?
            && (case.octile - PAPER_OPTIMUM).abs() < 1e-9
        {
            sets[0].cases.push(case);
            break;
        }
    }
    for (set, size, density, ends, wanted) in
        [(1, 20, 0.25, TABLE_3, 1), (2, 50, 0.2, TABLE_4, 1), (3, 50, 0.2, CORNERS_50, 1), (3, 50, 0.25, CORNERS_50, 2)]
    {
        for seed in 0.. {
            let map = random_map(size, density, seed, &ends)?;
            sets[set].cases.extend(Case::new(format!("random{size}-{:.0}-{seed}", 100.0 * density), &map, ends)?);
            if sets[set].cases.len() >= wanted {
                break;
            }
        }
    }
    Ok(sets.into())
}

/// Cells blocked at random, start and goal free.
fn random_map(size: usize, density: f64, seed: u64, ends: &[(i32, i32); 2]) -> Result<Grid<CellState>> {
    let layout = GridLayout::new(size, size, 1.0, Se2::default())?;
    let mut stream = Seed(seed).stream(size as u64, (100.0 * density) as u64);
    let state = |_| if stream.random::<f64>() < density { CellState::Occupied } else { CellState::Free };
    let mut map = Grid::new(layout, (0..layout.len()).map(state).collect())?;
    for (x, y) in ends {
        map.set(Cell::new(*x, *y), CellState::Free);
    }
    Ok(map)
}

impl Set {
    /// A line per algorithm.
    pub(crate) fn table(&self, summaries: &[Summary]) -> String {
        let mean = |of: fn(&Case) -> f64| self.cases.iter().map(of).sum::<f64>() / self.cases.len().max(1) as f64;
        let mut text = format!(
            "{} ({} maps; shortest octile path {:.4} m, of any angle {:.4} m, means)\n{:32} {:>9} {:>25} {:>7} {:>7} {:>8} {:>15} {:>15} {:>8}\n",
            self.title,
            self.cases.len(),
            mean(|case| case.octile),
            mean(|case| case.any_angle),
            "",
            "solved",
            "length: best, mean, worst",
            "ratio",
            "worst",
            "any-ang.",
            "turns",
            "iterations",
            "ms",
        );
        let three =
            |s: &Spread, digits: usize| format!("{:.digits$}/{:.digits$}/{:.digits$}", s.least, s.mean, s.greatest);
        for s in summaries {
            let _ = writeln!(
                text,
                "{:32} {:>4}/{:<4} {:>25} {:7.4} {:7.4} {:8.4} {:>15} {:>15} {:8.2}",
                s.name,
                s.found,
                s.runs,
                three(&s.length, 3),
                s.ratio.mean,
                s.ratio.greatest,
                s.any_angle.mean,
                three(&s.turns, 0),
                three(&s.iterations, 0),
                s.milliseconds,
            );
        }
        text
    }
}
