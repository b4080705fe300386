use super::*;
use crate::kalman::{Landmark, LinearMeasurement, PlanarPose, Unicycle, UnicycleParams};
use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, Twist2},
    metrics::chi_square_quantile,
};
use nalgebra::{Matrix1, Matrix2, Matrix3, RowVector2, RowVector3, SVector, Vector1, Vector2, Vector3};
use proptest::prelude::*;
use rand_distr::{Distribution, StandardNormal};

/// Stays where it is.
struct Rest<const N: usize>(SMatrix<f64, N, N>);

impl<const N: usize> ProcessModel<SVector<f64, N>, N> for Rest<N> {
    type Control = ();

    fn transition(&self, state: &SVector<f64, N>, (): &(), _: f64) -> SVector<f64, N> {
        *state
    }

    fn jacobian(&self, _: &SVector<f64, N>, (): &(), _: f64) -> SMatrix<f64, N, N> {
        SMatrix::identity()
    }

    fn noise(&self, _: &SVector<f64, N>, (): &(), _: f64) -> SMatrix<f64, N, N> {
        self.0
    }
}

fn covariance(entries: &[f64], floor: f64) -> Matrix3<f64> {
    let root = Matrix3::from_row_slice(entries);
    root * root.transpose() + Matrix3::identity() * floor
}

proptest! {
    /// The posterior's information is the sum of the prior's and the reading's, whatever the order of the readings.
    #[test]
    fn information_adds_up(entries in prop::array::uniform9(-1.0..1.0_f64), rows in prop::array::uniform6(-1.0..1.0_f64), read in -2.0..2.0_f64) {
        let prior = covariance(&entries, 0.1);
        let h = SMatrix::<f64, 2, 3>::from_row_slice(&rows);
        let r = Matrix2::new(0.3, 0.1, 0.1, 0.2);
        let model = LinearMeasurement::new(h, r).unwrap();
        let mut ekf = Ekf::new(Vector3::new(0.5, -0.2, 0.1), prior).unwrap();
        let reading = Vector2::new(read, 0.3);
        ekf.update(&model, &reading, &Gate::OPEN).unwrap();
        let information = prior.try_inverse().unwrap() + h.transpose() * r.try_inverse().unwrap() * h;
        let posterior = information.try_inverse().unwrap();
        prop_assert!((ekf.covariance() - posterior).amax() < 1e-10);
        let mean = posterior * (prior.try_inverse().unwrap() * Vector3::new(0.5, -0.2, 0.1) + h.transpose() * r.try_inverse().unwrap() * reading);
        prop_assert!((ekf.state() - mean).amax() < 1e-9);
    }

    /// Readings millions of times as precise as the belief, in directions that hardly differ, leave a covariance.
    #[test]
    fn covariances_stay_so_after_readings_of_any_precision(
        entries in prop::array::uniform9(-1.0..1.0_f64), exponent in -4.0..3.0_f64, tilt in 1e-4..1.0_f64,
    ) {
        let mut ekf = Ekf::new(Vector3::zeros(), covariance(&entries, 1e-6) * 10_f64.powf(3.0)).unwrap();
        let noise = Matrix1::new(10_f64.powf(2.0 * exponent));
        let rows = [RowVector3::new(1.0, 0.5, -0.3), RowVector3::new(1.0, 0.5 + tilt, -0.3), RowVector3::new(1.0, 0.5, tilt - 0.3)];
        for cycle in 0..30 {
            let model = LinearMeasurement::new(rows[cycle % 3], noise).unwrap();
            ekf.update(&model, &Vector1::new(0.1), &Gate::OPEN).unwrap();
            let spread = ekf.covariance();
            prop_assert_eq!(*spread, spread.transpose());
            prop_assert!(check::covariance("covariance", spread).is_ok(), "{}", spread);
        }
    }
}

/// A scalar random walk of variance q read with variance r settles at `P = q/2 (√(1 + 4 r/q) - 1)`, the positive root of
/// `P² + q P - q r = 0` after the update.
#[test]
fn a_random_walk_settles_at_its_riccati_value() {
    let (q, r) = (0.001, 0.0625);
    let mut ekf = Ekf::new(Vector1::new(0.0), Matrix1::new(1.0)).unwrap();
    let model = LinearMeasurement::new(Matrix1::new(1.0), Matrix1::new(r)).unwrap();
    for _ in 0..1000 {
        ekf.predict(&Rest(Matrix1::new(q)), &(), 0.1).unwrap();
        ekf.update(&model, &Vector1::new(0.0), &Gate::OPEN).unwrap();
    }
    let settled = 0.5 * q * ((1.0 + 4.0 * r / q).sqrt() - 1.0);
    assert!((ekf.covariance()[(0, 0)] / settled - 1.0).abs() < 1e-12);
}

