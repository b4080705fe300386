//! The Gaussian filters, and what goes with them, on one drive: a circle past reflectors, at 20 Hz.

use agv_nav::core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    nalgebra::{Matrix3, Vector2, Vector3},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
    sensors::{ImuSample, LandmarkObservation, MarkerObservation, PoseObservation},
    time::Stamp,
};
use agv_nav::filters::{
    fusion::{FusionFilter, FusionOutcome, FusionParams, SourceId, SourceParams},
    kalman::{
        BootstrapFilter, Ekf, Gate, GaussianBelief, IterationParams, Landmark, PlanarPose, RtsSmoother, Ukf, UkfParams,
        Unicycle, UnicycleParams,
    },
    landmark::{LandmarkFilter, LandmarkFilterParams, LandmarkMap},
    marker::{MarkerLocalizer, MarkerLocalizerParams, MarkerMap, SourceSwitch, SourceSwitchParams, SwitchInput},
};
use std::ops::Range;

const DT: f64 = 0.05;
const TWIST: Twist2 = Twist2::new(0.5, 0.0, 0.25);

/// Reflectors around the circle; every other one knows its number.
const REFLECTORS: [(f64, f64); 4] = [(4.0, 3.0), (-4.0, 2.5), (0.5, -4.0), (3.0, -2.0)];

/// Pose, odometry and time at the end of a step.
fn at(step: u32) -> (Se2, Stamp) {
    let time = f64::from(step) * DT;
    (TWIST.integrate(time), Stamp::from_seconds(time))
}

fn motion(step: u32) -> OdometryIncrement {
    let ((from, start), (to, end)) = (at(step), at(step + 1));
    let noise = Matrix3::from_diagonal(&Vector3::new(1e-6, 1e-6, 1e-6));
    OdometryIncrement { covariance: noise, ..OdometryIncrement::between(start, &from, end, &to).unwrap() }
}

fn reflector(step: u32) -> (u32, Vector2<f64>) {
    let index = step as usize % REFLECTORS.len();
    (index as u32, Vector2::new(REFLECTORS[index].0, REFLECTORS[index].1))
}

/// Range and bearing of a reflector, off by up to 2 cm and 0.01 rad.
fn reading(step: u32) -> Vector2<f64> {
    let seen = at(step + 1).0.inverse().act(&reflector(step).1);
    let off = f64::from(step % 7) / 3.0 - 1.0;
    Vector2::new(seen.norm() + 0.02 * off, seen.y.atan2(seen.x) - 0.01 * off)
}

fn sigmas() -> Vector2<f64> {
    Vector2::new(0.05, 0.02)
}

fn first_belief() -> GaussianBelief<PlanarPose, 3> {
    GaussianBelief::new(PlanarPose::from(Vector3::new(0.05, -0.02, 0.03)), Matrix3::identity() * 0.01).unwrap()
}

/// Calls `step` with the models and the reading of each step.
fn steps(range: Range<u32>, mut step: impl FnMut(&Unicycle, &Landmark, &Vector2<f64>)) {
    let drive = Unicycle::new(UnicycleParams::default()).unwrap();
    for k in range {
        step(&drive, &Landmark::new(reflector(k).1, &sigmas()).unwrap(), &reading(k));
    }
}

pub(crate) fn ekf() -> Ekf<PlanarPose, 3> {
    Ekf::from(first_belief())
}

/// Every third step corrects iteratively.
pub(crate) fn run_ekf(filter: &mut Ekf<PlanarPose, 3>, range: Range<u32>) {
    let mut iterated = 0;
    steps(range, |drive, landmark, reading| {
        filter.predict(drive, &TWIST, DT).unwrap();
        iterated += 1;
        if iterated % 3 == 0 {
            filter.update_iterated(landmark, reading, &Gate::OPEN, &IterationParams::default()).unwrap();
        } else {
            assert!(filter.update(landmark, reading, &Gate::OPEN).unwrap().accepted);
        }
    });
}

pub(crate) fn ukf() -> Ukf<PlanarPose, 3> {
    let belief = first_belief();
    Ukf::new(*belief.state(), *belief.covariance(), &UkfParams { kappa: 0.5, ..UkfParams::default() }).unwrap()
}

pub(crate) fn run_ukf(filter: &mut Ukf<PlanarPose, 3>, range: Range<u32>) {
    steps(range, |drive, landmark, reading| {
        filter.predict(drive, &TWIST, DT).unwrap();
        assert!(filter.update(landmark, reading, &Gate::OPEN).unwrap().accepted);
    });
}

pub(crate) fn smoother() -> RtsSmoother<PlanarPose, 3> {
    RtsSmoother::new(Ekf::from(first_belief()))
}

pub(crate) fn run_smoother(filter: &mut RtsSmoother<PlanarPose, 3>, range: Range<u32>) {
    steps(range, |drive, landmark, reading| {
        filter.predict(drive, &TWIST, DT).unwrap();
        assert!(filter.update(landmark, reading, &Gate::OPEN).unwrap().accepted);
    });
}

pub(crate) fn bootstrap(par: Par) -> BootstrapFilter<PlanarPose, 3> {
    // Not a multiple of the chunk, and several chunks per thread.
    BootstrapFilter::around(&first_belief(), 3001, Seed(5)).unwrap().with_parallelism(par)
}

