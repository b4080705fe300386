//! Smooth paths on empty maps, among pillars and round posts.

use super::*;
use crate::grid::{AStar, AStarParams};
use crate::smooth::{KeyNodes, LineOfSightParams, Straightened};
use agv_core::geometry::{LieGroup, Se2, So2};
use agv_core::grid::{Cell, CellState, CollisionParams, Grid, GridLayout, Inflation, InflationParams};
use agv_core::path::Gear;
use agv_core::roles::{GlobalPlanner, PlanOutcome};
use proptest::prelude::*;

fn smoother() -> CurvatureSmoother {
    CurvatureSmoother::new(CurvatureSmootherParams::default()).unwrap()
}

/// The vehicle's poses where it turns or drives straight on, from the first one on.
fn way(path: &Path) -> Vec<Se2> {
    let mut poses = vec![path.points()[0].pose];
    for pair in path.points().windows(2) {
        let [from, to] = [pair[0], pair[1]].map(|point| point.pose.translation());
        let heading = So2::from_direction(to.x - from.x, to.y - from.y);
        poses.extend([from, to].map(|position| Se2::from_parts(position, heading)));
    }
    poses.extend(path.points().last().map(|point| point.pose));
    poses
}

/// Whether the vehicle may touch anything: true too if it passes within a quarter of a cell.
fn may_touch(obstacles: &ObstacleMap, footprint: &Footprint, path: &Path) -> bool {
    way(path).windows(2).any(|pair| obstacles.collides_between(footprint, &pair[0], &pair[1]).unwrap())
}

/// Whether it touches anything at one of the poses that are looked at, a centimetre or degree apart.
fn touches(obstacles: &ObstacleMap, footprint: &Footprint, path: &Path) -> bool {
    way(path).windows(2).any(|pair| {
        let step = pair[1].minus(&pair[0]);
        let count = (step.norm() * 100.0).ceil();
        (0..=count as i32).any(|i| {
            let pose = pair[0].plus(&(step * (f64::from(i) / count.max(1.0))));
            obstacles.collides(footprint, &pose).unwrap()
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(250))]
    /// Among pillars, with the outline of a circle: free where the planned path is free.
    #[test]
    fn smooth_paths_touch_nothing(pillars in proptest::collection::vec((8_i32..72, 8_i32..72), 0..25)) {
        let layout = GridLayout::new(80, 80, 0.1, Se2::new(1.0, -2.0, 0.3)).unwrap();
        let mut map = Grid::filled(layout, CellState::Free);
        for (x, y) in pillars {
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                map.set(Cell::new(x + dx, y + dy), CellState::Occupied);
            }
        }
        let footprint = Footprint::circle(0.25).unwrap();
        let params = InflationParams { inscribed_radius: 0.45, inflation_radius: 0.45, ..Default::default() };
        let costmap = Inflation::new(params).unwrap().inflate(&map).unwrap();
        let pose = |x, y| Se2::from_parts(layout.center(Cell::new(x, y)), So2::default());
        let mut planner = Straightened::new(
            AStar::new(AStarParams::default()).unwrap(),
            KeyNodes::new(LineOfSightParams::default()).unwrap(),
        );
        let (mut path, mut smooth) = (Path::new(), Path::new());
        let outcome = planner.plan_into(&costmap, &pose(4, 4), &pose(75, 75), &mut path).unwrap();
        let found = matches!(outcome, PlanOutcome::Found { .. });
        prop_assume!(found);
        let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(2.0)).unwrap();
        prop_assume!(!may_touch(&obstacles, &footprint, &path));
        let outcome = smoother().smooth_into(&obstacles, &footprint, &path, &mut smooth).unwrap();
        prop_assert!(!touches(&obstacles, &footprint, &smooth));
        prop_assert_eq!(smooth.points()[0].pose, pose(4, 4));
        prop_assert_eq!(smooth.points()[smooth.len() - 1].pose, pose(75, 75));
        let mut sampled = Vec::new();
        let line: Vec<_> = path.points().iter().map(|p| p.pose.translation()).collect();
        resample(&line, outcome.samples - 1, &mut sampled, |_| ());
        let before = greatest_curvature(&sampled);
        prop_assert!(outcome.kept > 0 || outcome.max_curvature <= before.max(1.0), "{:?} {}", outcome, before);
    }

    /// Round the corner of a post, as a taut string lies: the lines have no more room than the check needs, the corner between
    /// them little more, and the headings at both ends are any.
    #[test]
    fn smooth_paths_touch_no_post_that_the_given_one_rounds(
        (direction, turn) in (0.0..6.3_f64, 0.05..0.9_f64),
        (back, ahead) in (0.8..2.5_f64, 0.8..2.5_f64),
        half_length in prop_oneof![Just(0.0), 0.3..0.8_f64],
        spacing in 0.05..0.6_f64,
        path_weight in prop_oneof![Just(0.01), Just(100.0)],
        obstacle_weight in prop_oneof![Just(1e-3), Just(200.0)],
        headings in prop_oneof![Just([0.0; 2]), (-3.0..3.0_f64, -3.0..3.0_f64).prop_map(|(a, b)| [a, b])],
    ) {
        let layout = GridLayout::new(80, 80, 0.1, Se2::new(-4.0, -4.0, 0.0)).unwrap();
        let mut map = Grid::filled(layout, CellState::Free);
        let post = layout.cell_at(&Vector2::new(0.05, 0.05)).unwrap();
        map.set(post, CellState::Occupied);
        let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(2.0)).unwrap();
        let half_width = 0.3;
        let footprint = if half_length > 0.0 {
            Footprint::rectangle(-half_length, half_length, 2.0 * half_width).unwrap()
        } else {
            Footprint::circle(half_width).unwrap()
        };
        // Outwards from the post, and the corner of it that lies farthest out.
        let out = Vector2::new(direction.cos(), direction.sin());
        let corner = layout.center(post) + Vector2::new(out.x.signum(), out.y.signum()) * 0.05;
        let along = |angle: f64| {
            let angle = direction - std::f64::consts::FRAC_PI_2 + angle;
            Vector2::new(angle.cos(), angle.sin())
        };
        let bend = corner + out * ((half_width + 0.04) / (0.5 * turn).cos());
        let (into, onward) = (along(0.5 * turn), along(-0.5 * turn));
        let mut path = Path::new();
        for (position, ahead, heading) in
            [(bend - into * back, into, headings[0]), (bend, onward, 0.0), (bend + onward * ahead, onward, headings[1])]
        {
            let heading = So2::from_angle(ahead.y.atan2(ahead.x) + heading);
            path.push(PathPoint { pose: Se2::from_parts(position, heading), gear: Gear::Forward }).unwrap();
        }
        prop_assume!(!may_touch(&obstacles, &footprint, &path));
        let params = CurvatureSmootherParams { spacing, path_weight, obstacle_weight, clearance: 0.0, ..Default::default() };
        let mut smooth = Path::new();
        let outcome = CurvatureSmoother::new(params).unwrap().smooth_into(&obstacles, &footprint, &path, &mut smooth).unwrap();
        prop_assert!(!touches(&obstacles, &footprint, &smooth), "{:?} {:?}", outcome, smooth);
    }
}