fn draw<const N: usize>(sigmas: &SVector<f64, N>, stream: &mut Stream) -> SVector<f64, N> {
    SVector::<f64, N>::from_fn(|_, _| StandardNormal.sample(stream)).component_mul(sigmas)
}

/// Runs of a filter over its own model: NEES and NIS, summed. Independent χ² draws of `k` degrees sum to one of `k n`; the
/// errors at the ends of different runs are independent, and so are the innovations of a consistent filter. A landmark's
/// bearing is not linear, hence the little noise.
fn consistency<X: PlanarStateOf>(runs: u64) -> (f64, f64, usize)
where
    Unicycle: ProcessModel<X, 3, Control = Twist2>,
{
    let sigmas = Vector2::new(0.02, 0.01);
    let landmarks =
        [(4.0, 1.0), (-2.0, 5.0), (1.0, -4.0)].map(|(x, y)| Landmark::new(Vector2::new(x, y), &sigmas).unwrap());
    let drive = Unicycle::new(UnicycleParams {
        forward_density: 0.02,
        left_density: 0.01,
        yaw_density: 0.02,
        ..Default::default()
    })
    .unwrap();
    let (mut nees, mut nis, mut readings) = (0.0, 0.0, 0);
    for run in 0..runs {
        let mut stream = Seed(run).stream(0, 0);
        let start = X::at(0.5, 0.2, 3.0);
        let mut ekf = Ekf::new(start, Matrix3::identity() * 4e-4).unwrap();
        let mut truth = start.boxplus(&draw(&Vector3::repeat(0.02), &mut stream));
        for step in 0..60_usize {
            let twist = Twist2::new(0.5, 0.0, 0.8);
            ekf.predict(&drive, &twist, 0.1).unwrap();
            truth = drive.sample(&truth, &twist, 0.1, &mut stream);
            let landmark = &landmarks[step % 3];
            let reading = landmark.predict(&truth) + draw(&sigmas, &mut stream);
            let seen = ekf.update(landmark, &reading, &Gate::OPEN).unwrap();
            nis += seen.innovation.nis;
            readings += seen.innovation.degrees;
        }
        nees += ekf.belief().nees(&truth).unwrap();
    }
    (nees, nis, readings)
}

/// The states that the consistency is shown for.
trait PlanarStateOf: crate::kalman::PlanarState<3> {
    fn at(x: f64, y: f64, yaw: f64) -> Self;
}

impl PlanarStateOf for PlanarPose {
    fn at(x: f64, y: f64, yaw: f64) -> Self {
        Self::from(Vector3::new(x, y, yaw))
    }
}

impl PlanarStateOf for Se2 {
    fn at(x: f64, y: f64, yaw: f64) -> Self {
        Self::new(x, y, yaw)
    }
}

#[test]
fn errors_and_innovations_are_as_large_as_stated() {
    let runs = 200;
    for (name, (nees, nis, readings)) in
        [("map axes", consistency::<PlanarPose>(runs)), ("base axes", consistency::<Se2>(runs))]
    {
        let bounds = |degrees: f64| [1e-4, 1.0 - 1e-4].map(|p| chi_square_quantile(degrees, p).unwrap());
        let [low, high] = bounds(3.0 * runs as f64);
        assert!(nees > low && nees < high, "{name}: NEES {nees} not in {low}..{high}");
        let [low, high] = bounds(readings as f64);
        assert!(nis > low && nis < high, "{name}: NIS {nis} not in {low}..{high}");
    }
}

/// With readings of the pose itself, and a heading on the cut.
#[test]
fn headings_are_corrected_across_the_cut() {
    let landmark = Landmark::new(Vector2::new(-5.0, 0.0), &Vector2::new(0.01, 0.01)).unwrap();
    let truth = PlanarPose::from(Vector3::new(0.0, 0.0, -3.13));
    let mut ekf = Ekf::new(
        PlanarPose::from(Vector3::new(0.0, 0.0, 3.13)),
        Matrix3::from_diagonal(&Vector3::new(1e-6, 1e-6, 0.1)),
    )
    .unwrap();
    let seen = ekf.update(&landmark, &landmark.predict(&truth), &Gate::at_probability(0.99).unwrap()).unwrap();
    assert!(seen.accepted && (ekf.state()[2] + 3.13).abs() < 1e-4, "{:?}", ekf.state());
}

