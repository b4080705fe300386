use super::*;
use agv_core::{
    compute::{Seed, Stream},
    geometry::{Twist2, wrap_angle},
    roles::{SkipReason, laws},
    sensors::SensorId,
};
use rand_distr::{Distribution, StandardNormal};

const DT: f64 = 0.02;

fn measured_noise() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 0.5_f64.to_radians().powi(2)))
}

fn draw(covariance: &Matrix3<f64>, stream: &mut Stream) -> Vector3<f64> {
    let root = covariance.map(f64::sqrt); // of diagonal ones
    root * Vector3::from_fn(|_, _| StandardNormal.sample(stream))
}

/// A drive whose truth is drawn from the filter's own model: odometry, true pose and measured pose of each cycle.
struct Drive {
    stream: Stream,
    truth: Se2,
    odom: Se2,
    now: Stamp,
    scale: f64,
    params: PoseFilterParams,
}

impl Drive {
    fn new(seed: u64, params: PoseFilterParams) -> Self {
        let mut stream = Seed(seed).stream(0, 0);
        let unit: f64 = StandardNormal.sample(&mut stream);
        let start = Se2::new(2.0, -1.0, 0.7);
        Self {
            stream,
            truth: start,
            odom: Se2::default(),
            now: Stamp::default(),
            scale: unit * params.yaw_scale_sigma,
            params,
        }
    }

    fn step(&mut self, twist: &Twist2) -> (OdometryIncrement, PoseObservation<Se2>) {
        let read = twist.integrate(DT).log();
        let (p, driven, turned) = (&self.params, read.x.hypot(read.y), read.z.abs());
        let position = p.position_variance_per_metre * driven;
        let yaw = p.yaw_variance_per_metre * driven + p.yaw_variance_per_radian * turned;
        let noise = Matrix3::from_diagonal(&Vector3::new(position, position, yaw));
        let moved = Se2::exp(&Vector3::new(read.x, read.y, read.z * (1.0 + self.scale)));
        self.truth = self.truth * moved.plus(&draw(&noise, &mut self.stream));
        let walk: f64 = StandardNormal.sample(&mut self.stream);
        self.scale += walk * (p.yaw_scale_walk * turned).sqrt();
        let odom = self.odom * twist.integrate(DT);
        let motion = OdometryIncrement::between(self.now, &self.odom, self.now + DT, &odom).unwrap();
        (self.odom, self.now) = (odom, self.now + DT);
        let seen = self.truth.plus(&draw(&measured_noise(), &mut self.stream));
        (motion, PoseObservation::new(self.now, UncertainPose::new(seen, measured_noise()).unwrap()))
    }
}

/// Figures of eight, sideways as well.
fn twist_at(cycle: usize) -> Twist2 {
    let t = cycle as f64 * DT;
    Twist2::new(1.0, 0.1 * (0.7 * t).sin(), 1.6 * (0.9 * t).cos())
}

fn started(params: PoseFilterParams, seed: u64) -> (PoseFilter, Drive) {
    let (mut filter, mut drive) = (PoseFilter::new(params).unwrap(), Drive::new(seed, params));
    let start = drive.truth.plus(&draw(&measured_noise(), &mut drive.stream));
    filter.initialize(&PoseBelief::around(start, measured_noise()).unwrap()).unwrap();
    (filter, drive)
}

/// Normalised estimation error squared of pose and scale, and innovation squared, over 200 runs of the filter's own model.
///
/// The sum of `n` independent χ² draws of `k` degrees has the deviation √(2 k n); errors at the ends of different runs are
/// independent, and so are all innovations of a filter that is consistent. Bounds of 4.5 deviations.
#[test]
fn errors_are_as_large_as_the_covariance_says() {
    let params = PoseFilterParams { gate: f64::INFINITY, ..PoseFilterParams::default() };
    let (runs, cycles) = (200_u32, 250_u32);
    let (mut nees, mut nis) = (0.0, 0.0);
    for seed in 0..u64::from(runs) {
        let (mut filter, mut drive) = started(params, seed);
        for cycle in 0..cycles {
            let (motion, seen) = drive.step(&twist_at(cycle as usize));
            filter.predict(&motion).unwrap();
            let UpdateOutcome::Applied(report) = filter.update(&seen).unwrap() else { panic!("gated") };
            nis += report.nis.unwrap();
        }
        let truth = AugmentedPose { map_from_base: drive.truth, extra: Vector1::new(drive.scale) };
        nees += filter.ekf.unwrap().belief().nees(&truth).unwrap();
    }
    for (sum, degrees, count) in [(nees, 4.0, f64::from(runs)), (nis, 3.0, f64::from(runs * cycles))] {
        let deviation = (2.0 * degrees * count).sqrt();
        assert!((sum - degrees * count).abs() < 4.5 * deviation, "{} of {degrees}", sum / count);
    }
}

