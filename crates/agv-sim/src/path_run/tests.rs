use super::*;
use agv_core::{
    path::shapes,
    roles::{TrackCommand, TrackError},
};

/// Drives straight on at a speed, through every limit, and says that it arrived after some cycles.
struct Blind {
    speed: f64,
    cycles: usize,
}

impl PathTracker for Blind {
    fn set_path(&mut self, path: &Path) -> Result<(), TrackError> {
        if path.len() < 2 { Err(TrackError::NoPath) } else { Ok(()) }
    }

    fn command(&mut self, _: &VehicleState, _: &MotionLimits, _: f64) -> Result<TrackCommand, TrackError> {
        self.cycles -= 1;
        let status = if self.cycles == 0 { TrackStatus::Arrived } else { TrackStatus::Tracking };
        let motion = Motion::from(Twist2::new(if self.cycles == 0 { 0.0 } else { self.speed }, 0.0, 0.0));
        Ok(TrackCommand { motion, status, cross_track_error: 0.0, heading_error: 0.0, remaining: 0.0 })
    }
}

#[test]
fn every_command_beyond_a_limit_is_counted() {
    let path = shapes::line(2.0, 0.1).unwrap();
    let drive = |speed| PathRunParams::default().drive(&mut Blind { speed, cycles: 11 }, None, &path, Seed(1)).unwrap();
    // From rest to 0.5 m/s at once, and back.
    assert_eq!(drive(0.5).violations, 2);
    assert_eq!(drive(3.0).violations, 11);
    assert_eq!(drive(0.02).violations, 0);
}

#[test]
fn a_run_is_judged_by_the_truth_and_repeats() {
    let path = shapes::s_curve(3.0, 1.0, 0.02).unwrap();
    let drive =
        || PathRunParams::default().drive(&mut Blind { speed: 1.0, cycles: 200 }, None, &path, Seed(1)).unwrap();
    let run = drive();
    assert_eq!(run, drive());
    // Straight on it leaves the curve to the right and passes its end by, a metre to the side.
    assert!(run.arrived && run.max() > 0.9 && run.rmse() < run.max() && run.samples.len() == 200);
    assert!(run.samples.iter().all(|s| s.cross_track < 1e-3 && s.truth.y().abs() < 1e-3));
    assert!((run.end_from_base.y() + 1.0).abs() < 1e-3 && (run.duration() - 3.98).abs() < 1e-9);
    // The estimate is the noisy pose.
    let off = run.samples.iter().map(|s| s.estimate.y()).fold(0.0, f64::max);
    assert!(off > 0.015 && off < 0.06, "{off}");
}

#[test]
fn bad_runs_are_refused() {
    let (good, path) = (PathRunParams::default(), shapes::line(2.0, 0.1).unwrap());
    let mut tracker = Blind { speed: 0.1, cycles: 5 };
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(PathRunParams { dt: bad, ..good }.drive(&mut tracker, None, &path, Seed(1)).is_err());
    }
    assert!(good.drive(&mut tracker, None, &Path::new(), Seed(1)).is_err());
    assert!(PathRunParams::ackermann().is_ok() && PathRunParams::omnidirectional().is_ok());
}
