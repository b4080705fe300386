//! Hybrid A*: every path can be driven, touches nothing, and leads where it was asked to.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2},
    grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, Inflation, InflationParams, cost},
    nalgebra::Vector2,
    path::{Gear, Path},
    roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome, laws},
};
use agv_plan::hybrid::{HybridAStar, HybridAStarParams, ReedsShepp};
use proptest::prelude::*;
use rand_distr::{Distribution as _, Uniform};
use std::f64::consts::PI;

const REAR: f64 = -0.3;
const FRONT: f64 = 0.9;
const WIDTH: f64 = 0.6;

fn footprint() -> Footprint {
    Footprint::rectangle(REAR, FRONT, WIDTH).unwrap()
}

fn params() -> HybridAStarParams {
    HybridAStarParams { max_expansions: 10_000, ..HybridAStarParams::for_turning_radius(1.0).unwrap() }
}

/// A hall of 10 m by 8 m at 0.1 m, walled in, with blocks in it.
fn hall(blocks: &[(i32, i32, i32, i32)]) -> Grid<CellState> {
    let mut map = Grid::filled(GridLayout::new(100, 80, 0.1, Se2::new(-1.0, 2.0, 0.3)).unwrap(), CellState::Free);
    for (x, y) in (0..100).flat_map(|x| (0..80).map(move |y| (x, y))) {
        let wall = x == 0 || y == 0 || x == 99 || y == 79;
        let block = blocks.iter().any(|&(bx, by, w, h)| x >= bx && x < bx + w && y >= by && y < by + h);
        if wall || block {
            map.set(Cell::new(x, y), CellState::Occupied);
        }
    }
    map
}

/// A pose, given in metres of the hall.
fn at(map: &Grid<CellState>, x: f64, y: f64, yaw: f64) -> Se2 {
    map.layout().map_from_grid() * Se2::new(x, y, yaw)
}

/// Whether the rectangle and an occupied cell have a point in common, by separating axes.
fn touches(map: &Grid<CellState>, pose: &Se2, slack: f64) -> bool {
    let layout = map.layout();
    let e = layout.resolution();
    let grid_from_base = layout.map_from_grid().inverse() * *pose;
    let centre = grid_from_base * Vector2::new(0.5 * (REAR + FRONT), 0.0);
    let (ux, uy) = (grid_from_base.rotation().cos(), grid_from_base.rotation().sin());
    let (hx, hy) = (0.5 * (FRONT - REAR) - slack, 0.5 * WIDTH - slack);
    let reach = hx.hypot(hy);
    let range = |c: f64| ((c - reach) / e).floor() as i32 - 1..=((c + reach) / e).floor() as i32 + 1;
    range(centre.y).any(|y| {
        range(centre.x).any(|x| {
            if map.get(Cell::new(x, y)) == Some(&CellState::Free) {
                return false;
            }
            let d = Vector2::new((f64::from(x) + 0.5) * e, (f64::from(y) + 0.5) * e) - centre;
            let (h, spread) = (0.5 * e, 0.5 * e * (ux.abs() + uy.abs()));
            d.x.abs() <= h + hx * ux.abs() + hy * uy.abs()
                && d.y.abs() <= h + hx * uy.abs() + hy * ux.abs()
                && (d.x * ux + d.y * uy).abs() <= hx + spread
                && (d.y * ux - d.x * uy).abs() <= hy + spread
        })
    })
}

/// What is wrong with a path, if anything: densely, by other means than the planner's.
fn fault(map: &Grid<CellState>, path: &Path, radius: f64, crab: f64, spacing: f64) -> Option<String> {
    for pair in path.points().windows(2) {
        let step = pair[1].pose.minus(&pair[0].pose);
        let length = step.x.hypot(step.y);
        if length > spacing * (1.0 + 1e-6) {
            return Some(format!("a gap of {length}"));
        }
        if length < 1e-7 {
            continue;
        }
        let ahead = if pair[1].gear == Gear::Forward { step.x } else { -step.x };
        if ahead <= 0.0 {
            return Some(format!("driven against its gear: {step:?}"));
        }
        if step.y.abs() > ahead * crab.tan() + 1e-7 {
            return Some(format!("sideways: {step:?}"));
        }
        if step.z.abs() > length / radius * (1.0 + 1e-6) + 1e-7 {
            return Some(format!("too tight: {step:?}"));
        }
        for i in 0..=5 {
            if touches(map, &pair[0].pose.plus(&(step * (f64::from(i) / 5.0))), 1e-9) {
                return Some(format!("touches at {:?}", pair[0].pose));
            }
        }
    }
    None
}

