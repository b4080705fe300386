use super::*;
use crate::kalman::{Ekf, Landmark, LinearMeasurement, LinearProcess, PlanarPose, Unicycle, UnicycleParams};
use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    metrics::chi_square_quantile,
};
use nalgebra::{Matrix1, Matrix2, Matrix3, Vector1, Vector2, Vector3};
use proptest::prelude::*;
use rand_distr::{Distribution, StandardNormal};

proptest! {
    /// Of linear models sigma points and Jacobians know the same.
    #[test]
    fn linear_models_are_kalmans(entries in prop::array::uniform9(-1.0..1.0_f64), read in -2.0..2.0_f64, kappa in 0.0..3.0_f64) {
        let f = Matrix3::from_row_slice(&entries);
        let spread = f * f.transpose() + Matrix3::identity() * 0.1;
        let process = LinearProcess::new(f, Vector3::new(0.0, 1.0, 0.5), spread * 0.1).unwrap();
        let model = LinearMeasurement::new(f.fixed_rows::<2>(1).into_owned(), Matrix2::new(0.3, 0.1, 0.1, 0.2)).unwrap();
        let start = Vector3::new(0.3, -0.2, 1.0);
        let mut ekf = Ekf::new(start, spread).unwrap();
        let mut ukf = Ukf::new(start, spread, &UkfParams { kappa, ..Default::default() }).unwrap();
        for _ in 0..3 {
            ekf.predict(&process, &Vector1::new(0.4), 0.1).unwrap();
            ukf.predict(&process, &Vector1::new(0.4), 0.1).unwrap();
            let a = ekf.update(&model, &Vector2::new(read, 0.1), &Gate::OPEN).unwrap();
            let b = ukf.update(&model, &Vector2::new(read, 0.1), &Gate::OPEN).unwrap();
            prop_assert!((a.innovation.nis - b.innovation.nis).abs() < 1e-8 * (1.0 + a.innovation.nis));
            prop_assert!((ekf.state() - ukf.state()).amax() < 1e-9);
            prop_assert!((ekf.covariance() - ukf.covariance()).amax() < 1e-9);
            prop_assert_eq!(*ukf.covariance(), ukf.covariance().transpose());
        }
    }
}

/// `x²` of a standard normal has the mean 1 and the variance 2, which the points of `κ = 2` find and a Jacobian does not.
#[test]
fn squares_have_the_moments_that_they_have() {
    struct Square;
    impl ProcessModel<Vector1<f64>, 1> for Square {
        type Control = ();
        fn transition(&self, x: &Vector1<f64>, (): &(), _: f64) -> Vector1<f64> {
            x.component_mul(x)
        }
        fn jacobian(&self, x: &Vector1<f64>, (): &(), _: f64) -> Matrix1<f64> {
            2.0 * x
        }
        fn noise(&self, _: &Vector1<f64>, (): &(), _: f64) -> Matrix1<f64> {
            Matrix1::zeros()
        }
    }
    let params = UkfParams { alpha: 1.0, beta: 0.0, kappa: 2.0 };
    let mut ukf = Ukf::new(Vector1::zeros(), Matrix1::new(1.0), &params).unwrap();
    ukf.predict(&Square, &(), 0.1).unwrap();
    assert!((ukf.state()[0] - 1.0).abs() < 1e-12 && (ukf.covariance()[(0, 0)] - 2.0).abs() < 1e-12);
}

/// Headings that are spread around the cut, in map axes and as poses.
#[test]
fn means_are_taken_on_the_circle() {
    let drive = Unicycle::new(UnicycleParams::default()).unwrap();
    let spread = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 0.09));
    let twist = Twist2::new(1.0, 0.0, 0.0);
    let mut on_map = Ukf::new(PlanarPose::from(Vector3::new(0.0, 0.0, 3.1)), spread, &UkfParams::default()).unwrap();
    let mut on_base = Ukf::new(Se2::new(0.0, 0.0, 3.1), spread, &UkfParams::default()).unwrap();
    on_map.predict(&drive, &twist, 1.0).unwrap();
    on_base.predict(&drive, &twist, 1.0).unwrap();
    assert!((on_map.state()[2] - 3.1).abs() < 1e-12 && (on_base.state().yaw() - 3.1).abs() < 1e-12);
    // E cos of a normal angle is exp(-σ²/2): the position in map axes falls short by that.
    assert!((on_map.state()[0] - 3.1_f64.cos() * (-0.045_f64).exp()).abs() < 1e-4);
    let beacon = Landmark::new(Vector2::new(-5.0, 0.0), &Vector2::new(0.01, 0.01)).unwrap();
    let truth = PlanarPose::from(Vector3::new(-1.0, 0.0, -3.0));
    on_map.update(&beacon, &beacon.predict(&truth), &Gate::OPEN).unwrap();
    assert!(on_map.state().boxminus(&truth)[2].abs() < 0.05, "{:?}", on_map.state());
}

