//! The fusion filter, with late measurements.

use crate::counter;
use agv_nav::{
    core::{
        geometry::{UncertainPose, UncertainVector},
        sensors::{ImuSample, PoseObservation},
    },
    filters::fusion::{FusionFilter, FusionOutcome, FusionParams, SourceParams},
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};

#[test]
fn fusion_filter() {
    // A history that turns over many times.
    let mut filter = FusionFilter::new(FusionParams { history: 0.5, ..FusionParams::default() }).unwrap();
    let [wheels, gyro, tracker] =
        [SourceParams::wheels(), SourceParams::imu(), SourceParams::pose()].map(|s| filter.add_source(s).unwrap());
    let noise = Matrix3::identity() * 1e-4;
    let rates = UncertainVector::from_sigmas(Vector3::new(0.0, 0.0, 0.1), &Vector3::repeat(1e-3)).unwrap();
    filter.initialize(&PoseBelief::around(Se2::default(), noise).unwrap()).unwrap();
    let (step, mut odom, mut now) = (Twist2::new(0.5, 0.0, 0.1).integrate(0.02), Se2::default(), Stamp::default());
    let mut run = |steps: u32| {
        let mut late = 0;
        for i in 0..steps {
            let (next, then) = (odom * step, now + 0.02);
            filter.fuse(gyro, ImuSample::new(then).with_angular_velocity(rates)).unwrap();
            filter.fuse(wheels, OdometryIncrement::between(now, &odom, then, &next).unwrap()).unwrap();
            if i % 10 == 9 {
                // 100 ms late.
                let pose = UncertainPose::new(next * step.inverse() * step.inverse(), noise).unwrap();
                let outcome = filter.fuse(tracker, PoseObservation::new(then + -0.1, pose)).unwrap();
                late += u32::from(!matches!(outcome, FusionOutcome::TooOld));
                filter.take_motion().unwrap();
                assert!(filter.state_at(then + -0.15).is_some() && filter.diagnostics(tracker).is_some());
            }
            (odom, now) = (next, then);
        }
        assert_eq!(late, steps / 10);
    };
    run(10);
    assert_eq!(counter::count(|| run(500)), 0);
}
