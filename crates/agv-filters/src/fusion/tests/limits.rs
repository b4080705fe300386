//! Bad input, and long silence.

use super::*;
use agv_core::{Error, roles::LocalizationError};

fn ready() -> (FusionFilter, [SourceId; 3]) {
    let mut filter = FusionFilter::new(FusionParams::default()).unwrap();
    let ids = [SourceParams::wheels(), SourceParams::imu(), SourceParams::pose()]
        .map(|source| filter.add_source(source).unwrap());
    filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
    (filter, ids)
}

#[test]
fn bad_parameters_are_named() {
    let good = FusionParams::default();
    let motion = good.motion;
    let with = |vx| FusionParams { motion: MotionParams { vx, ..motion }, ..good };
    for bad in [
        with(Wander::new(-1.0, 1.0)),
        with(Wander::new(f64::NAN, 1.0)),
        with(Wander::new(1.0, 0.0)),
        with(Wander::new(1.0, f64::INFINITY)),
        FusionParams { gyro_bias_sigma: -1.0, ..good },
        FusionParams { gyro_bias_walk: f64::NAN, ..good },
        FusionParams { distance_scale_sigma: 0.6, ..good },
        FusionParams { yaw_scale_walk: -1.0, ..good },
        FusionParams { latency_sigma: -0.1, ..good },
        FusionParams { latency_sigma: 2.0, ..good },
        FusionParams { history: -0.1, ..good },
        FusionParams { capacity: 1, ..good },
        FusionParams { longest_gap: 0.0, ..good },
        FusionParams { clock_patience: 0, ..good },
    ] {
        assert!(FusionFilter::new(bad).is_err(), "{bad:?}");
    }
    let mut filter = FusionFilter::new(good).unwrap();
    let source = SourceParams::pose();
    for bad in [
        SourceParams { gate: 0.0, ..source },
        SourceParams { gate: 1.1, ..source },
        SourceParams { gate: f64::NAN, ..source },
        SourceParams { latency: f64::NAN, ..source },
        SourceParams { late: true, reference: Reference::First, ..source },
        SourceParams { timeout: 0.0, ..source },
        SourceParams { floor: NoiseFloor { yaw: -1.0, ..source.floor }, ..source },
        SourceParams { motion: MotionNoise { yaw_per_radian: f64::NAN, ..source.motion }, ..source },
        SourceParams { components: Components::AX, ..source },
    ] {
        assert!(filter.add_source(bad).is_err(), "{bad:?}");
    }
    let late = SourceParams { late: true, ..source };
    let mut other = FusionFilter::new(good).unwrap();
    assert!(other.add_source(late).is_ok() && matches!(other.add_source(late), Err(Error::TooMany { .. })));
    for _ in 0..FusionFilter::MAX_RELATIVE {
        filter.add_source(SourceParams::wheels()).unwrap();
    }
    assert!(matches!(filter.add_source(SourceParams::wheels()), Err(Error::TooMany { .. })));
    assert!(filter.take_motion().is_err());
    for _ in FusionFilter::MAX_RELATIVE..FusionFilter::MAX_SOURCES {
        filter.add_source(SourceParams::pose()).unwrap();
    }
    assert!(matches!(filter.add_source(SourceParams::pose()), Err(Error::TooMany { .. })));
}

/// Each is refused, and the filter is as it was.
#[test]
fn bad_measurements_change_nothing() {
    let (mut filter, [wheels, gyro, tracker]) = ready();
    filter.fuse(gyro, rates(0.1, 0.2, 1e-3)).unwrap();
    let before = filter.clone();
    let step = Se2::new(0.1, 0.0, 0.0);
    let good = motion(0.0, &Se2::default(), 0.1, &step, squares([1e-3; 3]));
    let nan = Se2::new(f64::NAN, 0.0, 0.0);
    let bad_motions = [
        OdometryIncrement { start_from_end: nan, ..good },
        OdometryIncrement { start_from_end: Se2::new(1e9, 0.0, 0.0), ..good },
        OdometryIncrement { covariance: -good.covariance, ..good },
        OdometryIncrement { covariance: good.covariance * f64::NAN, ..good },
        OdometryIncrement { end: good.start, ..good },
        OdometryIncrement { end: good.start + -0.1, ..good },
    ];
    for bad in bad_motions {
        assert!(filter.fuse(wheels, bad).is_err(), "{bad:?}");
    }
    assert!(filter.fuse(tracker, good).is_err(), "motions need a reference");
    assert!(filter.fuse(SourceId(7), good).is_err());
    assert!(filter.fuse(gyro, ImuSample::new(at(0.2))).is_err(), "nothing in it");
    assert!(filter.fuse(gyro, rates(0.2, 1e9, 1e-3)).is_err());
    assert!(filter.fuse(tracker, seen(0.2, Se2::new(1e9, 0.0, 0.0), squares([0.1; 3]))).is_err());
    assert_eq!(filter, before);
    // Without floor, a covariance of zero is no noise at all.
    let exact = filter.add_source(bare(SourceParams::pose())).unwrap();
    let refused = filter.fuse(exact, seen(0.2, Se2::default(), Matrix3::zeros()));
    assert!(matches!(refused, Err(LocalizationError::Invalid(Error::OutOfRange { .. }))));
}

