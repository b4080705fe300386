//! Paper 003's comparison: A* and Dijkstra, with 4 and 8 directions, with and without obstacles, in a factory.
//!
//! Its hall is a generated one of 60 x 40 m with racks, goods, pillars and machines, mapped from 0.05 to 1.8 m above the floor
//! with cells of 0.1 m and planned for a vehicle of 0.5 m radius. Without obstacles there is the hall alone. The queries are the
//! way from the first aisle's west end to the last one's east end, and [`PAIRS`] random ones.

use super::{Args, Result, site};
use agv_nav::{
    core::{
        geometry::Se2,
        grid::{Cell, CellState, Connectivity, Costmap, Grid},
        metrics::{PathQuality, PathQualityParams},
        path::Path,
        roles::{GlobalPlanner, PlanOutcome},
    },
    plan::grid::{AStar, AStarParams, Dijkstra, GridParams, GridPlanner, GridPlannerParams, GridSolver},
};
use agv_sim::{Factory, FactoryParams};
use agv_support::{
    cli::Report,
    plot::{Color, Scene},
    progress::Progress,
};
use rand::RngExt;
use std::time::Instant;

/// Random queries.
const PAIRS: usize = 100;
/// Radius of the vehicle, in metres.
const RADIUS: f64 = 0.5;
/// Edge of a cell, in metres.
const RESOLUTION: f64 = 0.1;

/// Answers of one planner on one map.
struct Row {
    planner: &'static str,
    directions: usize,
    obstacles: bool,
    across: Leg,
    random: Leg,
}

/// Sums over queries.
#[derive(Default)]
struct Leg {
    queries: usize,
    length: f64,
    turns: usize,
    expansions: u64,
    micros: f64,
}

/// Compares, prints, and draws.
pub(crate) fn run(args: &Args, mut report: Report) -> Result<bool> {
    let factory = Factory::generate(FactoryParams::default(), args.common.seed())?;
    let map = factory.map(RESOLUTION, 0.05, 1.8)?;
    let hall = hall(&map);
    let (costmap, empty) = (site::costmap(&map, RADIUS)?, site::costmap(&hall, RADIUS)?);
    let (first, last) = (factory.aisles()[0], factory.aisles()[factory.aisles().len() - 1]);
    let across = (first, last * Se2::new(factory.aisle_length(), 0.0, 0.0));
    let pairs = pairs(args, &costmap)?;

    let progress = Progress::new(8, "comparing");
    let mut rows = Vec::new();
    for connectivity in [Connectivity::Four, Connectivity::Eight] {
        let grid = GridParams { connectivity, ..Default::default() };
        for (costmap, obstacles) in [(&costmap, true), (&empty, false)] {
            let mut a_star = AStar::new(AStarParams { grid, ..Default::default() })?;
            let mut dijkstra = Dijkstra::new(GridPlannerParams { grid, ..Default::default() })?;
            let planners: [(_, &mut dyn GlobalPlanner); 2] = [("A*", &mut a_star), ("Dijkstra", &mut dijkstra)];
            for (planner, asked) in planners {
                let across = ask(asked, costmap, &[across], args.repeats)?;
                let random = ask(asked, costmap, &pairs, args.repeats)?;
                let directions = if connectivity == Connectivity::Four { 4 } else { 8 };
                rows.push(Row { planner, directions, obstacles, across, random });
                progress.step();
            }
        }
    }
    let agree = rows.chunks(2).all(|pair| match pair {
        [a, b] => (a.random.length - b.random.length).abs() < 1e-6 && a.random.queries == b.random.queries,
        _ => false,
    });
    report.count("random_queries", pairs.len()).flag("equal_lengths", agree);
    if !args.common.json {
        print_table(&rows);
    }
    report.reports("rows", rows.iter().map(Row::report).collect());
    // The figures first: they are not lost if the picture cannot be written.
    report.print(args.common.json)?;
    pictures(&args.common.out_folder("plan")?, (&map, &costmap), &across)?;
    Ok(agree)
}

/// The map with nothing in it but its outer walls.
fn hall(map: &Grid<CellState>) -> Grid<CellState> {
    let layout = map.layout();
    let wall = (0.3 / RESOLUTION).round() as i32;
    let (width, height) = (layout.width() as i32, layout.height() as i32);
    let inside = |cell: Cell| (wall..width - wall).contains(&cell.x) && (wall..height - wall).contains(&cell.y);
    let mut hall = map.clone();
    for (index, state) in hall.values_mut().iter_mut().enumerate() {
        *state = if inside(layout.cell(index)) { CellState::Free } else { CellState::Occupied };
    }
    hall
}

