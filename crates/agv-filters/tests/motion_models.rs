//! Every motion model: its draws have the mean and the covariance that it states, and nothing is drawn of no motion.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2},
    odometry::OdometryIncrement,
    time::Stamp,
};
use agv_filters::particle::{
    AckermannOdometryModel, AckermannOdometryParams, DifferentialOdometryModel, MotionModel, OdometryNoise,
    OmnidirectionalNoise, OmnidirectionalOdometryModel, PriorMotionModel, PriorNoise, VelocityModel, VelocityNoise,
};
use nalgebra::{Matrix3, Vector3};

fn motion(start_from_end: Se2) -> OdometryIncrement {
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &start_from_end).unwrap()
}

/// Ahead, backwards, in a bend, and a turn on the spot.
fn motions() -> [Se2; 5] {
    [
        Twist2::new(0.5, 0.0, 0.0).integrate(1.0),
        Twist2::new(-0.4, 0.0, 0.1).integrate(1.0),
        Twist2::new(0.4, 0.0, 0.15).integrate(1.0),
        Se2::new(0.2, 0.3, 0.7),
        Se2::new(0.0, 0.0, 0.5),
    ]
}

/// Compares drawn moments with the stated ones, where the noise is small enough for first order.
fn draws_have_the_stated_moments(
    name: &str,
    model: &impl MotionModel<Motion = OdometryIncrement>,
    spread: Matrix3<f64>,
) {
    let draws = 20_000;
    let n = f64::from(draws);
    for (key, start_from_end) in motions().into_iter().enumerate() {
        let motion = OdometryIncrement { covariance: spread, ..motion(start_from_end) };
        let expected = model.covariance(&motion);
        assert!((expected - expected.transpose()).norm() == 0.0, "{name}: not symmetric");
        let sample = model.condition(&motion);
        let start = Se2::new(3.0, -1.0, 2.0);
        let mut stream = Seed(11).stream(key as u64, 0);
        let errors: Vec<Vector3<f64>> =
            (0..draws).map(|_| sample(&start, &mut stream).minus(&(start * start_from_end))).collect();
        let mean = errors.iter().sum::<Vector3<f64>>() / n;
        let covariance = errors.iter().map(|e| (e - mean) * (e - mean).transpose()).sum::<Matrix3<f64>>() / n;
        for i in 0..3 {
            // Five standard errors of a mean, and the second order of a turn: the mean of a cosine.
            let second_order = expected[(2, 2)] * (0.5 + start_from_end.translation().norm());
            let bound = 5.0 * (expected[(i, i)] / n).sqrt() + second_order + 1e-12;
            assert!(mean[i].abs() < bound, "{name}, {start_from_end:?}: mean {i} {} > {bound}", mean[i]);
            for j in 0..=i {
                // Variance of a sample covariance of Gaussians: (Σii Σjj + Σij²) / n.
                let variance = (expected[(i, i)] * expected[(j, j)] + expected[(i, j)].powi(2)) / n;
                let bound = 5.0 * variance.sqrt() + 0.02 * (expected[(i, i)] * expected[(j, j)]).sqrt() + 1e-7;
                let error = (covariance[(i, j)] - expected[(i, j)]).abs();
                assert!(error < bound, "{name}, {start_from_end:?}: covariance {i}{j} off by {error} > {bound}");
            }
        }
    }
}