fn blocks() -> impl Strategy<Value = Vec<(i32, i32, i32, i32)>> {
    prop::collection::vec((5..90_i32, 5..70_i32, 1..14_i32, 1..14_i32), 0..14)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..Default::default() })]

    #[test]
    fn paths_can_be_driven_and_touch_nothing(
        blocks in blocks(), ends in prop::array::uniform2((0.5..9.5_f64, 0.5..7.5_f64, -PI..PI)),
        crab in prop_oneof![3 => Just(0.0), 1 => Just(0.4)], may_reverse in prop_oneof![4 => Just(true), 1 => Just(false)],
        inflate: bool, cost_weight in prop_oneof![Just(0.0), Just(3.0)],
    ) {
        let map = hall(&blocks);
        let costmap = if inflate {
            Inflation::new(InflationParams::for_footprint(&footprint())).unwrap().inflate(&map).unwrap()
        } else {
            Costmap::from_map(&map)
        };
        let params = HybridAStarParams { crab_angle: crab, may_reverse, cost_weight, ..params() };
        let mut planner = HybridAStar::new(params, footprint()).unwrap();
        let [start, goal] = ends.map(|(x, y, yaw)| at(&map, x, y, yaw));
        let mut path = Path::new();
        match planner.plan_into(&costmap, &start, &goal, &mut path).unwrap() {
            PlanOutcome::Found { cost, .. } => {
                prop_assert_eq!(path.points()[0].pose, start);
                let end = path.points()[path.len() - 1].pose;
                prop_assert_eq!(end, goal);
                prop_assert_eq!(fault(&map, &path, params.turning_radius, crab, params.spacing), None);
                let bound = ReedsShepp::new(params.turning_radius).unwrap().cost(&start, &goal).unwrap();
                prop_assert!(crab > 0.0 || cost >= bound - 1e-6, "{} {}", cost, bound);
                prop_assert!(cost >= path.length() - 1e-6 && path.length() >= (goal.translation() - start.translation()).norm() - 1e-9);
                prop_assert!(may_reverse || path.points().iter().all(|p| p.gear == Gear::Forward));
                if inflate {
                    let free = |p: &Se2| costmap.layout().cell_at(&p.translation()).is_some_and(|c| costmap.is_traversable(c));
                    prop_assert!(path.points().iter().all(|p| free(&p.pose)));
                }
                let mut again = Path::new();
                let mut fresh = HybridAStar::new(params, footprint()).unwrap();
                let second = fresh.plan_into(&costmap, &start, &goal, &mut again).unwrap();
                let same = matches!(second, PlanOutcome::Found { cost: c, .. } if c == cost) && again == path;
                prop_assert!(same, "another answer");
            }
            PlanOutcome::NoPath { reason: NoPathReason::StartBlocked, .. } => {
                // Grown by a hair at the most.
                prop_assert!(inflate || touches(&map, &start, -1e-6));
                prop_assert!(path.is_empty());
            }
            PlanOutcome::NoPath { reason: NoPathReason::GoalBlocked, .. } => {
                prop_assert!(inflate || touches(&map, &goal, -1e-6));
                prop_assert!(path.is_empty());
            }
            PlanOutcome::NoPath { reason: NoPathReason::Budget, .. } => {
                prop_assert_eq!(path.points()[0].pose, start);
                prop_assert_eq!(fault(&map, &path, params.turning_radius, crab, params.spacing), None);
            }
            _ => prop_assert!(path.is_empty()),
        }
    }
}

#[test]
fn plays_its_role() {
    let map = hall(&[(40, 0, 4, 45)]);
    let costmap = Inflation::new(InflationParams::for_footprint(&footprint())).unwrap().inflate(&map).unwrap();
    let mut planner = HybridAStar::new(params(), footprint()).unwrap();
    laws::global_planner(&mut planner, &costmap, &at(&map, 2.0, 2.0, 0.0), &at(&map, 7.0, 2.0, PI)).unwrap();
    // For a point, and costs that nobody inflated.
    let mut point = HybridAStar::new(params(), Footprint::point()).unwrap();
    let raw = Costmap::from_map(&map);
    laws::global_planner(&mut point, &raw, &at(&map, 2.0, 2.0, 0.0), &at(&map, 7.0, 2.0, PI)).unwrap();
}

fn plan(planner: &mut HybridAStar, map: &Grid<CellState>, start: Se2, goal: Se2) -> (PlanOutcome, Path) {
    let mut path = Path::new();
    let outcome = planner.plan_into(&Costmap::from_map(map), &start, &goal, &mut path).unwrap();
    (outcome, path)
}

