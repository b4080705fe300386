use super::*;
use crate::local::scenes::{changes_of_side, drive, hall, path};
use crate::local::{
    FieldParams,
    critics::{
        BoundedObstacle, Clearance, GoalAlign, GoalDistance, Heading, KeyNodeDistance, KeyNodeHeading, Oscillation,
        PathAlign, PathDistance, PreferForward, Twirling, Velocity,
    },
};
use agv_core::{
    geometry::Se2,
    grid::{Footprint, LocalMap},
    kinematics::MotionLimits,
    obstacle::MovingObstacle,
    path::{Path, PathPoint},
    roles::VehicleState,
};
use std::f64::consts::FRAC_PI_2;

fn params() -> DwaParams {
    DwaParams::for_footprint(&Footprint::rectangle(-0.25, 0.35, 0.4).unwrap())
}

/// An obstacle in the middle of the way, as wide to the left as to the right, and a pose that is noisy: whichever side is taken, it
/// is kept.
#[test]
fn it_does_not_hesitate_before_a_symmetrical_obstacle() {
    let map = hall(Some((3.0, 0.0, 0.5)));
    for seed in 0..100 {
        let mut planner = Dwa::new(params()).unwrap();
        let (states, status) = drive(&mut planner, &map, &[], Some(seed));
        assert_eq!(status, LocalPlanStatus::Arrived, "seed {seed}");
        let changes = changes_of_side(&states);
        assert!(changes <= 1, "seed {seed}: {changes} changes of the side");
    }
}

#[test]
fn it_lets_somebody_pass_who_crosses() {
    let map = hall(None);
    let person = MovingObstacle::new(Vector2::new(2.5, -2.0), Vector2::new(0.0, 0.7), 0.3).unwrap();
    let mut planner = Dwa::new(params()).unwrap();
    let (states, status) = drive(&mut planner, &map, &[person], None);
    assert_eq!(status, LocalPlanStatus::Arrived);
    for (i, state) in states.iter().enumerate() {
        let gap = person.gap_after(0.1 * (i + 1) as f64, &params().footprint, &state.map_from_base);
        assert!(gap > 0.0, "after {i} cycles");
    }
}

/// Each set of critics leads to the goal past a post; the classic three, which stop before obstacles, on free ground.
#[test]
fn other_critics_lead_there_too() {
    let sets: [fn() -> Vec<Critic>; 3] = [
        || {
            vec![
                Critic::normalized(0.3, Heading),
                Critic::normalized(0.2, Clearance::default()),
                Critic::normalized(0.3, Velocity),
            ]
        },
        || {
            vec![
                Critic::normalized(0.2, KeyNodeHeading),
                Critic::normalized(0.3, Velocity),
                Critic::normalized(0.2, BoundedObstacle::default()),
                Critic::normalized(0.2, KeyNodeDistance),
            ]
        },
        || {
            vec![
                Critic::new(1.0, GoalDistance),
                Critic::new(0.3, PathDistance),
                Critic::new(0.1, PathAlign),
                Critic::new(0.2, GoalAlign),
                Critic::new(0.01, Twirling),
                Critic::new(0.2, Clearance { enough: 0.3 }),
                Critic::new(0.5, PreferForward),
                Critic::new(0.05, Oscillation),
            ]
        },
    ];
    let halls = [hall(None), hall(Some((3.0, 0.7, 0.2))), hall(Some((3.0, 0.7, 0.2)))];
    for (k, (critics, map)) in sets.into_iter().zip(halls).enumerate() {
        let mut planner = Dwa::with_critics(params(), critics()).unwrap();
        let (states, _) = drive(&mut planner, &map, &[], None);
        let nearest = states.iter().map(|s| (s.map_from_base.translation() - Vector2::new(6.0, 0.0)).norm());
        assert!(nearest.fold(f64::INFINITY, f64::min) < 0.5, "set {k}: {:?}", states.last());
    }
}

