//! The model against the densities written out, nearest landmarks against all of them, and bad input.

use super::*;
use agv_core::{
    compute::Seed,
    geometry::{UncertainVector, wrap_angle},
    time::Stamp,
};
use proptest::prelude::*;
use rand::RngExt;

fn seen(id: Option<u32>, range: f64, bearing: f64, sigmas: (f64, f64)) -> LandmarkObservation {
    let measured = UncertainVector::from_sigmas(Vector2::new(range, bearing), &Vector2::new(sigmas.0, sigmas.1));
    LandmarkObservation::new(Stamp::default(), id, measured.unwrap()).unwrap()
}

/// Landmarks over a hall of 40 m by 20 m; three to a number.
fn landmarks() -> Vec<(u32, Vector2<f64>)> {
    let mut stream = Seed(2).stream(0, 0);
    (0..90).map(|i| (i / 3, Vector2::new(40.0 * stream.random::<f64>(), 20.0 * stream.random::<f64>()))).collect()
}

fn model(landmarks: Vec<(u32, Vector2<f64>)>) -> LandmarkModel {
    LandmarkModel::new(landmarks, LandmarkModelParams::default()).unwrap()
}

/// The mixture of the module's head, up to the same constant for all poses.
fn density(
    seen: &LandmarkObservation,
    pose: &Se2,
    landmarks: &[(u32, Vector2<f64>)],
    params: &LandmarkModelParams,
) -> f64 {
    let sensor = *pose * seen.base_from_sensor();
    let variance = params.position_sigma.powi(2);
    let spread = seen.range_bearing().covariance()
        + Matrix2::from_diagonal(&Vector2::new(variance, variance / seen.range().powi(2)));
    let best = landmarks
        .iter()
        .filter(|(id, _)| seen.id().is_none_or(|wanted| wanted == *id))
        .map(|(_, place)| {
            let delta = place - sensor.translation();
            let bearing = wrap_angle(delta.y.atan2(delta.x) - sensor.yaw());
            let d = Vector2::new(seen.range() - delta.norm(), wrap_angle(seen.bearing() - bearing));
            (-0.5 * d.dot(&(spread.try_inverse().unwrap() * d))).exp() / (TAU * spread.determinant().sqrt())
        })
        .fold(0.0, f64::max);
    (1.0 - params.outlier) * best + params.outlier / (params.range_max * TAU)
}

proptest! {
    /// Ratios of likelihoods are those of the densities, with numbers and without, also where nothing fits.
    #[test]
    fn agrees_with_the_densities(
        id in prop::option::of(0_u32..30), range in 0.5..15.0_f64, bearing in -3.1..3.1_f64,
        poses in prop::collection::vec((0.0..40.0_f64, 0.0..20.0_f64, -3.1..3.1_f64), 2..20),
        sigma in 0.01..0.5_f64,
    ) {
        let landmarks = landmarks();
        let seen = seen(id, range, bearing, (sigma, 0.1 * sigma)).with_mount(Se2::new(0.4, -0.2, 0.6)).unwrap();
        let mut model = model(landmarks.clone());
        let params = *model.params();
        let judged = model.condition(&seen).unwrap();
        let of = |(x, y, yaw): (f64, f64, f64)| {
            let pose = Se2::new(x, y, yaw);
            judged.log_likelihood(&pose) - density(&seen, &pose, &landmarks, &params).ln()
        };
        let constant = of(poses[0]);
        for &pose in &poses {
            // Landmarks beyond the gate, whose density is below a hundredth of the floor, are left out.
            prop_assert!((of(pose) - constant).abs() < 0.021, "{} {}", of(pose), constant);
        }
    }
}