fn reason(outcome: PlanOutcome) -> Option<(NoPathReason, u64)> {
    match outcome {
        PlanOutcome::NoPath { reason, expansions } => Some((reason, expansions)),
        _ => None,
    }
}

#[test]
fn why_there_is_no_path_is_said() {
    let map = hall(&[(48, 0, 4, 80), (10, 60, 3, 3)]);
    let mut planner = HybridAStar::new(params(), footprint()).unwrap();
    let (good, beyond, inside) = (at(&map, 2.0, 2.0, 0.0), at(&map, 8.0, 2.0, 0.0), at(&map, 0.9, 6.1, 0.0));
    for (start, goal, want) in [
        (good, beyond, NoPathReason::Disconnected),
        (inside, good, NoPathReason::StartBlocked),
        (good, inside, NoPathReason::GoalBlocked),
    ] {
        let (outcome, path) = plan(&mut planner, &map, start, goal);
        assert_eq!(reason(outcome), Some((want, 0)));
        assert!(path.is_empty());
    }
    // A gap of 1 m, between 3 m of walls: the vehicle has 0.2 m to either side.
    let gap = hall(&[(30, 0, 30, 35), (30, 45, 30, 35)]);
    let (outcome, _) = plan(&mut planner, &gap, at(&gap, 1.5, 1.5, PI / 2.0), at(&gap, 8.5, 1.5, PI / 2.0));
    assert!(matches!(outcome, PlanOutcome::Found { .. }), "it just fits: {outcome:?}");
    let tight = HybridAStarParams { max_expansions: 10, ..params() };
    let mut hurried = HybridAStar::new(tight, footprint()).unwrap();
    let (outcome, path) = plan(&mut hurried, &gap, at(&gap, 1.5, 1.5, PI / 2.0), at(&gap, 8.5, 1.5, PI / 2.0));
    assert_eq!(reason(outcome), Some((NoPathReason::Budget, 10)));
    assert!(!path.is_empty() && fault(&gap, &path, 1.0, 0.0, 0.05).is_none());
    let mut path = Path::new();
    let (costmap, from, to) = (Costmap::from_map(&gap), at(&gap, 1.5, 1.5, PI / 2.0), at(&gap, 8.5, 1.5, PI / 2.0));
    let outcome = planner.plan_with_cancel(&costmap, &from, &to, &mut path, &mut || true).unwrap();
    assert_eq!(reason(outcome), Some((NoPathReason::Cancelled, 0)));
    // Later: not long after it says so.
    let mut asked = 0;
    let mut third_time = || {
        asked += 1;
        asked == 3
    };
    let outcome = planner.plan_with_cancel(&costmap, &from, &to, &mut path, &mut third_time).unwrap();
    assert_eq!(reason(outcome), Some((NoPathReason::Cancelled, 32)));
}

/// Halls parted by a wall at any angle to the grid, with a gap in it that leaves the vehicle 5 cm on either side (and as much as
/// cells stand back from the drawn line), and a query through it.
#[test]
fn gaps_of_a_hand_more_than_the_vehicle_are_found() {
    let mut stream = Seed(4).stream(0, 0);
    let mut draw = |from: f64, to: f64| Uniform::new(from, to).unwrap().sample(&mut stream);
    let layout = GridLayout::new(200, 160, 0.05, Se2::default()).unwrap();
    let params = HybridAStarParams { max_expansions: 20_000, ..params() };
    let mut planner = HybridAStar::new(params, footprint()).unwrap();
    for case in 0..12 {
        let (thickness, tilt, gap_at) = (draw(0.1, 2.5), draw(-0.5, 0.5), draw(-1.5, 1.5));
        let wall_from_map = Se2::new(5.0, 4.0, tilt).inverse();
        // Half a cell, seen along the wall.
        let half = 0.025 * (tilt.cos() + tilt.sin().abs());
        let state = |i: usize| {
            let p = wall_from_map * layout.center(layout.cell(i));
            let is_wall = p.x.abs() < 0.5 * thickness && (p.y - gap_at).abs() > 0.35 + half;
            if is_wall { CellState::Occupied } else { CellState::Free }
        };
        let map = Grid::new(layout, (0..layout.len()).map(state).collect()).unwrap();
        let from = Se2::new(draw(1.0, 2.5), draw(1.5, 6.5), draw(-PI, PI));
        let to = Se2::new(draw(7.5, 9.0), draw(1.5, 6.5), draw(-PI, PI));
        let (outcome, path) = plan(&mut planner, &map, from, to);
        assert!(matches!(outcome, PlanOutcome::Found { .. }), "{case}: {outcome:?}");
        assert_eq!(fault(&map, &path, params.turning_radius, 0.0, params.spacing), None, "{case}");
    }
}