#[test]
fn corners_are_rounded_to_the_radius() {
    let map = Grid::filled(GridLayout::new(200, 200, 0.1, Se2::default()).unwrap(), CellState::Free);
    let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(1.0)).unwrap();
    let zigzag = [(2.0, 2.0), (10.0, 2.0), (10.0, 10.0), (4.0, 16.0)].map(|(x, y)| Vector2::new(x, y));
    for max_curvature in [0.5, 1.0, 2.0] {
        let params = CurvatureSmootherParams { max_curvature, ..Default::default() };
        let mut smooth = Path::new();
        let outcome = CurvatureSmoother::new(params).unwrap().smooth_into(
            &obstacles,
            &Footprint::rectangle(-0.5, 0.5, 0.6).unwrap(),
            &Path::from_positions(&zigzag).unwrap(),
            &mut smooth,
        );
        let outcome = outcome.unwrap();
        assert!(outcome.max_curvature <= max_curvature && outcome.kept == 0, "{max_curvature}: {outcome:?}");
        assert!(smooth.length() < Path::from_positions(&zigzag).unwrap().length());
    }
}

#[test]
fn samples_are_even_and_ends_exact() {
    let line = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.55)].map(|(x, y)| Vector2::new(x, y));
    let (mut points, mut lines) = (Vec::new(), Vec::new());
    let step = resample(&line, 16, &mut points, |line| lines.push(line));
    assert_eq!(points.len(), 17);
    assert_eq!(lines, [[0; 11].as_slice(), &[1; 6]].concat());
    assert!((step - 1.55 / 16.0).abs() < 1e-12);
    assert_eq!((points[0], points[16]), (Vector2::zeros(), Vector2::new(1.0, 0.55)));
}

#[test]
fn bad_input_is_named() {
    let default = CurvatureSmootherParams::default();
    for params in [
        CurvatureSmootherParams { max_curvature: 0.0, ..default },
        CurvatureSmootherParams { spacing: f64::NAN, ..default },
        CurvatureSmootherParams { clearance: -0.1, ..default },
        CurvatureSmootherParams { path_weight: f64::INFINITY, ..default },
    ] {
        assert!(CurvatureSmoother::new(params).is_err(), "{params:?}");
    }
    let map = Grid::filled(GridLayout::new(20, 20, 0.1, Se2::default()).unwrap(), CellState::Free);
    let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(1.0)).unwrap();
    let footprint = Footprint::circle(0.2).unwrap();
    let far = Path::from_positions(&[Vector2::zeros(), Vector2::new(1e9, 0.0)]).unwrap();
    let mut smooth = far.clone();
    assert!(smoother().smooth_into(&obstacles, &footprint, &far, &mut smooth).is_err() && smooth.is_empty());
    for few in [&[][..], &[Vector2::new(1.0, 1.0)], &[Vector2::new(1.0, 1.0), Vector2::new(1.02, 1.0)]] {
        let path = Path::from_positions(few).unwrap();
        let outcome = smoother().smooth_into(&obstacles, &footprint, &path, &mut smooth).unwrap();
        assert!(smooth == path && outcome.max_curvature == 0.0);
    }
}