/// NEES at the ends of 200 runs of the filter's own model, with a bent measurement.
#[test]
fn errors_are_as_large_as_stated() {
    let sigmas = Vector2::new(0.05, 0.02);
    let drive =
        Unicycle::new(UnicycleParams { forward_density: 0.05, yaw_density: 0.05, ..Default::default() }).unwrap();
    let beacon = Landmark::new(Vector2::new(3.0, 1.0), &sigmas).unwrap();
    let (mut nees, runs) = (0.0, 200);
    for run in 0..runs {
        let mut stream = Seed(run).stream(0, 0);
        let start = PlanarPose::from(Vector3::new(0.5, 0.2, 3.0));
        let mut ukf = Ukf::new(start, Matrix3::identity() * 2.5e-3, &UkfParams::default()).unwrap();
        let mut draw =
            |sigma: f64| -> f64 { sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut stream) };
        let mut truth = start.boxplus(&Vector3::from_fn(|_, _| draw(0.05)));
        for step in 0..40 {
            let twist = Twist2::new(0.5, 0.0, 0.8);
            ukf.predict(&drive, &twist, 0.1).unwrap();
            let mut other = Seed(run).stream(1, step);
            truth = drive.sample(&truth, &twist, 0.1, &mut other);
            let reading = beacon.predict(&truth) + Vector2::new(draw(sigmas.x), draw(sigmas.y));
            ukf.update(&beacon, &reading, &Gate::OPEN).unwrap();
        }
        nees += ukf.belief().nees(&truth).unwrap();
    }
    let [low, high] = [1e-4, 1.0 - 1e-4].map(|p| chi_square_quantile(3.0 * runs as f64, p).unwrap());
    assert!(nees > low && nees < high, "NEES {nees} not in {low}..{high}");
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let unit = Matrix3::identity();
    let start = PlanarPose::from(Vector3::zeros());
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(Ukf::new(start, unit, &UkfParams { alpha: bad, ..Default::default() }).is_err(), "{bad}");
    }
    for bad in [-3.0, f64::NAN, f64::INFINITY] {
        assert!(Ukf::new(start, unit, &UkfParams { kappa: bad, ..Default::default() }).is_err(), "{bad}");
    }
    assert!(Ukf::new(start, unit, &UkfParams { beta: f64::NAN, ..Default::default() }).is_err());
    assert!(Ukf::new(start, -unit, &UkfParams::default()).is_err());

    let mut ukf = Ukf::new(start, unit * 0.01, &UkfParams::default()).unwrap();
    let (before, drive) = (ukf, Unicycle::new(UnicycleParams::default()).unwrap());
    let beacon = Landmark::new(Vector2::new(3.0, 1.0), &Vector2::new(0.1, 0.1)).unwrap();
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(ukf.predict(&drive, &Twist2::new(bad, 0.0, 0.0), 0.1).is_err());
        assert!(ukf.predict(&drive, &Twist2::ZERO, bad).is_err());
        assert!(ukf.update(&beacon, &Vector2::new(bad, 0.0), &Gate::OPEN).is_err());
    }
    assert!(ukf.predict(&drive, &Twist2::ZERO, -0.1).is_err());
    let stray = ukf.update(&beacon, &Vector2::new(30.0, 0.0), &Gate::at_probability(0.999).unwrap()).unwrap();
    assert!(!stray.accepted && stray.innovation.nis > stray.limit);
    assert_eq!(ukf, before);
}
