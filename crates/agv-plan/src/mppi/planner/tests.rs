use super::*;
use crate::local::FieldParams;
use crate::local::scenes::{changes_of_side, drive, hall, path};
use agv_core::{
    geometry::Se2,
    grid::Footprint,
    kinematics::MotionLimits,
    obstacle::MovingObstacle,
    path::{Path, PathPoint},
    roles::{VehicleState, laws},
};
use nalgebra::Vector2;
use std::f64::consts::FRAC_PI_2;

fn params() -> MppiParams {
    MppiParams::for_footprint(&Footprint::rectangle(-0.25, 0.35, 0.4).unwrap())
}

/// An obstacle in the middle of the way, as wide to the left as to the right, and a pose that is noisy: whichever side is taken, it
/// is kept.
#[test]
fn it_does_not_hesitate_before_a_symmetrical_obstacle() {
    let map = hall(Some((3.0, 0.0, 0.5)));
    for seed in 0..20 {
        let mut planner = Mppi::new(MppiParams { samples: 400, ..params() }, Seed(seed)).unwrap();
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
    let mut planner = Mppi::new(params(), Seed(1)).unwrap();
    let (states, status) = drive(&mut planner, &map, &[person], None);
    assert_eq!(status, LocalPlanStatus::Arrived);
    for (i, state) in states.iter().enumerate() {
        let gap = person.gap_after(0.1 * (i + 1) as f64, &params().footprint, &state.map_from_base);
        assert!(gap > 0.0, "after {i} cycles");
    }
}

/// All that is sampled is within reach from step to step, from going back to full speed. Where a vehicle that steers would slow down
/// for a bend, the roll-out cuts the turn instead, and the curvature says nothing of it: its yaw rate is left out.
#[test]
fn samples_are_what_the_vehicle_can_do() {
    for (name, limits) in laws::vehicles() {
        samples_are_within(name, &limits);
    }
}

fn samples_are_within(name: &str, limits: &MotionLimits) {
    let (map, way) = (hall(Some((3.0, 0.0, 0.5))), path());
    let mut planner = Mppi::new(params(), Seed(5)).unwrap();
    let state = VehicleState::new(Se2::default(), Twist2::new(0.5, 0.0, 0.1));
    let request = LocalPlanRequest { state, path: &way, map: &map, obstacles: &[], limits, dt: 0.1 };
    planner.command(request).unwrap();
    let (most_turn, turn_rate) =
        limits.steering.map_or((limits.twist.yaw_rate, 1.0), |s| (limits.max_curvature(), s.max_rate / s.wheelbase));
    let begin = trajectories::now(&state, limits).map(f64::from);
    let (step, mut spread) = (step_of(&params()), (f32::INFINITY, f32::NEG_INFINITY));
    for (batch, costs) in planner.samples() {
        assert_eq!(batch.len(), costs.len());
        for i in 0..batch.len() {
            let mut now = begin;
            for k in 0..batch.steps() {
                let next = batch.control(i, k).map(f64::from);
                let rates = [0.5, 0.5, turn_rate];
                let is_near = |c: usize| (next[c] - now[c]).abs() <= rates[c] * step + 1e-5;
                assert!((0..3).all(is_near), "{name}: {now:?} {next:?}");
                let [vx, vy, turn] = next.map(|value| value * (1.0 - 1e-5));
                let yaw_rate = if limits.steering.is_some() { 0.0 } else { turn };
                assert!(limits.twist.allows(&Twist2::new(vx, vy, yaw_rate)), "{name}: {next:?}");
                assert!(turn.abs() <= most_turn, "{name}: {next:?}");
                let lateral = vx.abs().max(vy.abs()) * yaw_rate.abs();
                assert!(limits.lateral_acceleration.is_none_or(|most| lateral <= most), "{name}: {next:?}");
                now = next;
            }
            spread = (spread.0.min(now[0] as f32), spread.1.max(now[0] as f32));
        }
    }
    assert!(spread.0 <= 0.0 && spread.1 >= 0.99, "{name}: {spread:?}");
    assert_eq!(planner.samples().map(|(batch, _)| batch.len()).sum::<usize>(), 1000);
}

/// Threads, and how the noise is drawn, do not show in the commands; seeds do.
#[test]
fn runs_can_be_replayed() {
    let map = hall(Some((3.0, 0.2, 0.4)));
    let run = |seed: u64, par: Par| {
        let mut planner = Mppi::new(MppiParams { samples: 300, ..params() }, Seed(seed)).unwrap().with_parallelism(par);
        drive(&mut planner, &map, &[], None).0
    };
    let first = run(3, Par::Seq);
    assert!(first == run(3, Par::threads(2)) && first == run(3, Par::threads(4)));
    assert_ne!(first, run(4, Par::Seq));
}

#[test]
fn bad_input_is_refused_or_told() {
    let good = params();
    for bad in [
        MppiParams { samples: 1, ..good.clone() },
        MppiParams { steps: 0, ..good.clone() },
        MppiParams { knot: 0, ..good.clone() },
        MppiParams { horizon: 0.0, ..good.clone() },
        MppiParams { horizon: 99.0, ..good.clone() },
        MppiParams { speed_noise: f64::NAN, ..good.clone() },
        MppiParams { turn_noise: -0.1, ..good.clone() },
        MppiParams { temperature: 0.0, ..good.clone() },
        MppiParams { look_ahead: -1.0, ..good.clone() },
        MppiParams { stopping_share: 2.0, ..good.clone() },
        MppiParams { patience: 0.0, ..good.clone() },
        MppiParams { samples: usize::MAX, ..good.clone() },
        MppiParams { arc_speeds: usize::MAX, ..good.clone() },
        MppiParams { field: FieldParams { resolution: 0.0, ..good.field }, ..good.clone() },
    ] {
        assert!(Mppi::new(bad.clone(), Seed(0)).is_err(), "{bad:?}");
    }
    let (map, limits, way) = (hall(Some((3.0, 0.0, 0.5))), MotionLimits::default(), path());
    let mut planner = Mppi::new(good, Seed(0)).unwrap();
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
        planner.command(request).unwrap();
        assert!(!planner.plan.controls.is_empty());
        // Nothing of a plan outlasts an error.
        assert!(planner.command(LocalPlanRequest { dt: bad, ..request }).is_err() && planner.plan.controls.is_empty());
    }
}

/// What was left of the last path is no progress on the next, even if that begins with a turn.
#[test]
fn a_path_that_begins_with_a_turn_is_a_new_one() {
    let (map, limits) = (hall(None), MotionLimits::default());
    let mut planner = Mppi::new(MppiParams { patience: 3.0, samples: 400, ..params() }, Seed(2)).unwrap();
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
