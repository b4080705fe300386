//! Exact any-angle paths against all lines between all corners, and against stated lengths of public grids.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, Costmap, Grid, GridLayout, cost};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, NoPathReason, PlanOutcome};
use agv_plan::grid::{Anya, GridPlannerParams, ThetaStar};
use agv_support::movingai::read_map;
use proptest::prelude::*;
use std::path::PathBuf;

fn pose(layout: &GridLayout, cell: Cell) -> Se2 {
    let center = layout.center(cell);
    Se2::new(center.x, center.y, 0.3)
}

/// Cost in cells, if there is a path; its points are those that the cost was made of.
fn solve(planner: &mut impl GlobalPlanner, costmap: &Costmap, start: Cell, goal: Cell) -> Option<f64> {
    let (layout, mut path) = (*costmap.layout(), Path::new());
    let (start, goal) = (pose(&layout, start), pose(&layout, goal));
    match planner.plan_into(costmap, &start, &goal, &mut path).unwrap() {
        PlanOutcome::Found { cost, .. } => {
            assert!((path.length() - cost).abs() < 1e-9, "{} for {cost}", path.length());
            assert_eq!((path.points()[0].pose, path.points()[path.len() - 1].pose), (start, goal));
            Some(cost / layout.resolution())
        }
        PlanOutcome::NoPath { reason, .. } => {
            assert!(reason == NoPathReason::Disconnected && path.is_empty());
            None
        }
        other => panic!("{other:?}"),
    }
}

/// The rules in words, on coordinates in half cells (corners even): a line may be taken if no part of it lies inside a blocked
/// cell or between two, and it passes through no corner at which two cells touch.
struct Judge<'a>(&'a dyn Fn(i64, i64) -> bool);

impl Judge<'_> {
    /// Two blocked cells that touch only here.
    fn pinches(&self, x: i64, y: i64) -> bool {
        let free = |dx: i64, dy: i64| self.0(x.div_euclid(2) + dx, y.div_euclid(2) + dy);
        let (a, b, c, d) = (free(-1, -1), free(0, 0), free(-1, 0), free(0, -1));
        (!a && !b && c && d) || (a && b && !c && !d)
    }

    fn allows(&self, a: (i64, i64), b: (i64, i64)) -> bool {
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        // Where it crosses lines of the lattice, as fractions of its length.
        let mut cuts = vec![(0, 1), (1, 1)];
        for (from, to) in [(a.0, b.0), (a.1, b.1)] {
            let (low, high) = (from.min(to), from.max(to));
            cuts.extend((low + 1..high).filter(|v| v % 2 == 0).map(|v| ((v - from).abs(), (to - from).abs())));
        }
        cuts.sort_by(|p, q| (p.0 * q.1).cmp(&(q.0 * p.1)));
        for &(n, m) in &cuts[1..cuts.len() - 1] {
            let (x, y) = (a.0 * m + dx * n, a.1 * m + dy * n);
            if x % (2 * m) == 0 && y % (2 * m) == 0 && self.pinches(x / m, y / m) {
                return false;
            }
        }
        cuts.windows(2).all(|pair| {
            let ((n, m), (k, l)) = (pair[0], pair[1]);
            // The middle of the part, times 2 m l.
            let scale = 2 * m * l;
            let (x, y) = (a.0 * scale + dx * (n * l + k * m), a.1 * scale + dy * (n * l + k * m));
            let (column, row) = (x.div_euclid(2 * scale), y.div_euclid(2 * scale));
            let columns = if x.rem_euclid(2 * scale) == 0 { vec![column - 1, column] } else { vec![column] };
            let rows = if y.rem_euclid(2 * scale) == 0 { vec![row - 1, row] } else { vec![row] };
            columns.iter().any(|&column| rows.iter().any(|&row| self.0(column, row)))
        })
    }
}

