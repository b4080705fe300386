//! What cannot be planned is said, and the same request has the same answer.

use super::{
    scenes::{cylinders, disc, footprint, hall, local, path_through, wall},
    worlds::barn_limits,
};
use agv_core::{
    compute::Par,
    geometry::{Se2, Twist2},
    grid::Footprint,
    kinematics::{MotionLimits, TwistLimits},
    nalgebra::Vector2,
    obstacle::MovingObstacle,
    path::Path,
    roles::{BlockReason, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState},
    trajectory::Trajectory,
};
use agv_plan::teb::{Teb, TebParams};

fn teb() -> Teb {
    Teb::new(TebParams::for_footprint(footprint())).unwrap()
}

#[test]
fn bad_requests_have_a_typed_answer() {
    let mut costmap = hall(9.0, 6.0);
    disc(&mut costmap, Vector2::new(7.0, 3.0), 0.4);
    let map = local(&costmap);
    let line = |points: &[(f64, f64)]| {
        Path::from_positions(&points.iter().map(|&(x, y)| Vector2::new(x, y)).collect::<Vec<_>>()).unwrap()
    };
    let path = line(&[(1.0, 3.0), (5.0, 3.0)]);
    let limits = barn_limits();
    let state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
    let good = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
    assert!(teb().command(good).is_ok());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let pose = VehicleState { map_from_base: Se2::new(bad, 3.0, 0.0), ..state };
        let twist = VehicleState { twist: Twist2::new(0.0, 0.0, bad), ..state };
        let steering = VehicleState { steering: Some(bad), ..state };
        for state in [pose, twist, steering] {
            assert!(matches!(teb().command(LocalPlanRequest { state, ..good }), Err(LocalPlanError::Invalid(_))));
        }
        assert!(teb().command(LocalPlanRequest { dt: bad, ..good }).is_err());
        let mover = MovingObstacle {
            position: Vector2::new(bad, 0.0),
            ..MovingObstacle::new(Vector2::zeros(), Vector2::zeros(), 0.1).unwrap()
        };
        assert!(teb().command(LocalPlanRequest { obstacles: &[mover], ..good }).is_err());
        let limits = MotionLimits::from(TwistLimits { acceleration: bad, ..TwistLimits::default() });
        assert!(teb().command(LocalPlanRequest { limits: &limits, ..good }).is_err());
    }
    for dt in [0.0, -0.1] {
        assert!(teb().command(LocalPlanRequest { dt, ..good }).is_err());
    }
    let empty = Path::new();
    assert_eq!(teb().command(LocalPlanRequest { path: &empty, ..good }), Err(LocalPlanError::EmptyPath));

    // Limits that let nothing move: it stands, and says why.
    let zero = TwistLimits { forward_speed: 0.0, reverse_speed: 0.0, yaw_rate: 0.0, ..TwistLimits::default() };
    let command = teb().command(LocalPlanRequest { limits: &zero.into(), ..good }).unwrap();
    assert_eq!((command.motion.twist, command.status), (Twist2::ZERO, LocalPlanStatus::Blocked(BlockReason::Limits)));

    let inside = VehicleState { map_from_base: Se2::new(6.9, 3.0, 0.0), ..state };
    let command = teb().command(LocalPlanRequest { state: inside, ..good }).unwrap();
    assert_eq!((command.status, command.motion.twist), (LocalPlanStatus::InCollision, Twist2::ZERO));

    // A goal in an obstacle: as far as it goes, then it says so. A path of one point: straight there. A path off the map: not.
    let into = line(&[(1.0, 3.0), (7.0, 3.0)]);
    let (state, status) = drive(LocalPlanRequest { path: &into, ..good });
    assert_eq!(status, LocalPlanStatus::Blocked(BlockReason::Obstacle));
    assert!(state.map_from_base.x() > 5.5, "{state:?}");
    let point = line(&[(4.0, 3.5)]);
    let (state, status) = drive(LocalPlanRequest { path: &point, ..good });
    assert_eq!(status, LocalPlanStatus::Arrived);
    assert!((state.map_from_base.translation() - Vector2::new(4.0, 3.5)).norm() < 0.1);
    let off = line(&[(1.0, 3.0), (1.0, 12.0)]);
    let (_, status) = drive(LocalPlanRequest { path: &off, ..good });
    assert!(matches!(status, LocalPlanStatus::Blocked(_)), "{status:?}");
    let (_, status) = drive(LocalPlanRequest { path: &line(&[(1.0, 3.0)]), ..good });
    assert_eq!(status, LocalPlanStatus::Arrived, "it is there");

    let params = TebParams { horizon: 0.0, ..TebParams::for_footprint(Footprint::point()) };
    assert!(Teb::new(params).is_err());
    assert!(teb().set_via_points(&[Vector2::new(f64::NAN, 0.0)]).is_err() && teb().prefer_rotation(f64::NAN).is_err());
}

