//! What is asked: a map, and queries in it.

use super::{Args, Result};
use agv_nav::{
    core::{
        geometry::Se2,
        grid::{Cell, CellState, Costmap, Grid, Inflation, InflationParams},
    },
    nalgebra::Vector2,
};
use agv_support::{map, movingai};
use std::path::Path;

/// A question, and its answer where that is known.
pub(crate) struct Query {
    pub(crate) start: Se2,
    pub(crate) goal: Se2,
    /// Length of the shortest path along the grid, in cells.
    pub(crate) optimum: Option<f64>,
}

pub(crate) struct Site {
    pub(crate) map: Grid<CellState>,
    pub(crate) costmap: Costmap,
    pub(crate) queries: Vec<Query>,
}

impl Site {
    /// Edge of a cell, in metres.
    pub(crate) fn resolution(&self) -> f64 {
        self.map.layout().resolution()
    }
}

/// Reads map and queries; without any, the shipped ones.
pub(crate) fn load(args: &Args) -> Result<Site> {
    let is_yaml = args.map.extension().is_some_and(|extension| extension == "yaml" || extension == "yml");
    let map = if is_yaml { map::read(&args.map)? } else { movingai::read_map(&args.map)? };
    let costmap = costmap(&map, args.radius)?;
    let queries = match (args.start, args.goal, &args.scen) {
        (Some(start), Some(goal), _) => {
            let pose = |point: [f64; 2]| {
                if is_yaml { Ok(Se2::new(point[0], point[1], 0.0)) } else { pose_in_image(&map, point) }
            };
            vec![Query { start: pose(start)?, goal: pose(goal)?, optimum: None }]
        }
        (_, _, Some(scenario)) => scenario_queries(&map, scenario)?,
        _ if args.map == Path::new("data/planning/warehouse.map") => {
            scenario_queries(&map, Path::new("data/planning/warehouse.map.scen"))?
        }
        _ => return Err("name the queries of this map: --scen, or --start and --goal".into()),
    };
    if queries.is_empty() {
        return Err("the scenario has no queries".into());
    }
    Ok(Site { map, costmap, queries })
}

/// Cells that the centre of a vehicle may enter. Nothing unknown may be touched.
pub(crate) fn costmap(map: &Grid<CellState>, radius: f64) -> Result<Costmap> {
    if radius == 0.0 {
        return Ok(Costmap::from_map(map));
    }
    let params = InflationParams {
        inscribed_radius: radius,
        inflation_radius: radius,
        inflate_around_unknown: true,
        ..Default::default()
    };
    Ok(Inflation::new(params)?.inflate(map)?)
}

fn scenario_queries(map: &Grid<CellState>, path: &Path) -> Result<Vec<Query>> {
    let layout = map.layout();
    let center = |cell: Cell| pose_at(layout.center(cell));
    let queries = movingai::read_scenario(path)?.into_iter().enumerate().map(|(index, query)| {
        let (width, height) = query.size;
        if (width, height) != (layout.width(), layout.height()) {
            let own = format!("{} x {}", layout.width(), layout.height());
            let number = index + 1;
            return Err(format!(
                "{}: query {number} is for a map of {width} x {height} cells, this one has {own}",
                path.display()
            )
            .into());
        }
        Ok(Query { start: center(query.start), goal: center(query.goal), optimum: Some(query.optimal_length) })
    });
    queries.collect()
}

/// The centre of the cell in this column and row, counted from the top; whether it is on the map, the planner says.
fn pose_in_image(map: &Grid<CellState>, [column, row]: [f64; 2]) -> Result<Se2> {
    let layout = map.layout();
    if column.fract() != 0.0 || row.fract() != 0.0 {
        return Err(format!("({column}, {row}): column and row are whole numbers").into());
    }
    let point = layout.to_map(&Vector2::new(column + 0.5, layout.height() as f64 - row - 0.5));
    Ok(pose_at(point))
}

fn pose_at(point: Vector2<f64>) -> Se2 {
    Se2::new(point.x, point.y, 0.0)
}

/// `x,y`
pub(crate) fn point(text: &str) -> std::result::Result<[f64; 2], String> {
    let (x, y) = text.split_once(',').ok_or("two numbers with a comma between them")?;
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    Ok([number(x).ok_or("x is not a finite number")?, number(y).ok_or("y is not a finite number")?])
}

pub(crate) fn radius(text: &str) -> std::result::Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number")?;
    if (0.0..=100.0).contains(&value) { Ok(value) } else { Err("0 to 100 metres".into()) }
}