#[test]
fn a_query_that_ended_early_leaves_nothing_of_the_old_map() {
    let (before, after) = (hall(&[(48, 0, 4, 50)]), hall(&[(48, 30, 4, 50), (10, 60, 3, 3)]));
    let (start, goal, inside) = (at(&after, 2.0, 4.0, 0.0), at(&after, 8.0, 4.0, 0.0), at(&after, 0.9, 6.1, 0.0));
    let (old, new) = (Costmap::from_map(&before), Costmap::from_map(&after));
    let mut planner = HybridAStar::new(params(), footprint()).unwrap();
    let (mut path, mut fresh_path) = (Path::new(), Path::new());
    assert!(reason(planner.plan_into(&old, &start, &goal, &mut path).unwrap()).is_none());
    let blocked = planner.plan_into(&new, &inside, &goal, &mut path).unwrap();
    assert_eq!(reason(blocked), Some((NoPathReason::StartBlocked, 0)));
    let outcome = planner.plan_into(&new, &start, &goal, &mut path).unwrap();
    let mut fresh = HybridAStar::new(params(), footprint()).unwrap();
    assert_eq!(fresh.plan_into(&new, &start, &goal, &mut fresh_path).unwrap(), outcome);
    assert!(path == fresh_path && reason(outcome).is_none());
}

#[test]
fn an_answer_does_not_depend_on_queries_before() {
    let layout = GridLayout::new(500, 400, 0.1, Se2::default()).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    // Racks, with gaps at either end by turns; through the second, a crank that a circle passes and the vehicle does not: the
    // search goes on far beyond what the potential knows at first.
    let in_crank = |x, y| match y {
        40 => (193..200).contains(&x),
        41..48 => (150..200).contains(&x),
        48 => (150..157).contains(&x),
        _ => false,
    };
    for (x, y) in (0..500).flat_map(|x| (0..400).map(move |y| (x, y))) {
        let rack = y % 40 < 9 && if y / 40 % 2 == 0 { x < 460 } else { x >= 40 };
        if rack && !in_crank(x, y) {
            map.set(Cell::new(x, y), CellState::Occupied);
        }
    }
    let costmap = Costmap::from_map(&map);
    let goal = Se2::new(20.0, 2.4, 0.0);
    let near = Se2::new(16.0, 6.4, PI);
    let mut path = Path::new();
    let mut fresh = HybridAStar::new(params(), footprint()).unwrap();
    let outcome = fresh.plan_into(&costmap, &near, &goal, &mut path).unwrap();
    for far in [Se2::new(20.0, 38.4, 0.0), Se2::new(22.0, 2.4, 1.0), Se2::new(2.0, 22.4, 0.0)] {
        let mut again = Path::new();
        let mut planner = HybridAStar::new(params(), footprint()).unwrap();
        planner.plan_into(&costmap, &far, &goal, &mut again).unwrap();
        assert_eq!(planner.plan_into(&costmap, &near, &goal, &mut again).unwrap(), outcome);
        assert!(again == path);
    }
}

#[test]
fn a_blocked_goal_moves_within_its_tolerance() {
    let map = hall(&[(50, 30, 6, 6)]);
    let goal = at(&map, 4.9, 3.3, 0.0);
    let mut strict = HybridAStar::new(params(), footprint()).unwrap();
    let start = at(&map, 1.5, 3.3, 0.0);
    assert_eq!(reason(plan(&mut strict, &map, start, goal).0), Some((NoPathReason::GoalBlocked, 0)));
    let lax = HybridAStarParams { goal_tolerance: 1.5, goal_heading_tolerance: 0.2, ..params() };
    let mut lax = HybridAStar::new(lax, footprint()).unwrap();
    let (outcome, path) = plan(&mut lax, &map, start, goal);
    assert!(matches!(outcome, PlanOutcome::Found { .. }), "{outcome:?}");
    let off = goal.inverse() * path.points()[path.len() - 1].pose;
    assert!(off.translation().norm() <= 1.5 && off.yaw().abs() <= 0.2 && fault(&map, &path, 1.0, 0.0, 0.05).is_none());
}