/// A way that takes longer than a roll-out lasts is driven all the same.
#[test]
fn slow_vehicles_drive() {
    let map = local(&hall(9.0, 6.0));
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(8.0, 3.0)]).unwrap();
    let limits = TwistLimits { forward_speed: 0.1, ..TwistLimits::default() }.into();
    let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
    let mut teb = teb();
    for _ in 0..300 {
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.02 };
        let command = teb.command(request).unwrap();
        assert_eq!(command.status, LocalPlanStatus::Following);
        state = state.after(&command.motion, 0.02);
    }
    assert!(state.map_from_base.x() > 1.5, "{state:?}");
}

/// An estimate of a vehicle that stands is some tenths of a millimetre per second off.
#[test]
fn a_vehicle_at_rest_is_known_by_a_noisy_estimate() {
    let mut costmap = hall(9.0, 6.0);
    disc(&mut costmap, Vector2::new(5.0, 3.0), 0.4);
    wall(&mut costmap, 5.0, (9.0, 9.0));
    let (map, limits) = (local(&costmap), barn_limits());
    for (goal, ends) in [(3.0, LocalPlanStatus::Arrived), (8.0, LocalPlanStatus::Blocked(BlockReason::Obstacle))] {
        let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(goal, 3.0)]).unwrap();
        let (mut teb, mut said) = (teb(), LocalPlanStatus::Following);
        let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
        for cycle in 0..400 {
            let noise = if cycle % 2 == 0 { 3e-4 } else { -3e-4 };
            let twist = Twist2::new(state.twist.vx + noise, 0.0, state.twist.yaw_rate + noise);
            let seen = VehicleState { twist, ..state };
            let request =
                LocalPlanRequest { state: seen, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
            let command = teb.command(request).unwrap();
            said = command.status;
            state = state.after(&command.motion, 0.05);
        }
        assert_eq!((said, state.twist), (ends, Twist2::ZERO), "{state:?}");
    }
}

/// Drives until it rests and says that it arrived or is blocked.
fn drive(request: LocalPlanRequest<'_>) -> (VehicleState, LocalPlanStatus) {
    let mut teb = teb();
    let mut state = request.state;
    let mut said = LocalPlanStatus::Following;
    for _ in 0..600 {
        let command = teb.command(LocalPlanRequest { state, ..request }).unwrap();
        state = state.after(&command.motion, request.dt);
        said = command.status;
        if state.twist == Twist2::ZERO && said != LocalPlanStatus::Following {
            break;
        }
    }
    (state, said)
}

/// The plan as a whole keeps the limits, touches nothing and ends at rest; and it is the same for any number of threads.
#[test]
fn plans_keep_limits_and_are_the_same_on_all_threads() {
    let (start, goal) = (Se2::new(2.25, 1.0, 1.57), Se2::new(2.25, 9.2, 1.57));
    let world = |seed| {
        let costmap = cylinders(seed, 0.2);
        path_through(&costmap, &start, &goal).map(|path| (costmap, path))
    };
    let (costmap, path) = (0..50).find_map(world).unwrap();
    let (map, limits) = (local(&costmap), barn_limits());
    let plans = |par: Par| -> Vec<Trajectory> {
        let mut teb = teb().with_parallelism(par);
        let mut state = VehicleState::new(start, Twist2::ZERO);
        let plan = |_| {
            let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
            let plan = teb.plan(request).unwrap();
            let trajectory = plan.trajectory.clone();
            assert_eq!(trajectory.first_violation(&state.motion(), 0.05, &limits), None);
            if plan.is_free {
                assert_eq!(trajectory.points().last().unwrap().motion.twist, Twist2::ZERO);
                for point in trajectory.points() {
                    assert!(!map.collides(&footprint(), &point.map_from_base).unwrap());
                }
            }
            state = state.after(&plan.command.motion, 0.05);
            trajectory
        };
        (0..60).map(plan).collect()
    };
    let one = plans(Par::Seq);
    assert!(one.iter().filter(|t| t.len() > 20).count() > 40);
    for threads in [2, 4] {
        assert_eq!(plans(Par::threads(threads)), one);
    }
}