/// 1 cm of white noise becomes about 2 mm, and a lost 3 % of every turn is found.
#[test]
fn noise_is_smoothed_and_the_scale_found() {
    let (mut filter, mut drive) = started(PoseFilterParams::default(), 7);
    drive.scale = -0.03;
    drive.params.yaw_scale_walk = 0.0;
    let (mut square, mut count) = (0.0, 0.0);
    for cycle in 0..1500 {
        let (motion, seen) = drive.step(&twist_at(cycle));
        filter.predict(&motion).unwrap();
        filter.update(&seen).unwrap();
        if cycle >= 250 {
            square +=
                (filter.estimate().unwrap().map_from_base().translation() - drive.truth.translation()).norm_squared();
            count += 1.0;
        }
    }
    let rmse = f64::sqrt(square / count);
    assert!(rmse < 0.004, "{rmse}");
    let (scale, sigma) = filter.yaw_scale().unwrap();
    assert!((scale + 0.03).abs() < 4.0 * sigma && sigma < 0.01, "{scale} {sigma}");
    assert_eq!(filter.status(), LocalizationStatus::Tracking);
}

/// Straight on the scale cannot be seen, and known odometry has none to be seen.
#[test]
fn the_scale_is_learnt_in_turns_alone() {
    let sigma_after = |params, twist: Twist2| {
        let (mut filter, mut drive) = started(params, 3);
        for _ in 0..200 {
            let (motion, seen) = drive.step(&twist);
            filter.predict(&motion).unwrap();
            filter.update(&seen).unwrap();
        }
        filter.yaw_scale().unwrap()
    };
    let params = PoseFilterParams::default();
    let (straight, turning) = (Twist2::new(1.0, 0.0, 0.0), Twist2::new(1.0, 0.0, 1.0));
    assert!((sigma_after(params, straight).1 - params.yaw_scale_sigma).abs() < 1e-12);
    assert!(sigma_after(params, turning).1 < 0.3 * params.yaw_scale_sigma);
    let known = PoseFilterParams { yaw_scale_sigma: 0.0, ..params };
    assert_eq!(sigma_after(known, turning), (0.0, 0.0));
}

/// Where the belief is narrow the filter is the weighted mean of two poses, whatever the frames are turned by.
#[test]
fn one_correction_is_the_weighted_mean() {
    let (a, b) = (Se2::new(1.0, 2.0, 3.1), Se2::new(1.0, 2.0, 3.1) * Se2::new(0.01, -0.02, 0.08));
    let (p, r) = (Matrix3::from_diagonal_element(3e-4), Matrix3::from_diagonal_element(1e-4));
    let mut filter = PoseFilter::new(PoseFilterParams { gate: 1e9, ..PoseFilterParams::default() }).unwrap();
    filter.initialize(&PoseBelief::around(a, p).unwrap()).unwrap();
    filter.update(&PoseObservation::new(Stamp::default(), UncertainPose::new(b, r).unwrap())).unwrap();
    let estimate = filter.estimate().unwrap();
    let expected = a.plus(&(b.minus(&a) * 0.75));
    assert!(estimate.map_from_base().minus(&expected).norm() < 1e-12);
    assert!(wrap_angle(estimate.map_from_base().yaw() - (3.1 + 0.06)).abs() < 1e-12);
    assert!((estimate.covariance()[(2, 2)] - 0.75e-4).abs() < 1e-12);
}

#[test]
fn a_pose_beyond_the_gate_changes_nothing() {
    let (mut filter, mut drive) = started(PoseFilterParams::default(), 5);
    let (motion, _) = drive.step(&twist_at(0));
    filter.predict(&motion).unwrap();
    let before = filter.ekf;
    let far = UncertainPose::new(drive.truth * Se2::new(0.5, 0.0, 0.0), measured_noise()).unwrap();
    let outcome = filter.update(&PoseObservation::new(drive.now, far)).unwrap();
    assert!(matches!(outcome, UpdateOutcome::Skipped(SkipReason::Gated { nis, limit: 21.1 }) if nis > 100.0));
    assert_eq!(filter.ekf, before);
}

