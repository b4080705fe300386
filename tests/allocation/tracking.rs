//! Controllers and path trackers.

use crate::counter;
use agv_nav::control::{
    pid::{Pid, PidParams},
    plant::StandIn,
    step_response::{PidGains, StepFigures, StepResponse, simulate_step},
    track::{
        Lqr, LqrParams, Mpc, MpcParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams, Stanley,
        StanleyParams,
    },
};
use agv_nav::core::{
    geometry::Twist2,
    kinematics::MotionLimits,
    nalgebra::Vector2,
    path::Path,
    roles::{Controller, PathTracker, TrackStatus, VehicleState},
};

#[test]
fn pid() {
    let mut pid = Pid::new(PidParams { integral: 0.5, derivative: 0.1, ..Default::default() }).unwrap();
    let count = counter::count(|| {
        for k in 0..100 {
            pid.update(1.0, 0.01 * f64::from(k), 0.01).unwrap();
        }
        pid.reset();
    });
    assert_eq!(count, 0);
}

#[test]
fn plants_and_step_tests() {
    let mut late = StandIn::P3.plant().unwrap().with_dead_time(0.155).unwrap();
    let mut pid = Pid::new(PidParams { output_max: 1.0, output_min: -1.0, ..Default::default() }).unwrap();
    let mut response = StepResponse::default();
    let test = StandIn::P1.step_test().unwrap();
    let gains = [PidGains { proportional: 1.0, integral: 0.2, derivative: 0.1 }; 20];
    let (mut costs, mut figures) = ([0.0; 20], [StepFigures::default(); 20]);
    simulate_step(&mut late, &mut pid, 1.0, 0.01, 2.0, &mut response).unwrap();
    let count = counter::count(|| {
        simulate_step(&mut late, &mut pid, 1.0, 0.01, 2.0, &mut response).unwrap();
        test.cost_batch(&gains, &mut costs).unwrap();
        test.figures_batch(&gains, &mut figures).unwrap();
    });
    assert_eq!(count, 0);
}

#[test]
fn trackers() {
    let corner: Vec<_> = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.5, 2.5)].map(|(x, y)| Vector2::new(x, y)).to_vec();
    let (path, limits) = (Path::from_positions(&corner).unwrap(), MotionLimits::default());
    let trackers: [Box<dyn PathTracker>; 5] = [
        Box::new(PurePursuit::new(PurePursuitParams::default()).unwrap()),
        Box::new(Stanley::new(StanleyParams::default()).unwrap()),
        Box::new(Lqr::new(LqrParams::default()).unwrap()),
        Box::new(Mpc::new(MpcParams::default()).unwrap()),
        Box::new(PidTracker::new(PidTrackerParams::default()).unwrap()),
    ];
    for mut tracker in trackers {
        tracker.set_path(&path).unwrap();
        let mut arrived = false;
        let count = counter::count(|| {
            // A path no longer than the last one needs no room either.
            tracker.set_path(&path).unwrap();
            let mut state = VehicleState::new(path.points()[0].pose, Twist2::ZERO);
            for _ in 0..1000 {
                let command = tracker.command(&state, &limits, 0.05).unwrap();
                state = state.after(&command.motion, 0.05);
                arrived |= command.status == TrackStatus::Arrived;
            }
        });
        assert_eq!(count, 0);
        assert!(arrived);
    }
}
