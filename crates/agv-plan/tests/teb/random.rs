//! Random worlds: whatever is returned keeps the limits, touches nothing, and leaves a way to brake.

use super::scenes::{disc, footprint, hall, local};
use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2},
    grid::{CellState, CollisionChecker, CollisionParams, Costmap, Grid, cost},
    kinematics::{Motion, MotionLimits},
    nalgebra::Vector2,
    path::Path,
    roles::{LocalPlanRequest, LocalPlanStatus, VehicleState, laws},
};
use agv_plan::{
    local::{Guard, GuardParams},
    teb::{Teb, TebParams},
};
use rand_distr::{Distribution, Uniform};

/// Cycles between looks at all of the plan.
const LOOK: u32 = 5;

/// A hall with posts, some of them on the path, and a path with a corner from one end to the other.
fn world(seed: u64) -> (Costmap, Path) {
    let mut stream = Seed(seed).stream(1, 0);
    let mut draw = |low: f64, high: f64| Uniform::new(low, high).unwrap().sample(&mut stream);
    let mut costmap = hall(9.0, 6.0);
    for _ in 0..6 {
        let (x, y) = (draw(2.2, 7.5), draw(0.5, 5.5));
        disc(&mut costmap, Vector2::new(x, y), draw(0.05, 0.3));
    }
    let corner = Vector2::new(draw(3.0, 6.0), draw(2.0, 4.0));
    let path = [Vector2::new(1.0, 3.0), corner, Vector2::new(8.0, draw(1.5, 4.5))];
    (costmap, Path::from_positions(&path).unwrap())
}

fn checker(costmap: &Costmap) -> CollisionChecker {
    let state = |&c: &u8| if c == cost::LETHAL { CellState::Occupied } else { CellState::Free };
    let grid = Grid::new(*costmap.layout(), costmap.costs().iter().map(state).collect()).unwrap();
    let params = CollisionParams { outside_is_obstacle: false, ..CollisionParams::default() };
    CollisionChecker::new(&grid, footprint(), params).unwrap()
}

/// The footprint swept, looked at every centimetre at the most.
fn sweeps(checker: &CollisionChecker, from: &Se2, motion: &Motion, dt: f64) -> bool {
    let reach = (motion.twist.speed() + motion.twist.yaw_rate.abs() * 0.34) * dt;
    let looks = (reach / 0.01).ceil().max(1.0) as u32;
    (0..=looks).any(|i| {
        let pose = from.compose(&motion.twist.integrate(dt * f64::from(i) / f64::from(looks)));
        checker.collides(&pose).unwrap()
    })
}

/// Brakes to rest from a state, within the limits and without a touch.
fn can_brake(guard: &Guard, checker: &CollisionChecker, request: LocalPlanRequest<'_>) -> bool {
    let mut state = request.state;
    for _ in 0..200 {
        if state.twist == Twist2::ZERO {
            return true;
        }
        let motion = guard.brake(&LocalPlanRequest { state, ..request }).unwrap();
        let allowed = request.limits.allows_step(&state.motion(), &motion, request.dt);
        if !allowed || sweeps(checker, &state.map_from_base, &motion, request.dt) {
            return false;
        }
        state = state.after(&motion, request.dt);
    }
    false
}

/// Drives through a world; says whether it arrived.
fn drive(name: &str, limits: &MotionLimits, seed: u64) -> bool {
    let (costmap, path) = world(seed);
    let (map, checker) = (local(&costmap), checker(&costmap));
    let guard = Guard::new(footprint(), GuardParams::default()).unwrap();
    let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
    let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
    for cycle in 0..240 {
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits, dt: 0.1 };
        let plan = teb.plan(request).unwrap();
        let motion = plan.command.motion;
        let case = format!("{name}, world {seed}, cycle {cycle} at {state:?}");
        assert!(limits.allows_step(&state.motion(), &motion, 0.1), "{case}: {motion:?}");
        assert!(!sweeps(&checker, &state.map_from_base, &motion, 0.1), "{case}: {motion:?}");
        assert!(plan.command.status != LocalPlanStatus::InCollision, "{case}");
        if cycle % LOOK == 0 {
            let points = plan.trajectory.points();
            assert_eq!(plan.trajectory.first_violation(&state.motion(), 0.1, limits), None, "{case}");
            if plan.is_free {
                let touches = |p: &&_| -> bool {
                    let p: &agv_core::trajectory::TrajectoryPoint = p;
                    sweeps(&checker, &p.map_from_base, &p.motion, 0.1)
                };
                assert!(points.iter().find(touches).is_none(), "{case}");
                assert_eq!(points.last().unwrap().motion.twist, Twist2::ZERO, "{case}");
            }
        }
        state = state.after(&motion, 0.1);
        if cycle % LOOK == 0 {
            assert!(can_brake(&guard, &checker, LocalPlanRequest { state, ..request }), "{case}: cannot brake");
        }
        if state.twist == Twist2::ZERO && plan.command.status == LocalPlanStatus::Arrived {
            return true;
        }
    }
    false
}

#[test]
fn what_is_returned_is_allowed_free_and_can_be_braked() {
    for (name, limits) in laws::vehicles() {
        let arrived = (0..8).filter(|&seed| drive(name, &limits, seed)).count();
        assert!(arrived >= 4, "{name}: only {arrived} arrive");
    }
}