#[test]
fn outliers_are_reported_and_change_nothing() {
    let model = LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(0.03)).unwrap();
    let mut ekf = Ekf::new(Vector2::new(1.0, 2.0), Matrix2::identity() * 0.01).unwrap();
    let before = ekf;
    let gate = Gate::at_probability(0.99).unwrap();
    let seen = ekf.update(&model, &Vector1::new(2.0), &gate).unwrap();
    assert!(!seen.accepted && ekf == before);
    assert!((seen.innovation.nis - 25.0).abs() < 1e-12 && seen.limit == gate.limit(1));
    assert_eq!(seen.innovation, ekf.innovation(&model, &Vector1::new(2.0)).unwrap());
    // The density of a scalar, 1 from a mean with the variance 0.04.
    let density = -0.5 * (25.0 + (0.04 * std::f64::consts::TAU).ln());
    assert!((seen.innovation.log_likelihood() - density).abs() < 1e-12);
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let unit = Matrix2::identity();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(matches!(Ekf::new(Vector2::new(0.0, bad), unit), Err(Error::NotFinite { .. })));
        assert!(Ekf::new(Vector2::zeros(), unit * bad).is_err());
        assert!(LinearMeasurement::new(RowVector2::new(bad, 0.0), Matrix1::new(1.0)).is_err());
        assert!(LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(bad)).is_err());
    }
    assert!(Ekf::new(Vector2::zeros(), -unit).is_err());
    assert!(Ekf::new(Vector2::zeros(), Matrix2::new(1.0, 0.5, 0.0, 1.0)).is_err());

    let mut ekf = Ekf::new(Vector2::zeros(), Matrix2::from_diagonal(&Vector2::new(1.0, 0.0))).unwrap();
    let before = ekf;
    for bad in [f64::NAN, f64::INFINITY, -0.1] {
        assert!(matches!(ekf.predict(&Rest(unit), &(), bad), Err(Error::Negative { name: "dt", .. })));
    }
    for noise in [-unit * 2.0, unit * f64::NAN, unit * f64::INFINITY] {
        assert!(ekf.predict(&Rest(noise), &(), 0.1).is_err());
    }
    let model = LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(1.0)).unwrap();
    for bad in [f64::NAN, f64::INFINITY, 1e200] {
        assert!(matches!(ekf.update(&model, &Vector1::new(bad), &Gate::OPEN), Err(Error::NotFinite { .. })), "{bad}");
        assert!(ekf.innovation(&model, &Vector1::new(bad)).is_err());
    }
    // What is known exactly is read exactly: there is nothing to weigh by.
    let exact = LinearMeasurement::new(RowVector2::new(0.0, 1.0), Matrix1::new(0.0)).unwrap();
    assert!(matches!(ekf.update(&exact, &Vector1::new(1.0), &Gate::OPEN), Err(Error::NotCovariance { .. })));
    assert_eq!(ekf, before);

    // On top of a landmark there is no bearing.
    let landmark = Landmark::new(Vector2::zeros(), &Vector2::new(0.1, 0.1)).unwrap();
    let mut pose = Ekf::new(Se2::default(), Matrix3::identity()).unwrap();
    assert!(pose.update(&landmark, &Vector2::new(0.1, 0.0), &Gate::OPEN).is_err());
    let drive = Unicycle::new(UnicycleParams::default()).unwrap();
    for twist in
        [Twist2::new(f64::NAN, 0.0, 0.0), Twist2::new(0.0, f64::INFINITY, 0.0), Twist2::new(0.0, 0.0, f64::NAN)]
    {
        assert!(pose.predict(&drive, &twist, 0.1).is_err());
        let mut planar = Ekf::new(PlanarPose::from(Vector3::zeros()), Matrix3::identity()).unwrap();
        assert!(planar.predict(&drive, &twist, 0.1).is_err());
        assert_eq!(planar.state().vector(), &Vector3::zeros());
    }
    assert_eq!(pose.state(), &Se2::identity());
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_filter_continues_with_the_same_bits_and_is_checked() {
    let mut ekf = Ekf::new(Se2::new(1.0, 2.0, 0.3), covariance(&[0.3; 9], 0.1)).unwrap();
    let text = serde_json::to_string(&ekf).unwrap();
    let mut loaded: Ekf<Se2, 3> = serde_json::from_str(&text).unwrap();
    let drive = Unicycle::new(UnicycleParams::default()).unwrap();
    for filter in [&mut ekf, &mut loaded] {
        filter.predict(&drive, &Twist2::new(1.0, 0.0, 0.5), 0.1).unwrap();
    }
    assert_eq!(ekf, loaded);
    let bad = text.replace("0.37", "-0.37");
    assert!(bad != text && serde_json::from_str::<Ekf<Se2, 3>>(&bad).is_err(), "{text}");
}
