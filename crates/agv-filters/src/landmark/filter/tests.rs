use super::*;
use crate::landmark::{CalibrationPriors, OdometryNoise, Prior, RangeKind};
use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Twist2, UncertainVector, wrap_angle},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, laws},
    sensors::SensorId,
};
use nalgebra::{Matrix3, SVector, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};

const DT: f64 = 0.05;
const RANGE_SIGMA: f64 = 0.05;
const BEARING_SIGMA: f64 = 0.02;

fn map() -> LandmarkMap {
    let places = [[5.0, 3.0], [5.0, -3.0], [-5.0, 3.5], [-5.0, -3.0], [0.0, 4.0], [0.5, -4.0]];
    LandmarkMap::new((1..).zip(places.map(Vector2::from))).unwrap()
}

fn start_covariance() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1e-3, 1e-3, 1e-3))
}

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}

/// A drive among landmarks whose truth is drawn from the filter's own model: unknown parameters from their priors, a wander,
/// white noise, and sightings of a moment that is `latency` before their stamps.
struct Drive {
    stream: Stream,
    params: LandmarkFilterParams,
    parameters: SVector<f64, 12>,
    /// True poses at the ends of the steps, the start first.
    poses: Vec<Se2>,
    odom: Se2,
}

impl Drive {
    fn new(seed: u64, params: &LandmarkFilterParams) -> Self {
        let mut stream = Seed(seed).stream(0, 0);
        let priors = params.priors.all(&params.noise);
        let parameters = SVector::from(priors.map(|prior| prior.mean + prior.sigma * normal(&mut stream)));
        Self { stream, params: *params, parameters, poses: vec![Se2::new(-1.0, 0.5, 0.3)], odom: Se2::default() }
    }

    fn get(&self, parameter: Parameter) -> f64 {
        self.parameters[parameter.index()]
    }

    fn now(&self) -> Stamp {
        Stamp::default() + (self.poses.len() - 1) as f64 * DT
    }

    fn truth(&self) -> Se2 {
        *self.poses.last().unwrap()
    }

    fn step(&mut self) -> OdometryIncrement {
        let (start, t) = (self.now(), self.poses.len() as f64 * DT);
        let twist = Twist2::new(0.6, 0.0, 0.5 + 0.4 * (0.3 * t).sin());
        let read = twist.integrate(DT).log();
        let noise = self.params.noise;
        let root = DT.sqrt();
        let way = (1.0 + self.get(Parameter::SpeedScale)) * read.x - self.get(Parameter::TurnLoss) * read.z.abs()
            + self.get(Parameter::SpeedError) * DT;
        let turn = (1.0 + self.get(Parameter::YawScale)) * read.z
            + (self.get(Parameter::YawBias) + self.get(Parameter::YawRateError)) * DT;
        let white = Vector3::new(
            noise.forward_density * root * normal(&mut self.stream),
            noise.forward_density * root * noise.sideways_share.sqrt() * normal(&mut self.stream),
            noise.yaw_density * root * normal(&mut self.stream),
        );
        self.poses.push(
            self.truth().plus(&(Vector3::new(way, read.y * (1.0 + self.get(Parameter::SpeedScale)), turn) + white)),
        );
        let kept = (-DT / noise.wander_time).exp();
        for (parameter, sigma) in
            [(Parameter::SpeedError, noise.speed_wander), (Parameter::YawRateError, noise.yaw_rate_wander)]
        {
            let fresh = sigma * (1.0 - kept * kept).sqrt() * normal(&mut self.stream);
            let wander = &mut self.parameters[parameter.index()];
            *wander = *wander * kept + fresh;
        }
        let odom = self.odom * twist.integrate(DT);
        let motion = OdometryIncrement::between(start, &self.odom, start + DT, &odom).unwrap();
        self.odom = odom;
        motion
    }

    /// Where the vehicle was some seconds ago.
    fn pose_before(&self, seconds: f64) -> Se2 {
        let steps = (seconds / DT).clamp(0.0, (self.poses.len() - 1) as f64);
        let whole = steps.floor() as usize;
        let later = self.poses[self.poses.len() - 1 - whole];
        let earlier = self.poses[self.poses.len().saturating_sub(2 + whole)];
        later.plus(&(earlier.minus(&later) * (steps - whole as f64)))
    }

