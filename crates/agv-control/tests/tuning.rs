//! Tuning a path tracker by driving it: any parameters, any cost.

use agv_control::{
    optimize::{Interval, Search, Stopping},
    pso::{Swarm, SwarmParams},
    track::{PurePursuit, PurePursuitParams},
    tune::Knobs,
};
use agv_core::{
    compute::Seed,
    geometry::Twist2,
    kinematics::MotionLimits,
    nalgebra::Vector2,
    path::Path,
    roles::{PathTracker, TrackStatus, VehicleState},
};

/// A wave of 0.8 m amplitude and 6 m length.
fn wave() -> Path {
    let points = (0..=200).map(|k| f64::from(k) * 0.05).map(|x| Vector2::new(x, 0.8 * (x * 1.047).sin()));
    Path::from_positions(&points.collect::<Vec<_>>()).unwrap()
}

/// Root mean square of the cross-track error of a vehicle whose yaw rate lags by 0.15 s; NaN if it does not arrive.
fn drive(params: &PurePursuitParams, path: &Path) -> f64 {
    let Ok(mut tracker) = PurePursuit::new(*params) else { return f64::NAN };
    tracker.set_path(path).unwrap();
    let (limits, dt) = (MotionLimits::default(), 0.05);
    let mut state = VehicleState { map_from_base: path.points()[0].pose, ..VehicleState::default() };
    let (mut sum, mut yaw_rate) = (0.0, 0.0);
    for cycle in 1..2000 {
        let command = tracker.command(&state, &limits, dt).unwrap();
        sum += command.cross_track_error * command.cross_track_error;
        if command.status == TrackStatus::Arrived {
            return (sum / f64::from(cycle)).sqrt();
        }
        let mut motion = command.motion;
        yaw_rate += (motion.twist.yaw_rate - yaw_rate) * (1.0 - (-dt / 0.15_f64).exp());
        motion.twist = Twist2::new(motion.twist.vx, 0.0, yaw_rate);
        state = state.after(&motion, dt);
    }
    f64::NAN
}

#[test]
fn a_tracker_is_tuned_by_driving_it() {
    let path = wave();
    let knobs = Knobs::new(PurePursuitParams { look_ahead_max: 3.0, ..PurePursuitParams::default() })
        .knob(Interval::linear(0.1, 3.0), |p| &mut p.look_ahead_time)
        .knob(Interval::log(0.05, 2.0), |p| &mut p.look_ahead_min);
    let cost = knobs.objective(|params| drive(params, &path));
    let swarm = Swarm::new(2, SwarmParams { particles: 10, ..SwarmParams::improved() }, Seed(1)).unwrap();
    let mut search = Search::new(knobs.space().unwrap(), swarm).unwrap();
    let outcome = search.run(&cost, &Stopping { max_evaluations: 150, ..Stopping::default() }).unwrap();

    // No worse than the best of a raster of twice as many points.
    let raster = (0..15).flat_map(|i| (0..20).map(move |j| (f64::from(i) / 14.0, f64::from(j) / 19.0)));
    let mut point = [0.0; 2];
    let best = raster.fold(f64::INFINITY, |best, (u, v)| {
        knobs.space().unwrap().values_into(&[u, v], &mut point);
        best.min(drive(&knobs.params(&point), &path))
    });
    assert!(outcome.cost <= 1.02 * best, "{} by {:?}, the raster has {best}", outcome.cost, outcome.point);
    assert_eq!(drive(&knobs.params(&outcome.point), &path), outcome.cost);
}
