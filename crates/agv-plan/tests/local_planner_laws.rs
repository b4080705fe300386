//! The local planners keep the laws of their role, with every kind of vehicle.

use agv_core::compute::Seed;
use agv_core::geometry::{LieGroup, Se2, Twist2};
use agv_core::grid::{CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams};
use agv_core::kinematics::{Motion, MotionLimits, stopping_speed};
use agv_core::nalgebra::Vector2;
use agv_core::path::Path;
use agv_core::roles::{
    LocalPlanRequest, LocalPlanStatus, PathTracker, TrackCommand, TrackError, TrackStatus, VehicleState, laws,
};
use agv_plan::dwa::{Dwa, DwaParams};
use agv_plan::local::{Tracked, TrackedParams};
use agv_plan::mppi::{Mppi, MppiParams};
use rand_distr::{Distribution, Uniform};
use std::f64::consts::PI;

/// A hall with posts, but none on the straight way from the left to the right, or some there as well.
fn hall(seed: u64, posts: usize, clear: f64) -> LocalMap {
    let layout = GridLayout::new(180, 120, 0.05, Se2::new(-1.5, -3.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    let mut stream = Seed(seed).stream(0, 0);
    let (along, across) = (Uniform::new(0.9, 5.0).unwrap(), Uniform::new(-2.5, 2.5).unwrap());
    for _ in 0..posts {
        let post: Vector2<f64> = Vector2::new(along.sample(&mut stream), across.sample(&mut stream));
        if post.y.abs() < clear {
            continue;
        }
        for index in 0..layout.len() {
            if (layout.center(layout.cell(index)) - post).norm() < 0.1 {
                map.set(layout.cell(index), CellState::Occupied);
            }
        }
    }
    LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap()
}

#[test]
fn the_dynamic_window_keeps_the_laws() {
    let footprint = Footprint::rectangle(-0.25, 0.35, 0.4).unwrap();
    let path = Path::from_positions(&[Vector2::zeros(), Vector2::new(6.0, 0.0)]).unwrap();
    for (name, limits) in laws::vehicles() {
        for (seed, posts, clear) in [(0, 0, 0.0), (1, 20, 0.6), (2, 6, 0.0), (3, 14, 0.0), (4, 25, 0.0)] {
            let map = hall(seed, posts, clear);
            let mut planner = Dwa::new(DwaParams::for_footprint(&footprint)).unwrap();
            let state = VehicleState::new(Se2::new(0.0, 0.1, 0.3), Twist2::ZERO);
            let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let heading = if limits.turns_on_the_spot() { 0.11 } else { PI };
            let verdict = laws::local_planner(&mut planner, request, &footprint, 0.15, heading);
            assert_eq!(verdict, Ok(()), "{name} among {posts} posts");
        }
    }
}

#[test]
fn path_integral_control_keeps_the_laws() {
    let footprint = Footprint::rectangle(-0.25, 0.35, 0.4).unwrap();
    let path = Path::from_positions(&[Vector2::zeros(), Vector2::new(6.0, 0.0)]).unwrap();
    for (name, limits) in laws::vehicles() {
        for (seed, posts, clear) in [(0, 0, 0.0), (1, 20, 0.6), (2, 6, 0.0), (3, 14, 0.0), (4, 25, 0.0)] {
            let map = hall(seed, posts, clear);
            let params = MppiParams { samples: 400, ..MppiParams::for_footprint(&footprint) };
            let mut planner = Mppi::new(params, Seed(seed)).unwrap();
            let state = VehicleState::new(Se2::new(0.0, 0.1, 0.3), Twist2::ZERO);
            let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let heading = if limits.turns_on_the_spot() { 0.11 } else { PI };
            let verdict = laws::local_planner(&mut planner, request, &footprint, 0.15, heading);
            assert_eq!(verdict, Ok(()), "{name} among {posts} posts");
        }
    }
}

/// Steers along the arc to the end of a straight path, and says that it arrived while it still moves a little.
struct ToTheEnd(Path);

impl PathTracker for ToTheEnd {
    fn set_path(&mut self, path: &Path) -> Result<(), TrackError> {
        self.0.clone_from(path);
        if path.length() > 0.0 { Ok(()) } else { Err(TrackError::NoPath) }
    }

    fn command(&mut self, state: &VehicleState, limits: &MotionLimits, dt: f64) -> Result<TrackCommand, TrackError> {
        let end = self.0.points().last().ok_or(TrackError::NoPath)?.pose.translation();
        let ahead = state.map_from_base.inverse().act(&end);
        let (remaining, arrived) = (ahead.norm(), ahead.x < 0.1);
        let speed = if arrived { 0.0 } else { stopping_speed(ahead.x, 0.4, dt).min(0.8) };
        let curvature = 2.0 * ahead.y / remaining.max(0.5).powi(2);
        let curvature = limits.steering.map_or(curvature, |s| s.curvature((curvature * s.wheelbase).atan()));
        let steering = limits.steering.map(|s| (curvature * s.wheelbase).atan());
        let target = Motion { twist: Twist2::new(speed, 0.0, speed * curvature), steering };
        let motion = limits.step(&state.motion(), &target, dt)?;
        let status = if arrived { TrackStatus::Arrived } else { TrackStatus::Tracking };
        Ok(TrackCommand { motion, status, cross_track_error: 0.0, heading_error: 0.0, remaining })
    }
}

/// Whatever the tracker says, and wherever it thinks that it is: also with a wall just behind the goal.
#[test]
fn a_tracker_that_is_minded_keeps_the_laws() {
    let footprint = Footprint::rectangle(-0.25, 0.35, 0.4).unwrap();
    for (name, limits) in laws::vehicles() {
        for (seed, posts, clear, goal) in [
            (0, 0, 0.0, 6.0),
            (1, 20, 0.6, 6.0),
            (2, 6, 0.0, 6.0),
            (3, 14, 0.0, 6.0),
            (4, 25, 0.0, 6.0),
            (0, 0, 0.0, 7.12),
        ] {
            let path = Path::from_positions(&[Vector2::zeros(), Vector2::new(goal, 0.0)]).unwrap();
            let map = hall(seed, posts, clear);
            let mut planner = Tracked::new(ToTheEnd(Path::new()), footprint.clone(), TrackedParams::default()).unwrap();
            let steering = limits.steering.map(|_| 0.0);
            let state = VehicleState { steering, ..VehicleState::new(Se2::new(0.0, 0.1, 0.1), Twist2::ZERO) };
            let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let verdict = laws::local_planner(&mut planner, request, &footprint, 0.15, PI);
            assert_eq!(verdict, Ok(()), "{name} among {posts} posts to {goal}");
        }
    }
}

/// Where nothing is in the way, everybody arrives: the laws would take standing for an answer, too.
#[test]
fn everybody_arrives_on_free_ground() {
    use agv_core::roles::LocalPlanner;
    let footprint = Footprint::rectangle(-0.25, 0.35, 0.4).unwrap();
    let path = Path::from_positions(&[Vector2::zeros(), Vector2::new(6.0, 0.0)]).unwrap();
    let map = hall(0, 0, 0.0);
    for (name, limits) in laws::vehicles() {
        let window = Dwa::new(DwaParams::for_footprint(&footprint)).unwrap();
        let integral = Mppi::new(MppiParams::for_footprint(&footprint), Seed(1)).unwrap();
        let planners: [(&str, Box<dyn LocalPlanner>); 2] = [("dwa", Box::new(window)), ("mppi", Box::new(integral))];
        for (kind, mut planner) in planners {
            let mut state = VehicleState::new(Se2::new(0.0, 0.2, 0.4), Twist2::ZERO);
            let mut arrived = None;
            for cycle in 0..200 {
                let request =
                    LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
                let command = planner.command(request).unwrap();
                state = state.after(&command.motion, 0.1);
                if command.status == LocalPlanStatus::Arrived {
                    arrived = Some(cycle);
                    break;
                }
            }
            assert!(arrived.is_some_and(|cycle| cycle < 150), "{kind}, {name}: {state:?}");
        }
    }
}