    /// Landmark `id` as it is seen now.
    fn see(&mut self, id: u32) -> LandmarkObservation {
        let pose = self.pose_before(self.get(Parameter::Latency));
        let seen = pose.inverse().act(&map().position(id).unwrap());
        let bearing = seen.y.atan2(seen.x);
        let extent = if self.params.range_kind == RangeKind::Depth { seen.x } else { seen.norm() };
        let sigma = RANGE_SIGMA.hypot(self.params.range_share * extent);
        let range = (1.0 + self.get(Parameter::RangeScale)) * extent
            + self.get(Parameter::RangeBias)
            + sigma * normal(&mut self.stream);
        let error = self.get(Parameter::BearingBias)
            + self.get(Parameter::BearingSine) * bearing.sin()
            + self.get(Parameter::BearingCosine) * (1.0 - bearing.cos());
        let bearing = bearing + error + BEARING_SIGMA * normal(&mut self.stream);
        observation(self.now(), Some(id), range.max(0.0), bearing)
    }
}

fn observation(stamp: Stamp, id: Option<u32>, range: f64, bearing: f64) -> LandmarkObservation {
    let sigmas = Vector2::new(RANGE_SIGMA, BEARING_SIGMA);
    let reading = UncertainVector::from_sigmas(Vector2::new(range, wrap_angle(bearing)), &sigmas).unwrap();
    LandmarkObservation::new(stamp, id, reading).unwrap()
}

/// Sightings late by a fixed quarter second, plus or minus, all else from moderate priors.
fn params() -> LandmarkFilterParams {
    let priors = CalibrationPriors {
        latency: Prior::new(0.25, 0.05),
        bearing_cosine: Prior::within(0.03),
        ..CalibrationPriors::default()
    };
    let noise = OdometryNoise { forward_density: 0.005, yaw_density: 0.01, ..OdometryNoise::default() };
    LandmarkFilterParams { priors, noise, gate_probability: 1.0 - 1e-9, ..LandmarkFilterParams::default() }
}

fn started(seed: u64, params: &LandmarkFilterParams) -> (LandmarkFilter, Drive) {
    let (mut filter, mut drive) = (LandmarkFilter::new(map(), *params).unwrap(), Drive::new(seed, params));
    let root = start_covariance().map(f64::sqrt);
    let error = root * Vector3::from_fn(|_, _| normal(&mut drive.stream));
    filter.initialize(&PoseBelief::around(drive.truth().plus(&error), start_covariance()).unwrap()).unwrap();
    (filter, drive)
}

fn run(filter: &mut LandmarkFilter, drive: &mut Drive, steps: usize) {
    for step in 0..steps {
        filter.predict(&drive.step()).unwrap();
        if step % 4 == 3 {
            let seen = drive.see(1 + (step / 4 % 6) as u32);
            filter.update(&seen).unwrap();
        }
    }
}

/// Normalised squared errors at the ends of 80 drives of the filter's own model, of the pose and of all 15 unknowns. The sum of
/// `n` independent χ² draws of `k` degrees has the deviation √(2 k n); what the linearisation adds is left a tenth.
#[test]
fn errors_are_as_large_as_the_covariance_says() {
    let (mut pose_sum, mut state_sum, runs) = (0.0, 0.0, 80_u32);
    for seed in 0..u64::from(runs) {
        let (mut filter, mut drive) = started(seed, &params());
        run(&mut filter, &mut drive, 300);
        let (state, covariance) = filter.state().unwrap();
        let truth = CalibratedPose { map_from_base: drive.truth(), parameters: drive.parameters };
        let error = crate::kalman::Manifold::boxminus(&truth, state);
        state_sum += error.dot(&covariance.cholesky().unwrap().solve(&error));
        let pose = filter.estimate().unwrap().pose;
        let error = drive.truth().minus(pose.mean());
        pose_sum += error.dot(&pose.covariance().cholesky().unwrap().solve(&error));
    }
    for (sum, degrees) in [(pose_sum, 3.0), (state_sum, DEGREES as f64)] {
        let (mean, deviation) = (sum / f64::from(runs), (2.0 * degrees / f64::from(runs)).sqrt());
        assert!((mean - degrees).abs() < 4.0 * deviation + 0.1 * degrees, "{mean} of {degrees}");
    }
}