#[test]
fn draws_have_the_stated_moments_of_every_model() {
    let noise = OmnidirectionalNoise {
        turn_per_turn: 4e-4,
        turn_per_run: 1e-3,
        run_per_run: 2e-3,
        run_per_turn: 1e-4,
        strafe_per_run: 5e-4,
    };
    draws_have_the_stated_moments(
        "omnidirectional",
        &OmnidirectionalOdometryModel::new(noise).unwrap(),
        Matrix3::zeros(),
    );
    let noise = VelocityNoise {
        run_per_run: 2e-3,
        run_per_turn: 1e-4,
        turn_per_run: 1e-3,
        turn_per_turn: 4e-4,
        last_turn_per_run: 3e-4,
        last_turn_per_turn: 2e-4,
    };
    draws_have_the_stated_moments("velocity", &VelocityModel::new(noise).unwrap(), Matrix3::zeros());
    let params = AckermannOdometryParams {
        steering_sigma: 0.03,
        run_per_run: 2e-3,
        slip_per_run: 1e-4,
        turn_per_turn: 4e-4,
        ..Default::default()
    };
    draws_have_the_stated_moments("Ackermann", &AckermannOdometryModel::new(params).unwrap(), Matrix3::zeros());
    let root = Matrix3::new(0.02, 0.0, 0.0, 0.01, 0.015, 0.0, -0.01, 0.005, 0.02);
    let spread = root * root.transpose();
    for inflation in [1.0, 2.0] {
        let model = PriorMotionModel::new(PriorNoise { inflation, ..Default::default() }).unwrap();
        draws_have_the_stated_moments("prior", &model, spread);
    }
    // A stated covariance that is singular: the heading is known exactly.
    let flat = Matrix3::from_diagonal(&Vector3::new(1e-4, 4e-4, 0.0));
    let exact = PriorNoise { inflation: 1.0, position_per_run: 0.0, turn_per_run: 0.0, turn_per_turn: 0.0 };
    draws_have_the_stated_moments("prior, singular", &PriorMotionModel::new(exact).unwrap(), flat);
}

/// Without noise every model moves the particle exactly as the odometry says, in whatever direction; and a vehicle that
/// stands stays.
#[test]
fn noiseless_models_compose() {
    fn check(model: &impl MotionModel<Motion = OdometryIncrement>) {
        let start = Se2::new(3.0, -2.0, -2.4);
        for start_from_end in motions() {
            let motion = motion(start_from_end);
            let end = model.condition(&motion)(&start, &mut Seed(0).stream(0, 0));
            assert!(end.minus(&(start * start_from_end)).norm() < 1e-12, "{start_from_end:?}");
            assert_eq!(model.covariance(&motion), Matrix3::zeros());
        }
    }
    fn rests(model: &impl MotionModel<Motion = OdometryIncrement>) {
        let start = Se2::new(3.0, -2.0, -2.4);
        let end = model.condition(&motion(Se2::identity()))(&start, &mut Seed(0).stream(0, 0));
        assert!(end.minus(&start).norm() < 1e-12);
    }
    check(&OmnidirectionalOdometryModel::new(OmnidirectionalNoise::uniform(0.0)).unwrap());
    check(&VelocityModel::new(VelocityNoise::uniform(0.0)).unwrap());
    let still = AckermannOdometryParams {
        steering_sigma: 0.0,
        run_per_run: 0.0,
        slip_per_run: 0.0,
        turn_per_turn: 0.0,
        ..Default::default()
    };
    check(&AckermannOdometryModel::new(still).unwrap());
    let exact = PriorNoise { inflation: 1.0, position_per_run: 0.0, turn_per_run: 0.0, turn_per_turn: 0.0 };
    check(&PriorMotionModel::new(exact).unwrap());
    rests(&DifferentialOdometryModel::new(OdometryNoise::default()).unwrap());
    rests(&OmnidirectionalOdometryModel::new(OmnidirectionalNoise::default()).unwrap());
    rests(&VelocityModel::new(VelocityNoise::default()).unwrap());
    rests(&AckermannOdometryModel::new(AckermannOdometryParams::default()).unwrap());
    rests(&PriorMotionModel::new(PriorNoise::default()).unwrap());
}

/// The covariance turns with the direction of the run.
#[test]
fn an_omnidirectional_vehicle_errs_alike_in_all_directions_but_along_and_across() {
    let noise = OmnidirectionalNoise { strafe_per_run: 0.01, ..OmnidirectionalNoise::default() };
    let model = OmnidirectionalOdometryModel::new(noise).unwrap();
    let ahead = model.covariance(&motion(Se2::new(0.4, 0.0, 0.1)));
    for angle in [0.3, 1.5, 3.0, -2.0_f64] {
        let turned = model.covariance(&motion(Se2::new(0.4 * angle.cos(), 0.4 * angle.sin(), 0.1)));
        let (sin, cos) = angle.sin_cos();
        let rotate = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        assert!((rotate * ahead * rotate.transpose() - turned).norm() < 1e-12);
    }
}
