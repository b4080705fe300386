//! Random fields of cylinders.

use super::scenes::{cylinders, footprint, local, path_through};
use agv_core::{
    geometry::{Se2, Twist2},
    grid::{CellState, CollisionChecker, CollisionParams, Grid, cost},
    kinematics::{MotionLimits, TwistLimits},
    roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState},
};
use agv_plan::teb::{Teb, TebParams};

pub(crate) fn barn_limits() -> MotionLimits {
    TwistLimits {
        forward_speed: 2.0,
        reverse_speed: 0.5,
        lateral_speed: 0.0,
        yaw_rate: 2.0,
        acceleration: 2.0,
        deceleration: 2.0,
        yaw_acceleration: 4.0,
    }
    .into()
}

#[derive(Debug, PartialEq)]
enum End {
    Arrived(f64, f64),
    Blocked(f64, VehicleState),
    Late,
}

fn drive(seed: u64, fill: f64) -> Option<End> {
    let costmap = cylinders(seed, fill);
    let (start, goal) = (Se2::new(2.25, 1.0, std::f64::consts::FRAC_PI_2), Se2::new(2.25, 9.2, 1.57));
    let path = path_through(&costmap, &start, &goal)?;
    let map = local(&costmap);
    let state = |&c: &u8| if c == cost::LETHAL { CellState::Occupied } else { CellState::Free };
    let grid = Grid::new(*costmap.layout(), costmap.costs().iter().map(state).collect()).unwrap();
    let params = CollisionParams { outside_is_obstacle: false, ..CollisionParams::default() };
    let checker = CollisionChecker::new(&grid, footprint(), params).unwrap();
    let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
    let limits = barn_limits();
    let mut state = VehicleState::new(start, Twist2::ZERO);
    let (mut length, mut blocked) = (0.0, 0);
    for cycle in 0..1200 {
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
        let command = teb.command(request).unwrap();
        assert!(limits.allows_step(&state.motion(), &command.motion, 0.05), "{seed}: {cycle}");
        for i in 1..=4 {
            let pose = state.map_from_base * command.motion.twist.integrate(0.0125 * f64::from(i));
            assert!(!checker.collides(&pose).unwrap(), "{seed} collides in cycle {cycle} at {pose:?}");
        }
        state = state.after(&command.motion, 0.05);
        length += command.motion.twist.speed() * 0.05;
        let rests = state.twist == Twist2::ZERO;
        match command.status {
            LocalPlanStatus::Arrived if rests => return Some(End::Arrived(0.05 * f64::from(cycle), length)),
            LocalPlanStatus::Blocked(_) if rests => blocked += 1,
            LocalPlanStatus::InCollision => panic!("{seed}: in collision at {state:?}"),
            _ => blocked = 0,
        }
        if blocked > 60 {
            return Some(End::Blocked(0.05 * f64::from(cycle), state));
        }
    }
    Some(End::Late)
}

/// Every field that has a path is crossed, without a touch and within the limits in any cycle, at a metre per second or more.
#[test]
fn fields_of_cylinders_are_crossed() {
    let (mut crossed, mut driven, mut taken) = (0, 0.0, 0.0);
    for seed in 0..50 {
        let fill = 0.15 + 0.025 * (seed % 7) as f64;
        match drive(seed, fill) {
            None => {}
            Some(End::Arrived(time, length)) => {
                crossed += 1;
                (driven, taken) = (driven + length, taken + time);
            }
            Some(other) => panic!("{seed}: {other:?}"),
        }
    }
    assert!(crossed > 15 && driven / taken > 1.0, "{crossed} crossed, {driven} m in {taken} s");
}