/// Scales and latency are found, each within four of its deviations, which have shrunk.
#[test]
fn odometry_and_latency_are_calibrated() {
    let (mut filter, mut drive) = started(5, &params());
    let known = [
        (Parameter::SpeedScale, -0.07, 0.02),
        (Parameter::TurnLoss, 0.05, 0.05),
        (Parameter::YawScale, 0.06, 0.04),
        (Parameter::Latency, 0.32, 0.025),
        (Parameter::RangeScale, 0.03, 0.02),
    ];
    for (parameter, value, _) in known {
        drive.parameters[parameter.index()] = value;
    }
    run(&mut filter, &mut drive, 6000);
    for (parameter, value, at_most) in known {
        let learnt = filter.learnt(parameter).unwrap();
        assert!((learnt.value - value).abs() < 4.0 * learnt.sigma, "{parameter:?} {learnt:?}");
        assert!(learnt.sigma < at_most, "{parameter:?} {learnt:?}");
    }
    assert!(filter.estimate().unwrap().map_from_base().minus(&drive.truth()).norm() < 0.1);
    assert_eq!(filter.status(), LocalizationStatus::Tracking);
}

/// A depth is no distance: with the wrong kind the errors at the edge of the view are those of the cosine.
#[test]
fn what_the_range_is_matters() {
    let error = |told: RangeKind| {
        let real = LandmarkFilterParams { range_kind: RangeKind::Depth, priors: CalibrationPriors::KNOWN, ..params() };
        let (mut filter, mut drive) = started(3, &real);
        filter.params.range_kind = told;
        let mut square = 0.0;
        for step in 0..1200 {
            filter.predict(&drive.step()).unwrap();
            let id = 1 + (step % 6) as u32;
            let seen = drive.truth().inverse().act(&map().position(id).unwrap());
            if seen.y.abs() < seen.x {
                let seen = drive.see(id);
                filter.update(&seen).unwrap();
            }
            square +=
                (filter.estimate().unwrap().map_from_base().translation() - drive.truth().translation()).norm_squared();
        }
        (square / 1200.0).sqrt()
    };
    assert!(error(RangeKind::Depth) < 0.05);
    assert!(error(RangeKind::Distance) > 3.0 * error(RangeKind::Depth));
}

/// Commands half a second early: on the landmarks' clock the vehicle is not yet where they say, on the odometry's it is.
#[test]
fn the_estimate_is_of_the_clock_that_was_chosen() {
    let priors = CalibrationPriors { latency: Prior::new(0.5, 1e-6), ..CalibrationPriors::KNOWN };
    for (clock, before) in [(EstimateClock::Odometry, 0.0), (EstimateClock::Landmarks, 0.5)] {
        let (mut filter, mut drive) = started(8, &LandmarkFilterParams { priors, clock, ..params() });
        run(&mut filter, &mut drive, 400);
        let estimate = filter.estimate().unwrap();
        assert_eq!(estimate.stamp, Some(drive.now()));
        let off = drive.pose_before(before).minus(estimate.map_from_base());
        assert!(
            off.norm() < 5.0 * estimate.pose.position_deviation().hypot(estimate.pose.rotation_deviation()),
            "{off}"
        );
        assert!(drive.pose_before(0.5 - before).minus(estimate.map_from_base()).norm() > 0.2);
    }
}

/// A vehicle that is moved behind the filter's back is found again, where a filter without patience is lost.
#[test]
fn a_belief_that_all_landmarks_contradict_is_doubted() {
    let end = |patience| {
        let (mut filter, mut drive) =
            started(4, &LandmarkFilterParams { gate_probability: 0.999, patience, ..params() });
        run(&mut filter, &mut drive, 400);
        let stray = drive.truth() * Se2::new(1.5, -1.0, 0.6);
        drive.poses.iter_mut().for_each(|pose| *pose = stray);
        run(&mut filter, &mut drive, 400);
        filter.estimate().unwrap().map_from_base().minus(&drive.truth()).norm()
    };
    assert!(end(3) < 0.2);
    assert!(end(usize::MAX) > 0.5);
}