/// Whether it has resampled.
pub(crate) fn run_bootstrap(filter: &mut BootstrapFilter<PlanarPose, 3>, range: Range<u32>) -> bool {
    let mut resampled = false;
    steps(range, |drive, landmark, reading| {
        filter.predict(drive, &TWIST, DT).unwrap();
        let weights = filter.update(landmark, reading).unwrap().expect("a particle explains it");
        resampled |= weights.effective_sample_size < 1500.0;
        std::hint::black_box(filter.estimate().unwrap());
    });
    resampled
}

/// States and weights of the particles.
pub(crate) fn bootstrap_bits(filter: &BootstrapFilter<PlanarPose, 3>) -> Vec<u64> {
    let particles = filter.particles();
    let states = particles.states().iter().flat_map(|state| state.vector().iter().copied());
    let weights = particles.weights().iter().chain(particles.log_weights()).copied();
    states.chain(weights).map(f64::to_bits).collect()
}

pub(crate) fn landmark_filter() -> LandmarkFilter {
    let map = LandmarkMap::new((0..).zip(REFLECTORS.map(|(x, y)| Vector2::new(x, y)))).unwrap();
    let mut filter = LandmarkFilter::new(map, LandmarkFilterParams::default()).unwrap();
    filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::identity() * 1e-3).unwrap()).unwrap();
    filter
}

/// Sightings are 0.1 s late; how many were applied.
pub(crate) fn run_landmarks(filter: &mut LandmarkFilter, range: Range<u32>) -> u32 {
    let mut applied = 0;
    for k in range {
        filter.predict(&motion(k)).unwrap();
        let Some(late) = k.checked_sub(2) else { continue };
        let reading = UncertainVector::from_sigmas(reading(late), &sigmas()).unwrap();
        let id = Some(reflector(late).0).filter(|id| id % 2 == 0);
        let seen = LandmarkObservation::new(at(late + 1).1, id, reading).unwrap();
        applied += u32::from(matches!(filter.update(&seen), Ok(UpdateOutcome::Applied(_))));
        assert!(filter.estimate().is_some());
    }
    applied
}

/// A filter with wheels, gyro and a tracking system, and a history that turns over many times.
pub(crate) fn fusion() -> (FusionFilter, [SourceId; 3]) {
    let mut filter = FusionFilter::new(FusionParams { history: 0.5, ..FusionParams::default() }).unwrap();
    let sources =
        [SourceParams::wheels(), SourceParams::imu(), SourceParams::pose()].map(|s| filter.add_source(s).unwrap());
    filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::identity() * 1e-4).unwrap()).unwrap();
    (filter, sources)
}

/// The tracking system is 0.1 s late, every half a second.
pub(crate) fn run_fusion(filter: &mut FusionFilter, [wheels, gyro, tracker]: [SourceId; 3], range: Range<u32>) {
    let rates = UncertainVector::from_sigmas(Vector3::new(0.0, 0.0, 0.25), &Vector3::repeat(1e-3)).unwrap();
    for k in range {
        let now = at(k + 1).1;
        filter.fuse(gyro, ImuSample::new(now).with_angular_velocity(rates)).unwrap();
        filter.fuse(wheels, motion(k)).unwrap();
        if k % 10 == 9 {
            let (pose, then) = at(k - 1);
            let pose = UncertainPose::new(pose, Matrix3::identity() * 1e-4).unwrap();
            let outcome = filter.fuse(tracker, PoseObservation::new(then, pose)).unwrap();
            assert!(matches!(outcome, FusionOutcome::Applied { .. }), "{outcome:?}");
            filter.take_motion().unwrap();
            assert!(filter.state_at(then + -0.1).is_some() && filter.diagnostics(tracker).is_some());
        }
    }
}

pub(crate) fn marker_localizer() -> MarkerLocalizer {
    let exact = (0..40).map(|id| (id, at(5 * id).0));
    MarkerLocalizer::new(MarkerMap::from_exact(exact).unwrap(), MarkerLocalizerParams::default()).unwrap()
}

pub(crate) fn source_switch() -> SourceSwitch {
    SourceSwitch::new(SourceSwitchParams::default()).unwrap()
}

/// Images with three codes, one of them moved by half a metre; how often it drove by codes.
pub(crate) fn run_codes(localizer: &MarkerLocalizer, switch: &mut SourceSwitch, range: Range<u32>) -> usize {
    let mut by_codes = 0;
    for k in range {
        let (truth, now) = at(k);
        let see = |id: u32, off: f64| {
            let lies = at(5 * id).0 * Se2::new(off, 0.0, 0.0);
            let pose = UncertainPose::new(truth.between(&lies), Matrix3::identity() * 1e-5).unwrap();
            MarkerObservation::new(now, id, pose)
        };
        let id = k / 5;
        let belief = UncertainPose::new(truth, Matrix3::identity() * 1e-5).unwrap();
        assert_eq!(localizer.associate(&belief, &see(id, 0.0).base_from_marker()), Some(id));
        let fix = localizer.locate(&[see(id, 0.0), see(id + 1, 0.0), see(id + 2, 0.5)]).unwrap();
        let pose = fix.observation().expect("two agree").map_from_base();
        assert!(pose.mean().minus(&truth).norm() < 1e-6);
        let input = SwitchInput { distance_to_code: Some(0.1), code_seen: true, travelled: 0.025 };
        by_codes += usize::from(switch.update(&input).unwrap() == agv_nav::filters::marker::PoseSource::Code);
    }
    by_codes
}