#[test]
fn beliefs_are_needed_and_checked() {
    let mut filter = FusionFilter::new(FusionParams::default()).unwrap();
    let gyro = filter.add_source(SourceParams::imu()).unwrap();
    assert_eq!(filter.fuse(gyro, rates(0.0, 0.1, 0.01)), Err(LocalizationError::NotInitialized));
    assert_eq!((filter.state(), filter.diagnostics(gyro), filter.take_motion()), (None, None, Ok(None)));
    assert!(filter.initialize(&PoseBelief::Anywhere).is_err());
    assert!(filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::identity() * 1e13).unwrap()).is_err());
    filter.initialize(&belief(Se2::default())).unwrap();
    // The first measurement says when it is.
    filter.fuse(gyro, rates(1e9, 0.1, 0.01)).unwrap();
    assert_eq!(filter.state().unwrap().stamp, at(1e9));
}

/// A month without poses, and then one: the belief widens, stays a covariance, and comes back.
#[test]
fn a_long_silence_does_no_harm() {
    let params = FusionParams { longest_gap: 1e9, ..FusionParams::default() };
    let mut filter = FusionFilter::new(params).unwrap();
    let [gyro, tracker] = [SourceParams::imu(), SourceParams::pose()].map(|s| filter.add_source(s).unwrap());
    filter.initialize_at(at(0.0), &belief(Se2::default())).unwrap();
    for hour in 1..=720 {
        filter.fuse(gyro, rates(3600.0 * f64::from(hour), 0.001, 1e-3)).unwrap();
        assert!(filter.state().is_some());
    }
    let lost = filter.state().unwrap();
    assert!(lost.pose.position_deviation() > 1000.0 && lost.twist.speed() < 1e-6);
    for second in 1..=50 {
        let time = 3600.0 * 720.0 + f64::from(second);
        filter.fuse(tracker, seen(time, Se2::new(3.0, 4.0, 0.5), squares([0.01; 3]))).unwrap();
    }
    let found = filter.state().unwrap();
    assert!(found.pose.mean().minus(&Se2::new(3.0, 4.0, 0.5)).norm() < 0.02, "{:?}", found.pose);
    assert!(found.pose.position_deviation() < 0.02);
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_filter_goes_on_with_the_same_bits() {
    let run = |filter: &mut FusionFilter, ids: &[SourceId; 3], from: u32, to: u32| {
        for step in from..to {
            let (start, end) = (0.02 * f64::from(step), 0.02 * f64::from(step + 1));
            let moved = motion(start, &Se2::default(), end, &Se2::new(0.01, 0.0, 0.002), Matrix3::zeros());
            filter.fuse(ids[1], rates(end, 0.11, 1e-3)).unwrap();
            filter.fuse(ids[0], moved).unwrap();
        }
        filter.fuse(ids[2], seen(0.02 * f64::from(to) - 0.1, Se2::new(1.0, 0.1, 0.2), squares([0.1; 3]))).unwrap();
    };
    let (mut filter, ids) = ready();
    run(&mut filter, &ids, 0, 60);
    let text = serde_json::to_string(&filter).unwrap();
    let mut stored: FusionFilter = serde_json::from_str(&text).unwrap();
    assert_eq!(stored, filter);
    run(&mut filter, &ids, 60, 90);
    run(&mut stored, &ids, 60, 90);
    assert_eq!(stored, filter);
    for (good, bad) in
        [("\"capacity\":500", "\"capacity\":0"), ("\"gate\":0.9999", "\"gate\":7.0"), ("\"slot\":0", "\"slot\":9")]
    {
        assert!(text.contains(good), "{good}");
        assert!(serde_json::from_str::<FusionFilter>(&text.replace(good, bad)).is_err(), "{bad}");
    }
}