#[test]
fn one_outlier_changes_nothing() {
    let (mut filter, mut drive) = started(6, &LandmarkFilterParams { gate_probability: 0.999, ..params() });
    run(&mut filter, &mut drive, 200);
    let before = filter.estimate();
    let stray = observation(drive.now(), Some(2), 0.3, 2.0);
    let outcome = filter.update(&stray).unwrap();
    assert!(matches!(outcome, UpdateOutcome::Skipped(SkipReason::Gated { nis, limit }) if nis > limit));
    assert_eq!(filter.estimate(), before);
}

/// Sightings without numbers are as good as those with, where the landmarks are far apart.
#[test]
fn an_unnamed_landmark_is_recognised() {
    let (mut filter, mut drive) = started(9, &params());
    run(&mut filter, &mut drive, 200);
    let (mut named, seen) = (filter.clone(), drive.see(3));
    let unnamed = observation(seen.stamp(), None, seen.range(), seen.bearing());
    assert_eq!(filter.update(&unnamed).unwrap(), named.update(&seen).unwrap());
    assert_eq!(filter, named);
    let nothing_there = observation(seen.stamp(), None, 0.5, 0.0);
    assert_eq!(filter.update(&nothing_there), Ok(UpdateOutcome::Skipped(SkipReason::Unexplained)));
}

/// What arrives late is taken in as if it had been in time, but for what the latency learnt in between.
#[test]
fn a_late_sighting_counts_as_one_in_time() {
    let known = LandmarkFilterParams { priors: CalibrationPriors::KNOWN, ..params() };
    let (mut in_time, mut drive) = started(2, &known);
    run(&mut in_time, &mut drive, 100);
    let mut late = in_time.clone();
    let seen = drive.see(1);
    in_time.update(&seen).unwrap();
    for _ in 0..10 {
        let motion = drive.step();
        in_time.predict(&motion).unwrap();
        late.predict(&motion).unwrap();
    }
    late.update(&seen).unwrap();
    let [a, b] = [in_time, late].map(|filter| filter.estimate().unwrap().pose);
    assert!(a.mean().minus(b.mean()).norm() < 1e-9);
    assert!((a.covariance() - b.covariance()).amax() < 1e-9);
}

#[test]
fn the_filter_obeys_the_laws_of_its_roles() {
    let mut filter = LandmarkFilter::new(map(), LandmarkFilterParams::default()).unwrap();
    let (start, ahead) = (Se2::new(1.0, 1.0, 2.0), Se2::new(1.0, 0.1, 0.2));
    let motion =
        OdometryIncrement::between(Stamp::default(), &Se2::default(), Stamp::from_seconds(1.0), &ahead).unwrap();
    laws::localizer(&mut filter, &start, &start_covariance(), &motion).unwrap();
    laws::correct(&mut filter, &observation(Stamp::from_seconds(1.0), Some(77), 1.0, 0.0)).unwrap();
    let seen = (start * ahead).inverse().act(&map().position(1).unwrap());
    let sighting = |sensor| {
        observation(Stamp::from_seconds(1.0), Some(1), seen.norm(), seen.y.atan2(seen.x)).with_sensor(SensorId(sensor))
    };
    laws::two_sensors(&mut filter, &sighting(0), &sighting(1)).unwrap();
}