/// The Jacobian of the process against differences.
#[test]
fn the_model_is_its_own_derivative() {
    let mut drive = Drive::new(3, PoseFilterParams::default());
    for cycle in 0..50 {
        let (motion, _) = drive.step(&twist_at(5 * cycle));
        let state = AugmentedPose { map_from_base: drive.truth, extra: Vector1::new(0.2) };
        assert!(crate::kalman::laws::process_jacobian(&ScaledOdometry(drive.params), &state, &motion, DT) < 1e-8);
    }
}

#[test]
fn the_filter_obeys_the_laws_of_its_roles() {
    let mut filter = PoseFilter::new(PoseFilterParams::default()).unwrap();
    let (start, ahead) = (Se2::new(3.0, 1.0, 2.0), Se2::new(1.0, 0.1, 0.2));
    let motion =
        OdometryIncrement::between(Stamp::default(), &Se2::default(), Stamp::from_seconds(1.0), &ahead).unwrap();
    laws::localizer(&mut filter, &start, &measured_noise(), &motion).unwrap();
    let seen = UncertainPose::new(start * ahead, measured_noise()).unwrap();
    let observation = |sensor| PoseObservation::new(Stamp::from_seconds(1.0), seen).with_sensor(SensorId(sensor));
    laws::two_sensors(&mut filter, &observation(0), &observation(1)).unwrap();
}

#[test]
fn bad_parameters_are_named_and_bad_calls_refused() {
    let good = PoseFilterParams::default();
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        for (name, params) in [
            ("position_variance_per_metre", PoseFilterParams { position_variance_per_metre: bad, ..good }),
            ("yaw_variance_per_metre", PoseFilterParams { yaw_variance_per_metre: bad, ..good }),
            ("yaw_variance_per_radian", PoseFilterParams { yaw_variance_per_radian: bad, ..good }),
            ("yaw_scale_sigma", PoseFilterParams { yaw_scale_sigma: bad, ..good }),
            ("yaw_scale_walk", PoseFilterParams { yaw_scale_walk: bad, ..good }),
        ] {
            assert!(PoseFilter::new(params).unwrap_err().to_string().starts_with(name), "{name} {bad}");
        }
    }
    for gate in [0.0, -1.0, f64::NAN] {
        assert!(PoseFilter::new(PoseFilterParams { gate, ..good }).is_err());
    }
    let mut filter = PoseFilter::new(good).unwrap();
    let exact = PoseObservation::new(Stamp::default(), UncertainPose::exact(Se2::default()));
    assert_eq!(filter.update(&exact), Err(LocalizationError::NotInitialized));
    assert!(filter.initialize(&PoseBelief::Anywhere).is_err());
    assert!(filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::identity() * 1e13).unwrap()).is_err());
    filter.initialize(&PoseBelief::Around(UncertainPose::exact(Se2::default()))).unwrap();
    let before = filter;
    // Two poses that are both known exactly leave nothing to weigh by.
    assert!(filter.update(&exact).is_err());
    let far = OdometryIncrement::between(Stamp::default(), &Se2::default(), Stamp::default(), &Se2::new(1e9, 0.0, 0.0));
    assert!(filter.predict(&far.unwrap()).is_err());
    let negative = OdometryIncrement { covariance: -Matrix3::identity(), ..far.unwrap() };
    assert!(filter.predict(&OdometryIncrement { start_from_end: Se2::default(), ..negative }).is_err());
    assert_eq!(filter, before);
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_filter_goes_on_with_the_same_bits_and_is_checked() {
    let (mut filter, mut drive) = started(PoseFilterParams::default(), 11);
    let mut step = |filter: &mut PoseFilter, cycle| {
        let (motion, seen) = drive.step(&twist_at(cycle));
        let mut twin: PoseFilter = serde_json::from_str(&serde_json::to_string(filter).unwrap()).unwrap();
        for one in [filter, &mut twin] {
            one.predict(&motion).unwrap();
            one.update(&seen).unwrap();
        }
        twin
    };
    for cycle in 0..20 {
        let twin = step(&mut filter, cycle);
        assert_eq!(twin, filter);
    }
    let mut stored = serde_json::to_value(filter).unwrap();
    stored["ekf"]["state"]["extra"][0] = 0.9.into();
    assert!(serde_json::from_value::<PoseFilter>(stored).is_err());
}
