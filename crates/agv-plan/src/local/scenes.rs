//! The hall in which planners that sample are tested, and a drive through it.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2},
    grid::{CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams},
    kinematics::MotionLimits,
    obstacle::MovingObstacle,
    path::Path,
    roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState},
};
use nalgebra::Vector2;
use rand_distr::{Distribution, Normal};

/// A free hall, or one with a round post: its centre and its radius.
pub(crate) fn hall(post: Option<(f64, f64, f64)>) -> LocalMap {
    let layout = GridLayout::new(180, 120, 0.05, Se2::new(-1.5, -3.0, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for index in 0..layout.len() {
        let center = layout.center(layout.cell(index));
        if post.is_some_and(|(x, y, radius)| (center - Vector2::new(x, y)).norm() < radius) {
            map.set(layout.cell(index), CellState::Occupied);
        }
    }
    LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap()
}

/// Six metres straight through its middle.
pub(crate) fn path() -> Path {
    Path::from_positions(&[Vector2::zeros(), Vector2::new(6.0, 0.0)]).unwrap()
}

/// Drives along the path until the vehicle arrives, for 40 s at the most; where it was, in every cycle. Noise is that of its poses, by seed.
pub(crate) fn drive(
    planner: &mut impl LocalPlanner,
    map: &LocalMap,
    people: &[MovingObstacle],
    noise: Option<u64>,
) -> (Vec<VehicleState>, LocalPlanStatus) {
    let (limits, path) = (MotionLimits::default(), path());
    let mut state = VehicleState::new(Se2::default(), Twist2::ZERO);
    let (mut people, mut states) = (people.to_vec(), Vec::new());
    let (mut stream, normal) = (Seed(noise.unwrap_or(0)).stream(0, 0), Normal::new(0.0, 0.01).unwrap());
    let mut status = LocalPlanStatus::Following;
    for _ in 0..400 {
        let mut seen = state;
        if noise.is_some() {
            let mut draw = || normal.sample(&mut stream);
            seen.map_from_base = state.map_from_base.compose(&Se2::new(draw(), draw(), draw()));
        }
        let request = LocalPlanRequest { state: seen, path: &path, map, obstacles: &people, limits: &limits, dt: 0.1 };
        let command = planner.command(request).unwrap();
        assert!(limits.allows_step(&state.motion(), &command.motion, 0.1));
        state = state.after(&command.motion, 0.1);
        for person in &mut people {
            person.position = person.position_after(0.1);
        }
        states.push(state);
        status = command.status;
        if status == LocalPlanStatus::Arrived {
            break;
        }
    }
    (states, status)
}

/// How often the side of the post at 3 m is changed, once it can be told which is headed for.
pub(crate) fn changes_of_side(states: &[VehicleState]) -> usize {
    let before = |pose: &Se2| pose.x() < 3.0 && pose.y().abs() > 0.05;
    let poses = states.iter().map(|state| state.map_from_base).filter(before);
    let sides: Vec<bool> = poses.map(|pose| pose.y() > 0.0).collect();
    sides.windows(2).filter(|w| w[0] != w[1]).count()
}