#[test]
fn bad_parameters_are_named_and_bad_calls_refused() {
    let good = LandmarkFilterParams::default();
    let refused = |params| LandmarkFilter::new(map(), params).map(|_| ()).unwrap_err().to_string();
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let noise = |noise| LandmarkFilterParams { noise, ..good };
        let priors = |priors| LandmarkFilterParams { priors, ..good };
        for (name, params) in [
            ("range_share", LandmarkFilterParams { range_share: bad, ..good }),
            ("history", LandmarkFilterParams { history: bad, ..good }),
            ("forward_density", noise(OdometryNoise { forward_density: bad, ..good.noise })),
            ("yaw_density", noise(OdometryNoise { yaw_density: bad, ..good.noise })),
            ("speed_wander", noise(OdometryNoise { speed_wander: bad, ..good.noise })),
            ("yaw_rate_wander", noise(OdometryNoise { yaw_rate_wander: bad, ..good.noise })),
            ("wander_time", noise(OdometryNoise { wander_time: bad, ..good.noise })),
            ("sideways_share", noise(OdometryNoise { sideways_share: bad, ..good.noise })),
            ("speed_scale", priors(CalibrationPriors { speed_scale: Prior::within(bad), ..good.priors })),
            ("latency", priors(CalibrationPriors { latency: Prior::within(bad), ..good.priors })),
            ("range_bias", priors(CalibrationPriors { range_bias: Prior::within(bad), ..good.priors })),
        ] {
            assert!(refused(params).starts_with(name), "{name} {bad}");
        }
    }
    for bad in [0.0, 1.0, f64::NAN] {
        assert!(LandmarkFilter::new(map(), LandmarkFilterParams { gate_probability: bad, ..good }).is_err());
    }
    assert!(refused(LandmarkFilterParams { patience: 0, ..good }).starts_with("patience"));
    let wild = CalibrationPriors { turn_loss: Prior::new(f64::NAN, 0.1), ..good.priors };
    assert!(refused(LandmarkFilterParams { priors: wild, ..good }).starts_with("turn_loss"));

    let mut filter = LandmarkFilter::new(map(), good).unwrap();
    let seen = observation(Stamp::default(), Some(1), 3.0, 0.0);
    assert_eq!(filter.update(&seen), Err(LocalizationError::NotInitialized));
    assert_eq!(filter.learnt(Parameter::Latency), None);
    assert!(filter.initialize(&PoseBelief::Anywhere).is_err());
    assert!(filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::identity() * 1e13).unwrap()).is_err());
}

/// Stamps that repeat, step backwards or leave gaps lose no motion, and sightings from another time are told.
#[test]
fn odd_times_are_borne() {
    let known = LandmarkFilterParams { priors: CalibrationPriors::KNOWN, ..LandmarkFilterParams::default() };
    let mut filter = LandmarkFilter::new(map(), known).unwrap();
    filter.initialize(&PoseBelief::around(Se2::default(), start_covariance()).unwrap()).unwrap();
    let at = Stamp::from_seconds;
    let step = Se2::new(0.1, 0.0, 0.02);
    let mut expected = Se2::default();
    for (start, end) in [(0.0, 0.1), (0.1, 0.1), (0.1, 0.0), (0.0, 0.2), (5.0, 5.1), (5.1, 4.9), (4.9, 5.2)] {
        filter.predict(&OdometryIncrement::between(at(start), &Se2::default(), at(end), &step).unwrap()).unwrap();
        expected = expected * step;
        assert!(filter.estimate().unwrap().map_from_base().minus(&expected).norm() < 1e-9, "{start} {end}");
    }
    let before = filter.clone();
    for stamp in [0.0, 9.0, -1e9, 1e9] {
        let outcome = filter.update(&observation(at(stamp), Some(1), 3.0, 0.0)).unwrap();
        assert!(matches!(outcome, UpdateOutcome::Skipped(SkipReason::OutsideHistory { .. })), "{stamp}");
    }
    assert_eq!(filter.estimate(), before.estimate());
    let far = Se2::new(1e9, 0.0, 0.0);
    assert!(filter.predict(&OdometryIncrement::between(at(5.2), &Se2::default(), at(5.3), &far).unwrap()).is_err());
    let vague = OdometryIncrement::between(at(5.2), &Se2::default(), at(5.3), &step).unwrap();
    assert!(filter.predict(&OdometryIncrement { covariance: -Matrix3::identity(), ..vague }).is_err());
    assert_eq!(filter.estimate(), before.estimate());
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_filter_goes_on_with_the_same_bits_and_is_checked() {
    let (mut filter, mut drive) = started(11, &params());
    run(&mut filter, &mut drive, 100);
    let mut twin: LandmarkFilter = serde_json::from_str(&serde_json::to_string(&filter).unwrap()).unwrap();
    assert_eq!(twin, filter);
    let (motion, seen) = (drive.step(), drive.see(2));
    for one in [&mut filter, &mut twin] {
        one.predict(&motion).unwrap();
        one.update(&seen).unwrap();
    }
    assert_eq!(twin, filter);
    let mut stored = serde_json::to_value(&filter).unwrap();
    stored["params"]["patience"] = 0.into();
    assert!(serde_json::from_value::<LandmarkFilter>(stored).is_err());
}
