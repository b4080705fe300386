//! Three tight places: a parking space along an aisle, a dock to back into, and a turn in an aisle.

use crate::{
    Args, Result,
    check::check,
    pictures,
    run::Run,
    site::{self, LENGTH, WIDTH},
};
use agv_core::{
    geometry::Se2,
    grid::{Cell, CellState, Grid, GridLayout},
    path::Path,
    roles::{GlobalPlanner as _, PlanOutcome},
};
use agv_plan::hybrid::HybridAStar;
use agv_support::{cli::Report, timing::Timings};
use std::f64::consts::{FRAC_PI_2, PI};

/// A hall with a title, and a query in it.
struct Manoeuvre {
    name: &'static str,
    title: &'static str,
    map: Grid<CellState>,
    query: (Se2, Se2),
}

/// Cells of `resolution` metres, occupied but for rectangles given by their corners in metres.
fn carved(length: f64, width: f64, rooms: &[[f64; 4]]) -> Result<Grid<CellState>> {
    let resolution = 0.05;
    let cells = |metres: f64| (metres / resolution).round() as i32;
    let layout = GridLayout::new(cells(length) as usize, cells(width) as usize, resolution, Se2::default())?;
    let mut map = Grid::filled(layout, CellState::Occupied);
    for &[x0, y0, x1, y1] in rooms {
        for y in cells(y0)..cells(y1) {
            for x in cells(x0)..cells(x1) {
                map.set(Cell::new(x, y), CellState::Free);
            }
        }
    }
    Ok(map)
}

/// Poses are those of the outline's middle line, `rear` metres from its tail.
fn all(rear: f64) -> Result<[Manoeuvre; 3]> {
    let slot = 1.6 * LENGTH;
    let parking = carved(12.0, 4.6, &[[0.3, 0.3, 11.7, 2.9], [4.5, 2.9, 4.5 + slot, 2.9 + WIDTH + 0.4]])?;
    let docking = carved(10.0, 6.0, &[[0.3, 0.3, 9.7, 3.3], [5.0, 3.3, 5.0 + WIDTH + 0.3, 5.7]])?;
    let aisle = carved(14.0, 3.6, &[[0.3, 0.4, 13.7, 3.2]])?;
    Ok([
        Manoeuvre {
            name: "parking",
            title: "Parking between two pallets",
            map: parking,
            query: (
                Se2::new(0.8 - rear, 1.5, 0.0),
                Se2::new(4.5 + 0.5 * (slot - LENGTH) - rear, 2.9 + 0.5 * WIDTH + 0.2, 0.0),
            ),
        },
        Manoeuvre {
            name: "docking",
            title: "Backing into a dock",
            map: docking,
            query: (Se2::new(1.5, 1.2, 0.0), Se2::new(5.0 + 0.5 * (WIDTH + 0.3), 5.6 + rear, -FRAC_PI_2)),
        },
        Manoeuvre {
            name: "turning",
            title: "Turning in an aisle of 2.8 m",
            map: aisle,
            query: (Se2::new(6.0, 1.2, 0.0), Se2::new(8.0, 2.2, PI)),
        },
    ])
}

pub(crate) fn run(args: &Args, out: &std::path::Path, report: &mut Report) -> Result<()> {
    let (params, footprint) = site::vehicle(args)?;
    let rear = footprint.vertices().unwrap_or_default().iter().map(|v| v.x).fold(0.0, f64::min);
    for Manoeuvre { name, title, map, query } in all(rear)? {
        let costmap = site::costmap(args, &map, &footprint)?;
        let mut planner = HybridAStar::new(params, footprint.clone())?;
        let (mut path, mut timings) = (Path::new(), Timings::default());
        let outcome = timings.time(|| planner.plan_into(&costmap, &query.0, &query.1, &mut path))?;
        let verdict = check(&map, &footprint, &path, params.spacing);
        let key = |what: &str| format!("{name}_{what}");
        report.flag(&key("solved"), matches!(outcome, PlanOutcome::Found { .. }));
        report.number(&key("ms"), timings.total_milliseconds()).number(&key("length_m"), path.length());
        if let PlanOutcome::Found { expansions, .. } | PlanOutcome::NoPath { expansions, .. } = outcome {
            report.count(&key("expansions"), expansions as usize);
        }
        report.count(&key("cusps"), verdict.cusps).count(&key("collisions"), verdict.collisions + verdict.faults);
        let run = Run { query, path, outcome, verdict, ratio: f64::NAN };
        pictures::draw(title, &map, &footprint, [&run], (700, 0.8)).write(out.join(format!("{name}.svg")))?;
    }
    Ok(())
}