/// Random pairs of places that a path joins.
fn pairs(args: &Args, costmap: &Costmap) -> Result<Vec<(Se2, Se2)>> {
    let layout = costmap.layout();
    let mut stream = args.common.seed().derive(3).stream(0, 0);
    let mut planner = AStar::new(AStarParams::default())?;
    let (mut pairs, mut path) = (Vec::new(), Path::new());
    // The factory is one room: a draw in some that misses is one of a blocked cell.
    for _ in 0..100 * PAIRS {
        let [a, b] = [(); 2].map(|()| layout.center(layout.cell(stream.random_range(0..layout.len()))));
        let pair = (Se2::new(a.x, a.y, 0.0), Se2::new(b.x, b.y, 0.0));
        if matches!(planner.plan_into(costmap, &pair.0, &pair.1, &mut path)?, PlanOutcome::Found { .. }) {
            pairs.push(pair);
            if pairs.len() == PAIRS {
                break;
            }
        }
    }
    Ok(pairs)
}

fn ask(planner: &mut dyn GlobalPlanner, costmap: &Costmap, pairs: &[(Se2, Se2)], repeats: u16) -> Result<Leg> {
    let (mut leg, mut path) = (Leg::default(), Path::new());
    for (start, goal) in pairs {
        let mut fastest = f64::INFINITY;
        let mut outcome = None;
        for _ in 0..repeats {
            let begin = Instant::now();
            outcome = Some(planner.plan_into(costmap, start, goal, &mut path)?);
            fastest = fastest.min(begin.elapsed().as_secs_f64() * 1e6);
        }
        if let Some(PlanOutcome::Found { cost, expansions }) = outcome {
            leg.queries += 1;
            leg.length += cost;
            leg.expansions += expansions;
            leg.micros += fastest;
            leg.turns += PathQuality::of(&path, PathQualityParams::default(), |_| 0.0)?.turns;
        }
    }
    Ok(leg)
}

impl Row {
    fn report(&self) -> Report {
        let mut report = Report::new("Row");
        report.text("planner", self.planner).count("directions", self.directions).flag("obstacles", self.obstacles);
        for (name, leg) in [("across", &self.across), ("random", &self.random)] {
            let count = leg.queries.max(1) as f64;
            report.number(&format!("{name}_length_m"), leg.length / count);
            report.number(&format!("{name}_turns"), leg.turns as f64 / count);
            report.number(&format!("{name}_expansions"), leg.expansions as f64 / count);
            report.number(&format!("{name}_us"), leg.micros / count);
        }
        report
    }
}

fn print_table(rows: &[Row]) {
    println!(
        "| planner | directions | obstacles | length | turns | expansions | time | mean of {PAIRS}: length | time |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for Row { planner, directions, obstacles, across, random } in rows {
        let obstacles = if *obstacles { "with" } else { "without" };
        let count = random.queries.max(1) as f64;
        println!(
            "| {planner} | {directions} | {obstacles} | {:.1} m | {} | {} | {:.2} ms | {:.1} m | {:.2} ms |",
            across.length,
            across.turns,
            across.expansions,
            across.micros / 1e3,
            random.length / count,
            random.micros / count / 1e3
        );
    }
}

fn pictures(out: &std::path::Path, (map, costmap): (&Grid<CellState>, &Costmap), pair: &(Se2, Se2)) -> Result<()> {
    let four = GridParams { connectivity: Connectivity::Four, ..Default::default() };
    let mut along_four = AStar::new(AStarParams { grid: four, ..Default::default() })?;
    let mut along_eight = AStar::new(AStarParams::default())?;
    let mut path = Path::new();
    let mut line = |planner: &mut dyn GlobalPlanner| -> Result<Vec<Se2>> {
        planner.plan_into(costmap, &pair.0, &pair.1, &mut path)?;
        Ok(path.points().iter().map(|point| point.pose).collect())
    };
    let (four, eight) = (line(&mut along_four)?, line(&mut along_eight)?);
    Scene::new("A factory, planned for a radius of 0.5 m")
        .width(900)
        .map(map)
        .cells("reached by A*, 8 directions", Color::Sky, &reached(&along_eight, costmap))
        .trajectory("A*, 4 directions", Color::Orange, &four)
        .trajectory("A*, 8 directions", Color::Red, &eight)
        .mark("start", Color::Green, pair.0.translation())
        .mark("goal", Color::Blue, pair.1.translation())
        .write(out.join("factory.svg"))?;
    Ok(())
}

fn reached<S: GridSolver>(planner: &GridPlanner<S>, costmap: &Costmap) -> Grid<bool> {
    super::planners::Planner::reached(planner, costmap.layout())
}
