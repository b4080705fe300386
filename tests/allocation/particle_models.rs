//! The models that a particle filter exchanges.

use crate::{
    counter,
    scenes::{
        circle, initialized,
        models::{MotionBody, codes, for_each_motion_model, landmarks, resamplers, scan_models},
    },
};
use agv_nav::core::{
    compute::{Par, Seed},
    odometry::OdometryIncrement,
};
use agv_nav::filters::particle::{MotionModel, WeighParticles};
use agv_nav::prelude::*;

#[test]
fn scan_models_weigh_without_allocating() {
    let (drive, poses) = (circle(3), initialized(1000, Par::Seq).particles().states().to_vec());
    let mut out = vec![0.0; poses.len()];
    for (name, mut model) in scan_models() {
        let mut run = || {
            for (_, scan) in &drive {
                model.weigh(scan, &poses, &mut out, Par::Seq).unwrap();
                assert!(model.explained(scan, &poses[0]).is_some());
            }
        };
        run();
        assert_eq!(counter::count(run), 0, "{name}");
    }
}

#[test]
fn readings_weigh_without_allocating() {
    let poses = initialized(1000, Par::Seq).particles().states().to_vec();
    let mut out = vec![0.0; poses.len()];
    let ((mut by_landmarks, seen), (mut by_codes, read)) = (landmarks(), codes());
    let mut run = || {
        by_landmarks.weigh(seen.as_slice(), &poses, &mut out, Par::Seq).unwrap();
        by_codes.weigh(read.as_slice(), &poses, &mut out, Par::Seq).unwrap();
    };
    run();
    assert_eq!(counter::count(run), 0);
}

#[test]
fn motion_models_and_resamplers_do_not_allocate() {
    struct Move;
    impl MotionBody for Move {
        fn call(
            &mut self,
            name: &str,
            model: &impl MotionModel<Motion = OdometryIncrement>,
            motion: &OdometryIncrement,
        ) {
            let count = counter::count(|| {
                let (sample, mut stream) = (model.condition(motion), Seed(1).stream(0, 0));
                let end = (0..100).fold(Se2::default(), |pose, _| sample(&pose, &mut stream));
                assert!(end.is_finite() && model.covariance(motion).trace() > 0.0);
            });
            assert_eq!(count, 0, "{name}");
        }
    }
    for_each_motion_model(Move);
    let weights: Vec<f64> = (0..500).map(|i| f64::from(i % 7)).collect();
    let mut ancestors = vec![0; 800];
    for (name, resampler) in resamplers() {
        let count = counter::count(|| resampler.resample(&weights, &mut Seed(1).stream(0, 0), &mut ancestors));
        assert_eq!(count, 0, "{name}");
    }
}