#[test]
fn bad_input_is_refused_or_told() {
    let good = params();
    for bad in [
        DwaParams { speeds: 1, ..good.clone() },
        DwaParams { turns: 0, ..good.clone() },
        DwaParams { steps: 0, ..good.clone() },
        DwaParams { horizon: 0.0, ..good.clone() },
        DwaParams { horizon: 9.0, ..good.clone() },
        DwaParams { window: f64::NAN, ..good.clone() },
        DwaParams { look_ahead: -1.0, ..good.clone() },
        DwaParams { stopping_share: 2.0, ..good.clone() },
        DwaParams { patience: 0.0, ..good.clone() },
        DwaParams { speeds: usize::MAX, ..good.clone() },
        DwaParams { field: FieldParams { resolution: 0.0, ..good.field }, ..good.clone() },
    ] {
        assert!(Dwa::new(bad.clone()).is_err(), "{bad:?}");
    }
    let (map, limits, way) = (hall(Some((3.0, 0.0, 0.5))), MotionLimits::default(), path());
    let mut planner = Dwa::new(good).unwrap();
    let state = VehicleState::new(Se2::default(), Twist2::ZERO);
    let request = LocalPlanRequest { state, path: &way, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
    let mut still = limits;
    (still.twist.forward_speed, still.twist.reverse_speed, still.twist.yaw_rate) = (0.0, 0.0, 0.0);
    // No speed at all: it stands, and says so.
    let command = planner.command(LocalPlanRequest { limits: &still, ..request }).unwrap();
    assert!(command.motion.twist == Twist2::ZERO && matches!(command.status, LocalPlanStatus::Blocked(_)));
    let inside = VehicleState::new(Se2::new(3.0, 0.0, 0.0), Twist2::ZERO);
    let command = planner.command(LocalPlanRequest { state: inside, ..request }).unwrap();
    assert_eq!(command.status, LocalPlanStatus::InCollision);
    let aside = VehicleState::new(Se2::new(3.0, 2.0, 0.0), Twist2::ZERO);
    let command = planner.command(LocalPlanRequest { state: aside, ..request }).unwrap();
    assert_eq!(command.status, LocalPlanStatus::Blocked(BlockReason::OffPath));
    // A goal in the obstacle, and a path of one point.
    let into = Path::from_positions(&[Vector2::zeros(), Vector2::new(3.0, 0.0)]).unwrap();
    assert!(planner.command(LocalPlanRequest { path: &into, ..request }).is_ok());
    let mut one = Path::new();
    one.push(PathPoint { pose: Se2::new(0.0, 2.0, 1.0), ..PathPoint::default() }).unwrap();
    let command = planner.command(LocalPlanRequest { path: &one, ..request }).unwrap();
    assert_eq!(command.status, LocalPlanStatus::Following);
    assert_eq!(planner.command(LocalPlanRequest { path: &Path::new(), ..request }), Err(LocalPlanError::EmptyPath));
    for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
        assert!(planner.command(LocalPlanRequest { dt: bad, ..request }).is_err());
    }
}