#[test]
fn the_nearest_free_pose_is_taken_with_bounded_work() {
    // A goal on a slab that is thinner to the right of it than to any other side.
    let map = hall(&[(30, 20, 25, 40)]);
    let goal = at(&map, 4.85, 4.0, 0.0);
    let lax = HybridAStarParams { goal_tolerance: 3.0, goal_heading_tolerance: 0.1, ..params() };
    let mut planner = HybridAStar::new(lax, footprint()).unwrap();
    let (outcome, path) = plan(&mut planner, &map, at(&map, 8.0, 2.0, PI / 2.0), goal);
    assert!(matches!(outcome, PlanOutcome::Found { .. }), "{outcome:?}");
    let off = goal.inverse() * path.points()[path.len() - 1].pose;
    // Its tail, 0.3 m behind it, is as far off as the slab's edge at 5.5 m, to a cell.
    assert!(off.y().abs() < 1e-9 && off.x() > 0.9 && off.x() < 1.1 && off.yaw().abs() < 1e-9, "{off:?}");
    // The greatest tolerances on the finest grid: no overflow, and no more poses than the budget has.
    let tiny = GridLayout::new(60, 60, 1e-5, Se2::default()).unwrap();
    let full = Costmap::from_map(&Grid::filled(tiny, CellState::Free));
    let mut costs = full.costs().to_vec();
    costs[30 * 60 + 30] = cost::LETHAL;
    let map = Costmap::from_costs(Grid::new(tiny, costs).unwrap());
    let widest = HybridAStarParams {
        turning_radius: 1e-3,
        step: 1e-4,
        cell: 5e-5,
        goal_tolerance: 100.0,
        goal_heading_tolerance: PI,
        max_expansions: 1000,
        ..params()
    };
    let mut planner = HybridAStar::new(widest, Footprint::circle(5e-5).unwrap()).unwrap();
    let (start, goal) = (Se2::new(1e-4, 1e-4, 0.0), Se2::new(3.05e-4, 3.05e-4, 0.0));
    let outcome = planner.plan_into(&map, &start, &goal, &mut Path::new()).unwrap();
    assert!(!matches!(outcome, PlanOutcome::NoPath { reason: NoPathReason::StartBlocked, .. }), "{outcome:?}");
}

#[test]
fn bad_queries_are_refused() {
    let map = hall(&[]);
    let costmap = Costmap::from_map(&map);
    let mut planner = HybridAStar::new(params(), footprint()).unwrap();
    let good = at(&map, 2.0, 2.0, 0.0);
    let mut path = Path::new();
    for bad in [f64::NAN, f64::INFINITY] {
        for pose in [Se2::new(bad, 0.0, 0.0), Se2::new(0.0, bad, 0.0), Se2::new(0.0, 0.0, bad)] {
            assert!(matches!(planner.plan_into(&costmap, &pose, &good, &mut path), Err(PlanError::Invalid(_))));
            assert!(matches!(planner.plan_into(&costmap, &good, &pose, &mut path), Err(PlanError::Invalid(_))));
        }
    }
    let far = Se2::new(500.0, 0.0, 0.0);
    assert!(matches!(planner.plan_into(&costmap, &far, &good, &mut path), Err(PlanError::StartOutside { .. })));
    assert!(matches!(planner.plan_into(&costmap, &good, &far, &mut path), Err(PlanError::GoalOutside { .. })));
    assert!(HybridAStar::new(HybridAStarParams { turning_radius: 0.0, ..params() }, footprint()).is_err());
    // A map of one cell, and of cells that a step does not leave.
    let middle_of = |size: usize, resolution: f64| {
        let layout = GridLayout::new(size, size, resolution, Se2::default()).unwrap();
        let half = 0.5 * size as f64 * resolution;
        (Costmap::from_map(&Grid::filled(layout, CellState::Free)), Se2::new(half, half, 0.0))
    };
    let (tiny, middle) = middle_of(1, 0.1);
    assert!(reason(planner.plan_into(&tiny, &middle, &middle, &mut path).unwrap()).is_some());
    for resolution in [0.3, 50.0] {
        let (coarse, middle) = middle_of(40, resolution);
        assert!(matches!(planner.plan_into(&coarse, &middle, &middle, &mut path), Err(PlanError::Invalid(_))));
    }
    let (fair, middle) = middle_of(40, 0.24);
    let outcome = planner.plan_into(&fair, &middle, &middle, &mut path).unwrap();
    assert!(matches!(outcome, PlanOutcome::Found { cost: 0.0, .. }), "{outcome:?}");
    let unknown = Costmap::from_costs(Grid::filled(*map.layout(), cost::UNKNOWN));
    assert_eq!(
        reason(planner.plan_into(&unknown, &good, &good, &mut path).unwrap()),
        Some((NoPathReason::StartBlocked, 0))
    );
    let mut bold = HybridAStar::new(HybridAStarParams { unknown_is_obstacle: false, ..params() }, footprint()).unwrap();
    assert!(reason(bold.plan_into(&unknown, &good, &at(&map, 5.0, 4.0, 1.0), &mut path).unwrap()).is_none());
}