/// The pose that the readings were taken from is the likeliest, whatever the wrong ones among them say.
#[test]
fn the_right_pose_wins_over_a_false_reading() {
    let landmarks = landmarks();
    let truth = Se2::new(17.0, 9.0, 3.0);
    let mut seen: Vec<LandmarkObservation> = landmarks
        .iter()
        .step_by(11)
        .map(|(_, place)| {
            let towards = truth.inverse().act(place);
            self::seen(None, towards.norm(), towards.y.atan2(towards.x), (0.05, 0.01))
        })
        .collect();
    seen.push(self::seen(Some(4), 0.7, 0.1, (0.01, 0.001)));
    let mut model = model(landmarks);
    let judged = model.condition(seen.as_slice()).unwrap();
    let share = judged.explained(&truth).unwrap();
    assert!((share - (seen.len() - 1) as f64 / seen.len() as f64).abs() < 1e-12, "{share}");
    let best = judged.log_likelihood(&truth);
    for (x, y, yaw) in [(0.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 0.03), (3.0, 2.0, 1.0)] {
        assert!(judged.log_likelihood(&(truth * Se2::new(x, y, yaw))) < best - 1.0);
    }
    // A false reading alone tells no pose from another, but for those that it could be true of.
    let floor = judged.log_likelihood(&Se2::new(1e6, 0.0, 0.0));
    assert!(floor.is_finite() && floor < best);
}

#[test]
fn readings_that_cannot_be_compared_are_left_out() {
    let mut model = model(vec![(1, Vector2::new(4.0, 0.0))]);
    let nothing = Err(SkipReason::TooFewReadings { usable: 0, needed: 1 });
    let unknown = seen(Some(9), 4.0, 0.0, (0.1, 0.1));
    assert_eq!(SensorModel::<[LandmarkObservation]>::condition(&mut model, &[]).map(|_| ()), nothing);
    assert_eq!(model.condition(&unknown).map(|_| ()), nothing);
    let known = seen(Some(1), 4.0, 0.0, (0.1, 0.1));
    let alone = model.condition(&known).unwrap().log_likelihood(&Se2::default());
    let both = [known, unknown];
    assert_eq!(model.condition(both.as_slice()).unwrap().log_likelihood(&Se2::default()), alone);
}

/// Deviations of zero, an enormous one (a bearing without a range), a landmark at the sensor: finite, and no more than the
/// exact fit.
#[test]
fn extreme_readings_and_poses_stay_finite() {
    let mut model = model(vec![(1, Vector2::new(4.0, 0.0)), (2, Vector2::new(0.0, 0.0))]);
    for id in [None, Some(1)] {
        for (range, sigmas) in
            [(4.0, (0.0, 0.0)), (4.0, (1e9, 0.01)), (0.0, (0.1, 0.1)), (1e12, (0.1, 0.1)), (4.0, (0.1, 1e9))]
        {
            let seen = seen(id, range, 0.0, sigmas);
            let judged = model.condition(&seen).unwrap();
            for pose in [
                Se2::default(),
                Se2::new(4.0, 0.0, 0.0),
                Se2::new(1e300, 0.0, 0.0),
                Se2::new(-1e200, 1e200, 1.0),
                Se2::new(f64::NAN, 0.0, 0.0),
            ] {
                let l = judged.log_likelihood(&pose);
                assert!(l.is_finite() && l < 1.0, "{id:?} {range} {sigmas:?} {pose:?}: {l}");
            }
        }
    }
    // The bearing alone still tells left from right.
    let bearing = seen(Some(1), 1.0, 0.0, (1e3, 0.01));
    let judged = model.condition(&bearing).unwrap();
    assert!(judged.log_likelihood(&Se2::new(-9.0, 0.0, 0.0)) > judged.log_likelihood(&Se2::new(-9.0, 0.0, 0.5)) + 1.0);
}

#[test]
fn bad_parameters_are_named() {
    let good = LandmarkModelParams::default();
    let one = || [(1, Vector2::new(4.0, 0.0))];
    for (name, bad) in [
        ("position_sigma", LandmarkModelParams { position_sigma: 0.0, ..good }),
        ("outlier", LandmarkModelParams { outlier: 0.0, ..good }),
        ("outlier", LandmarkModelParams { outlier: 1.0, ..good }),
        ("range_max", LandmarkModelParams { range_max: f64::INFINITY, ..good }),
    ] {
        let error = LandmarkModel::new(one(), bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{error}");
    }
    assert_eq!(LandmarkModel::new([], good).map(|_| ()), Err(Error::Empty { name: "landmarks" }));
    assert!(LandmarkModel::new([(1, Vector2::new(f64::NAN, 0.0))], good).is_err());
}