/// A post in the short way of a turn: the other one is taken, to its end.
#[test]
fn a_post_in_the_short_way_is_turned_around() {
    let (map, limits) = (hall(Some((0.225, 0.325, 0.01))), MotionLimits::default());
    let mut way = Path::new();
    way.push(PathPoint { pose: Se2::new(0.0, 0.0, 1.9), ..PathPoint::default() }).unwrap();
    let mut planner = Dwa::new(params()).unwrap();
    let mut state = VehicleState::new(Se2::default(), Twist2::ZERO);
    let mut status = LocalPlanStatus::Following;
    for _ in 0..100 {
        let request = LocalPlanRequest { state, path: &way, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
        let command = planner.command(request).unwrap();
        assert!(command.motion.twist.yaw_rate <= 0.0, "{command:?}");
        state = state.after(&command.motion, 0.1);
        status = command.status;
        if status == LocalPlanStatus::Arrived {
            break;
        }
    }
    assert_eq!(status, LocalPlanStatus::Arrived, "{state:?}");
}

/// Where a path changes its gear the vehicle comes to rest, and does not begin to turn.
#[test]
fn a_stop_on_the_way_is_no_turn() {
    let (map, limits, way) = (hall(None), MotionLimits::default(), path());
    let planner = Dwa::new(params()).unwrap();
    let state = VehicleState::new(Se2::default(), Twist2::new(0.3, 0.0, 0.0));
    let request = LocalPlanRequest { state, path: &way, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
    let command = lead::turn(&planner.guard, &request, 0.0).unwrap();
    assert_eq!(command.motion.twist.yaw_rate, 0.0);
    assert!((command.motion.twist.vx - 0.25).abs() < 1e-9 && command.status == LocalPlanStatus::Following);
}

/// Somebody bars the way for longer than the planner has patience, and leaves.
#[test]
fn standing_for_somebody_takes_no_patience() {
    let (map, limits, way) = (hall(None), MotionLimits::default(), path());
    let mut planner = Dwa::new(DwaParams { patience: 3.0, ..params() }).unwrap();
    let crowd = [MovingObstacle::new(Vector2::new(5.0, 0.0), Vector2::zeros(), 4.0).unwrap()];
    let mut state = VehicleState::new(Se2::default(), Twist2::ZERO);
    let mut status = LocalPlanStatus::Following;
    for cycle in 0..400 {
        let obstacles: &[MovingObstacle] = if cycle < 200 { &crowd } else { &[] };
        let request = LocalPlanRequest { state, path: &way, map: &map, obstacles, limits: &limits, dt: 0.1 };
        let command = planner.command(request).unwrap();
        state = state.after(&command.motion, 0.1);
        status = command.status;
        if cycle == 199 {
            assert!(matches!(status, LocalPlanStatus::Blocked(_)), "{status:?}");
        }
    }
    assert_eq!(status, LocalPlanStatus::Arrived, "{state:?}");
}

/// What touches something in its first step is not chosen, whatever the critics look at.
#[test]
fn what_is_blocked_at_once_costs_infinity() {
    // A cell ahead, a few centimetres before the nose, at speed: all trajectories that go on touch it.
    let (map, limits, way) = (hall(Some((0.425, 0.025, 0.01))), MotionLimits::default(), path());
    let mut planner = Dwa::with_critics(params(), vec![Critic::new(1.0, Velocity)]).unwrap();
    let state = VehicleState::new(Se2::default(), Twist2::new(1.0, 0.0, 0.0));
    planner
        .command(LocalPlanRequest { state, path: &way, map: &map, obstacles: &[], limits: &limits, dt: 0.1 })
        .unwrap();
    let blocked: Vec<_> = (0..planner.costs().len()).filter(|&i| planner.trajectories().free()[i] == 0).collect();
    assert!(!blocked.is_empty() && blocked.iter().all(|&i| planner.costs()[i].is_infinite()));
}

/// Paper 000's adjustment of the window: narrow near obstacles and at rest.
#[test]
fn the_window_follows_speed_and_room() {
    let (limits, way) = (MotionLimits::default(), path());
    let planner = Dwa::new(DwaParams { adaptive: Some(crate::dwa::AdaptiveWindow::default()), ..params() }).unwrap();
    let time = |map: &LocalMap, speed: f64| {
        let state = VehicleState::new(Se2::default(), Twist2::new(speed, 0.0, 0.0));
        planner.window_time(&LocalPlanRequest { state, path: &way, map, obstacles: &[], limits: &limits, dt: 0.1 })
    };
    let (free, near) = (hall(None), hall(Some((0.8, 0.0, 0.2))));
    assert_eq!(time(&free, 1.0), 0.6);
    assert_eq!(time(&free, 0.0), 0.3);
    assert!(time(&near, 1.0) < 0.25);
}

/// Nothing stands in the hall, so whoever bars all ways is waited for, not planned around.
#[test]
fn who_moves_and_rules_all_trajectories_out_is_told() {
    let (map, limits, way) = (hall(None), MotionLimits::default(), path());
    for (vx, x) in [(0.0, 0.3), (0.8, 0.3)] {
        let mut planner = Dwa::new(params()).unwrap();
        let person = [MovingObstacle::new(Vector2::new(x, 0.0), Vector2::new(-0.5, 0.0), 0.5).unwrap()];
        let state = VehicleState::new(Se2::default(), Twist2::new(vx, 0.0, 0.0));
        let command = planner
            .command(LocalPlanRequest { state, path: &way, map: &map, obstacles: &person, limits: &limits, dt: 0.1 })
            .unwrap();
        assert!(planner.costs().iter().all(|cost| cost.is_infinite()), "{vx} {x}");
        assert_eq!(command.status, LocalPlanStatus::Blocked(BlockReason::MovingObstacle), "{vx} {x}");
    }
}

/// What was left of the last path is no progress on the next, even if that begins with a turn.
#[test]
fn a_path_that_begins_with_a_turn_is_a_new_one() {
    let (map, limits) = (hall(None), MotionLimits::default());
    let mut planner = Dwa::new(DwaParams { patience: 3.0, ..params() }).unwrap();
    let mut state = VehicleState::new(Se2::new(0.0, -2.0, FRAC_PI_2), Twist2::ZERO);
    let first = Path::from_positions(&[Vector2::new(0.0, -2.0), Vector2::new(0.0, -1.0)]).unwrap();
    let mut second = Path::new();
    for (x, yaw) in [(0.0, FRAC_PI_2), (0.0, 0.0), (6.0, 0.0)] {
        second.push(PathPoint { pose: Se2::new(x, -1.0, yaw), ..PathPoint::default() }).unwrap();
    }
    for (path, turns) in [(&first, false), (&second, true)] {
        let mut status = LocalPlanStatus::Following;
        state.twist = Twist2::ZERO;
        for cycle in 0..300 {
            let request = LocalPlanRequest { state, path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
            let command = planner.command(request).unwrap();
            assert!(!turns || cycle > 0 || command.motion.twist.yaw_rate.abs() > 0.05, "{command:?}");
            state = state.after(&command.motion, 0.1);
            status = command.status;
            if status == LocalPlanStatus::Arrived {
                break;
            }
        }
        assert_eq!(status, LocalPlanStatus::Arrived, "{state:?}");
    }
}
