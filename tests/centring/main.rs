//! Stopping over a code: a differential vehicle with lag, slip and noisy odometry, its pose by what its camera sees of the code.

use CentringStatus::{Approaching, BackingUp, Failed};
use agv_nav::{
    control::track::{FollowerParams, Stanley, StanleyParams},
    core::{
        kinematics::MotionLimits,
        nalgebra::{Matrix3, Vector2},
        sensors::{PinholeCamera, PinholeParams},
    },
    filters::{
        kalman::{PoseFilter, PoseFilterParams},
        marker::{
            CodeReader, CodeReaderParams, FloorProjection, MarkerLocalizer, MarkerLocalizerParams, MarkerMap,
            looking_down,
        },
    },
    pipeline::{Centring, CentringParams, CentringStatus},
    prelude::*,
};
use agv_sim::{CodeCamera, CodeCameraParams, FloorCode, PathRunParams, Vehicle};

const DT: f64 = 0.02;

fn centring(params: CentringParams) -> Centring {
    let follower = FollowerParams { bend_window: 0.2, goal_tolerance: 0.003, ..FollowerParams::default() };
    let tracker = Stanley::new(StanleyParams { follower, ..StanleyParams::default() }).unwrap();
    Centring::new(Box::new(tracker), params).unwrap()
}

/// Where the vehicle ended relative to the goal, in truth, and how.
fn stop_over_a_code(offset: Se2, seed: Seed) -> (CentringStatus, Se2) {
    let code = FloorCode { id: 7, map_from_code: Se2::new(3.0, 2.0, 0.6) };
    let projection = FloorProjection::new(
        PinholeCamera::new(PinholeParams::default()).unwrap(),
        looking_down(Vector2::new(0.15, 0.0), 0.5, 0.0),
    )
    .unwrap();
    let reader = CodeReader::new(projection, CodeReaderParams::default()).unwrap();
    let map = MarkerMap::from_exact([(code.id, code.map_from_code)]).unwrap();
    let localizer = MarkerLocalizer::new(map, MarkerLocalizerParams::default()).unwrap();
    let params = CodeCameraParams::new(*projection.camera(), *projection.base_from_camera());
    let mut camera = CodeCamera::new(CodeCameraParams { missed: 0.1, ..params }, vec![code], seed).unwrap();

    let goal = Centring::base_over(&code.map_from_code, &Se2::new(0.15, 0.0, 0.0));
    let start = goal * offset;
    let run = PathRunParams::differential();
    let limits = MotionLimits::from(TwistLimits { forward_speed: 0.5, reverse_speed: 0.3, ..run.limits.twist });
    let mut vehicle = Vehicle::new(run.vehicle, start, seed).unwrap();
    // What the laser knew: 3 cm and 2 degrees.
    let mut filter = PoseFilter::new(PoseFilterParams::default()).unwrap();
    let known = start.plus(&agv_nav::nalgebra::Vector3::new(0.03, -0.03, 0.03));
    let spread = Matrix3::from_diagonal(&agv_nav::nalgebra::Vector3::new(1e-3, 1e-3, 1e-3));
    filter.initialize(&PoseBelief::around(known, spread).unwrap()).unwrap();

    let mut centring = centring(CentringParams::default());
    let mut motion = Motion::REST;
    let believed = |filter: &PoseFilter| *filter.estimate().unwrap().map_from_base();
    centring.start(&goal, &VehicleState::new(believed(&filter), Twist2::ZERO)).unwrap();
    for cycle in 0..6000 {
        let odometry = vehicle.step(&motion.twist, DT).unwrap();
        filter.predict(&odometry).unwrap();
        if cycle % 2 == 0 {
            let sightings = camera.look(&vehicle.map_from_base()).unwrap();
            let seen: Vec<_> = sightings.iter().filter_map(|s| reader.observe(vehicle.now(), s).ok()).collect();
            if let Some(observation) = localizer.locate(&seen).unwrap().observation() {
                filter.update(observation).unwrap();
            }
        }
        let step = centring.command(&VehicleState::new(believed(&filter), motion.twist), &limits, DT).unwrap();
        assert!(limits.allows_step(&motion, &step.motion, DT), "cycle {cycle}: {motion:?} {:?}", step.motion);
        motion = step.motion;
        if matches!(step.status, CentringStatus::Centred | CentringStatus::Failed) {
            return (step.status, goal.between(&vehicle.map_from_base()));
        }
    }
    (centring.status(), goal.between(&vehicle.map_from_base()))
}

/// From behind, from the side, from too near and from beyond: within the tolerance of 1.2 cm and 1.5° and three millimetres and
/// half a degree that the estimate is off at most, in every run.
#[test]
fn the_vehicle_stops_over_the_code() {
    for (x, y, yaw) in [(-1.5, 0.0, 0.0), (-1.2, 0.1, -0.2), (-0.3, 0.05, 0.1), (0.1, -0.06, 0.05)] {
        for seed in 0..5 {
            let (status, end) = stop_over_a_code(Se2::new(x, y, yaw), Seed(seed));
            assert_eq!(status, CentringStatus::Centred, "{x} {y} {yaw}, seed {seed}: {end:?}");
            assert!(end.translation().norm() < 0.015 && end.yaw().abs() < 0.035, "{x} {y} {yaw}, seed {seed}: {end:?}");
        }
    }
}

/// A vehicle that is told nothing of its motion cannot be centred, and is told so after its attempts.
#[test]
fn attempts_are_bounded() {
    let mut centring = centring(CentringParams { attempts: 2, position_tolerance: 1e-9, ..Default::default() });
    let limits = MotionLimits::default();
    let mut state = VehicleState::new(Se2::new(-1.0, 0.02, 0.0), Twist2::ZERO);
    centring.start(&Se2::default(), &state).unwrap();
    let mut statuses = vec![centring.status()];
    for _ in 0..4000 {
        let step = centring.command(&state, &limits, DT).unwrap();
        state = state.after(&step.motion, DT);
        statuses.push(step.status);
    }
    statuses.dedup();
    assert_eq!(statuses, [Approaching, BackingUp, Approaching, Failed]);
    assert!(state.twist == Twist2::ZERO, "at rest");
}

#[test]
fn bad_calls_are_refused() {
    let tracker = || Box::new(Stanley::new(StanleyParams::default()).unwrap());
    let good = CentringParams::default();
    for bad in [
        CentringParams { run_up: 0.0, ..good },
        CentringParams { speed: 0.0, ..good },
        CentringParams { deceleration: f64::INFINITY, ..good },
        CentringParams { position_tolerance: f64::NAN, ..good },
        CentringParams { heading_tolerance: -1.0, ..good },
        CentringParams { settle_time: f64::NAN, ..good },
        CentringParams { attempts: 0, ..good },
    ] {
        assert!(Centring::new(tracker(), bad).is_err(), "{bad:?}");
    }
    let mut centring = centring(good);
    let state = VehicleState::new(Se2::default(), Twist2::ZERO);
    assert!(centring.command(&state, &MotionLimits::default(), DT).is_err(), "not started");
    assert!(centring.start(&Se2::new(f64::NAN, 0.0, 0.0), &state).is_err());
    let lost = VehicleState::new(Se2::new(f64::NAN, 0.0, 0.0), Twist2::ZERO);
    assert!(centring.start(&Se2::new(1.0, 0.0, 0.0), &lost).is_err());
}