/// Shortest way over all corners, by relaxation to the fixed point.
fn shortest(costmap: &Costmap, start: Cell, goal: Cell) -> Option<f64> {
    let layout = *costmap.layout();
    let free = |x: i64, y: i64| costmap.is_traversable(Cell::new(x as i32, y as i32));
    let judge = Judge(&free);
    let center = |cell: Cell| (2 * i64::from(cell.x) + 1, 2 * i64::from(cell.y) + 1);
    let mut points = vec![center(start), center(goal)];
    for y in 0..=layout.height() as i64 {
        points.extend((0..=layout.width() as i64).map(|x| (2 * x, 2 * y)).filter(|&(x, y)| !judge.pinches(x, y)));
    }
    let length = |a: (i64, i64), b: (i64, i64)| ((a.0 - b.0) as f64).hypot((a.1 - b.1) as f64) / 2.0;
    let mut lines = Vec::new();
    for (i, &a) in points.iter().enumerate() {
        for (j, &b) in points.iter().enumerate().skip(i + 1).filter(|&(_, &b)| judge.allows(a, b)) {
            lines.push((i, j, length(a, b)));
        }
    }
    let mut best = vec![f64::INFINITY; points.len()];
    best[0] = 0.0;
    loop {
        let mut changed = false;
        for &(i, j, length) in &lines {
            for (from, to) in [(i, j), (j, i)] {
                if best[from] + length < best[to] - 1e-12 {
                    (best[to], changed) = (best[from] + length, true);
                }
            }
        }
        if !changed {
            return Some(best[1]).filter(|length| length.is_finite());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn paths_are_the_shortest_of_all(
        (width, height) in (2_usize..9, 2_usize..9),
        blocked in proptest::collection::vec(0_u8..10, 64),
        share in 1_u8..6,
        ends in (0_usize..64, 0_usize..64),
    ) {
        let layout = GridLayout::new(width, height, 0.5, Se2::new(2.0, -3.0, 0.7)).unwrap();
        let mut costs: Vec<u8> = blocked.iter().map(|&b| if b < share { cost::LETHAL } else { cost::FREE }).collect();
        costs.truncate(width * height);
        let ends = [ends.0 % costs.len(), ends.1 % costs.len()];
        for end in ends {
            costs[end] = cost::FREE;
        }
        let costmap = Costmap::from_costs(Grid::new(layout, costs).unwrap());
        let [start, goal] = ends.map(|end| layout.cell(end));
        let mut planner = Anya::new(GridPlannerParams::default()).unwrap();
        let (found, want) = (solve(&mut planner, &costmap, start, goal), shortest(&costmap, start, goal));
        if let (Some(found), Some(want)) = (found, want) {
            prop_assert!((found - want).abs() < 1e-9, "{} instead of {}", found, want);
        } else {
            prop_assert_eq!(found, want);
        }
    }
}

/// Names, sizes, ends and exact lengths as a visibility graph of others found them.
#[test]
fn public_grids_have_their_stated_lengths() {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/gridplan/aco"));
    let Ok(table) = std::fs::read_to_string(folder.join("reference.csv")) else {
        eprintln!("{}: not there, skipped", folder.display());
        return;
    };
    let mut lines = table.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let (mut planner, mut theta) =
        (Anya::new(GridPlannerParams::default()).unwrap(), ThetaStar::new(GridPlannerParams::default()).unwrap());
    let mut count = 0;
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let field = |name: &str| fields[header.iter().position(|h| *h == name).unwrap()];
        let number = |name: &str| field(name).parse::<f64>().unwrap();
        let map = read_map(folder.join(format!("{}.map", field("name")))).unwrap();
        let top = map.layout().height() as i32 - 1;
        let cell = |x, y| Cell::new(number(x) as i32, top - number(y) as i32);
        let (costmap, start, goal) = (Costmap::from_map(&map), cell("sx", "sy"), cell("gx", "gy"));
        let length = solve(&mut planner, &costmap, start, goal).unwrap();
        assert!((length - number("any_angle_exact")).abs() < 1e-6, "{line}: {length}");
        assert!(solve(&mut theta, &costmap, start, goal).unwrap() > length - 1e-9, "{line}");
        count += 1;
    }
    assert_eq!(count, 42);
}

/// Cells that come and go: the planner that follows them answers as one made anew.
#[test]
fn a_changing_map_is_followed() {
    let layout = GridLayout::new(40, 30, 0.5, Se2::new(2.0, -3.0, 0.7)).unwrap();
    let mut costmap = Costmap::from_costs(Grid::filled(layout, cost::FREE));
    let mut planner = Anya::new(GridPlannerParams::default()).unwrap();
    let (start, goal) = (Cell::new(1, 14), Cell::new(38, 15));
    for x in (4..36).step_by(4) {
        for y in 0..29 {
            costmap.set(Cell::new(x, if x % 8 == 0 { y } else { 29 - y }), cost::LETHAL);
            if y % 4 == 0 {
                let mut fresh = Anya::new(GridPlannerParams::default()).unwrap();
                let want = solve(&mut fresh, &costmap, start, goal);
                assert!(want.is_some());
                assert_eq!(solve(&mut planner, &costmap, start, goal), want, "({x}, {y})");
            }
        }
    }
    costmap.set(Cell::new(4, 0), cost::LETHAL);
    assert_eq!(solve(&mut planner, &costmap, start, goal), None);
    costmap.set(Cell::new(4, 14), cost::FREE);
    assert!(solve(&mut planner, &costmap, start, goal).is_some());
}

/// Pillars and a wall behind them, open at its far end: many corners to bend round.
#[test]
fn a_callback_cancels() {
    let layout = GridLayout::new(120, 120, 0.1, Se2::default()).unwrap();
    let mut grid = Grid::filled(layout, cost::FREE);
    for index in 0..layout.len() {
        let cell = layout.cell(index);
        let is_pillar = (cell.x * 7 + cell.y * 13) % 5 == 1 && cell.x % 2 == 1 && cell.y % 2 == 1;
        if is_pillar || (cell.x == 110 && cell.y < 119) {
            grid.set(cell, cost::LETHAL);
        }
    }
    let (costmap, mut path) = (Costmap::from_costs(grid), Path::new());
    let mut planner = Anya::new(GridPlannerParams::default()).unwrap();
    let (start, goal) = (Se2::new(0.05, 0.05, 0.0), Se2::new(11.85, 0.05, 0.0));
    let mut asked = 0;
    let mut cancel = || {
        asked += 1;
        asked == 2
    };
    let outcome = planner.plan_with_cancel(&costmap, &start, &goal, &mut path, &mut cancel).unwrap();
    let expansions = 2 * agv_plan::grid::Limits::CANCEL_INTERVAL;
    assert_eq!(outcome, PlanOutcome::NoPath { reason: NoPathReason::Cancelled, expansions });
    assert_eq!(path.points()[0].pose, start);
    assert!(path.points()[path.len() - 1].pose.x() > 1.0, "towards the goal");
    assert!(matches!(planner.plan_into(&costmap, &start, &goal, &mut path), Ok(PlanOutcome::Found { .. })));
}
