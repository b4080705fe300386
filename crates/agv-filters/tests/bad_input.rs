//! What logs and drivers send when something is wrong, to every filter: it is refused or skipped, and the belief stays what it
//! was.

#[allow(dead_code, reason = "each test binary uses its part")]
mod room;

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2, UncertainPose, UncertainVector},
    grid::{LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, Localizer, PoseBelief, UpdateOutcome},
    sensors::{LandmarkObservation, LaserScan, MarkerObservation, PoseObservation, ScanGeometry},
    time::Stamp,
};
use agv_filters::{
    fusion::{FusionFilter, FusionParams, RoleInput, SourceParams},
    kalman::{
        Gate, Landmark, PlanarPose, PoseFilter, PoseFilterParams, ProcessModel, Ukf, UkfParams, Unicycle,
        UnicycleParams,
    },
    landmark::{CalibrationPriors, LandmarkFilter, LandmarkFilterParams, LandmarkMap},
    marker::{MarkerFix, MarkerLocalizer, MarkerLocalizerParams, MarkerMap},
    particle::{
        Amcl, AmclParams, DifferentialOdometryModel, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl,
        MclParams, OdometryNoise, PriorMotionModel, PriorNoise,
    },
};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use room::Laser;

type ByScans = Box<dyn Correct<LaserScan, Pose = Se2>>;

fn sensor() -> LikelihoodFieldModel {
    let field = LikelihoodField::new(&room::room(), LikelihoodFieldParams::default()).unwrap();
    LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap()
}

fn space() -> FreeSpace {
    FreeSpace::new(&room::room(), 0.2).unwrap()
}

/// The particle filters; one of them has a single particle.
fn by_scans() -> Vec<(&'static str, ByScans)> {
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let prior = PriorMotionModel::new(PriorNoise::default()).unwrap();
    let of = |particles| MclParams { particles, ..MclParams::default() };
    vec![
        ("Mcl", Box::new(Mcl::new(motion, sensor(), space(), of(300), Seed(1)).unwrap())),
        ("Mcl by a prior", Box::new(Mcl::new(prior, sensor(), space(), of(300), Seed(1)).unwrap())),
        ("Mcl of one particle", Box::new(Mcl::new(motion, sensor(), space(), of(1), Seed(1)).unwrap())),
        ("Amcl", Box::new(Amcl::new(motion, sensor(), space(), AmclParams::default(), Seed(1)).unwrap())),
    ]
}

fn at(seconds: f64) -> Stamp {
    Stamp::from_seconds(seconds)
}

const START: (f64, f64, f64) = (4.0, 2.0, 0.3);

fn start() -> Se2 {
    Se2::new(START.0, START.1, START.2)
}

fn belief() -> PoseBelief<Se2> {
    PoseBelief::around(start(), Matrix3::identity() * 0.01).unwrap()
}

fn motion(from: f64, to: f64, step: Se2) -> OdometryIncrement {
    let motion = OdometryIncrement::between(at(from), &Se2::identity(), at(to), &step).unwrap();
    OdometryIncrement { covariance: Matrix3::identity() * 1e-4, ..motion }
}

fn step() -> Se2 {
    Se2::new(0.25, 0.0, 0.1)
}

/// Of so many beams, at a time.
fn scan(pose: &Se2, beams: usize, time: f64) -> LaserScan {
    let mut scan = Laser::ahead(beams).scan(pose, &[], &mut Seed(7).stream(0, 0));
    let ranges = scan.ranges().to_vec();
    scan.refill(at(time), ranges.into_iter()).unwrap();
    scan
}

fn is_finite(filter: &dyn Localizer<Pose = Se2>) -> bool {
    let estimate = filter.estimate().unwrap();
    estimate.map_from_base().is_finite() && estimate.covariance().iter().all(|value| value.is_finite())
}

/// Motions that every localizer refuses.
fn bad_motions() -> [OdometryIncrement; 6] {
    let good = motion(0.0, 1.0, step());
    [
        OdometryIncrement { start_from_end: Se2::new(f64::NAN, 0.0, 0.0), ..good },
        OdometryIncrement { start_from_end: Se2::new(0.0, 0.0, f64::INFINITY), ..good },
        OdometryIncrement { start_from_end: Se2::new(1e300, 0.0, 0.0), ..good },
        OdometryIncrement { covariance: Matrix3::from_element(f64::NAN), ..good },
        OdometryIncrement { covariance: Matrix3::from_element(f64::INFINITY), ..good },
        OdometryIncrement { covariance: -Matrix3::identity(), ..good },
    ]
}

#[test]
fn no_localizer_takes_a_bad_belief_or_motion() {
    for bad in [-Matrix3::identity(), Matrix3::from_element(f64::NAN), Matrix3::identity() * f64::INFINITY] {
        assert!(PoseBelief::around(start(), bad).is_err());
    }
    let indefinite = Matrix3::new(1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    assert!(PoseBelief::around(start(), indefinite).is_err());

    let mut filters: Vec<(&str, Box<dyn Localizer<Pose = Se2>>)> = vec![];
    for (name, filter) in by_scans() {
        filters.push((name, filter));
    }
    let landmarks = LandmarkMap::new([(1, Vector2::new(1.0, 1.0))]).unwrap();
    let landmarks = LandmarkFilter::new(landmarks, LandmarkFilterParams::default()).unwrap();
    let mut fusion = FusionFilter::new(FusionParams::default()).unwrap();
    let wheels = fusion.add_source(SourceParams::wheels()).unwrap();
    fusion.connect(RoleInput::Odometry, wheels).unwrap();
    filters.push(("LandmarkFilter", Box::new(landmarks)));
    filters.push(("FusionFilter", Box::new(fusion)));
    filters.push(("PoseFilter", Box::new(PoseFilter::new(PoseFilterParams::default()).unwrap())));
    for (name, filter) in &mut filters {
        assert_eq!(filter.predict(&motion(0.0, 1.0, step())), Err(LocalizationError::NotInitialized), "{name}");
        filter.initialize(&belief()).unwrap();
        filter.predict(&motion(0.0, 1.0, step())).unwrap();
        let before = (filter.estimate(), filter.status());
        let wide = PoseBelief::around(start(), Matrix3::identity() * 1e13).unwrap();
        assert!(filter.initialize(&wide).is_err(), "{name}");
        for bad in bad_motions() {
            // The models that state the noise themselves do not look at an increment's.
            let may_pass = bad.covariance.m11 < 0.0 && matches!(*name, "Mcl" | "Mcl of one particle" | "Amcl");
            assert!(filter.predict(&bad).is_err() || may_pass, "{name}: {bad:?}");
            if !may_pass {
                assert!((filter.estimate(), filter.status()) == before, "{name}: {bad:?}");
            }
        }
        // A vehicle whose place is known exactly is one too.
        filter.initialize(&PoseBelief::around(start(), Matrix3::zeros()).unwrap()).unwrap();
        filter.predict(&motion(2.0, 3.0, step())).unwrap();
        assert!(is_finite(filter.as_ref()), "{name}");
        // Clocks that step back or stand still, as the Intel log's do.
        for (from, to) in [(3.0, 2.5), (2.5, 2.5), (2.5, 4.0), (2.5, 4.0), (4.0, 4.5)] {
            let taken = filter.predict(&motion(from, to, step()));
            assert!(taken.is_ok() || (*name == "FusionFilter" && to <= from), "{name}: {from} {to} {taken:?}");
            assert!(is_finite(filter.as_ref()), "{name}: {from} {to}");
        }
    }
}

#[test]
fn scans_that_say_nothing_are_skipped() {
    let geometry = *scan(&start(), 90, 0.0).geometry();
    for (name, mut filter) in by_scans() {
        filter.initialize(&belief()).unwrap();
        for ranges in [
            vec![],
            vec![f32::NAN; 90],
            vec![f32::INFINITY; 90],
            vec![f32::NEG_INFINITY; 90],
            vec![-1.0; 90],
            vec![0.0; 90],
            vec![1e6; 90],
            vec![f32::MAX; 90],
        ] {
            let before = filter.estimate();
            let nothing = LaserScan::new(at(0.0), geometry, ranges.clone()).unwrap();
            let outcome = filter.update(&nothing);
            assert!(matches!(outcome, Ok(UpdateOutcome::Skipped(_))), "{name}: {outcome:?} of {ranges:.1?}");
            assert!(filter.estimate() == before, "{name}: {ranges:?}");
        }
        // Half of the beams are no numbers; the others count.
        let mut half = scan(&start(), 180, 0.0);
        let ranges: Vec<f32> =
            half.ranges().iter().enumerate().map(|(i, &r)| if i % 2 == 0 { f32::NAN } else { r }).collect();
        half.refill(at(0.0), ranges.into_iter()).unwrap();
        assert!(matches!(filter.update(&half), Ok(UpdateOutcome::Applied(_))), "{name}");
        assert!(is_finite(filter.as_ref()), "{name}");
    }
}

/// Scans of any length and stamp, one after the other.
#[test]
fn scans_may_be_longer_than_the_first_and_of_any_time() {
    for (name, mut filter) in by_scans() {
        filter.initialize(&belief()).unwrap();
        let mut truth = start();
        for (index, (beams, time)) in
            [(90, 1.0), (2881, 2.0), (7, 3.0), (20_000, 2.0), (90, 2.0), (360, -1e9), (90, 1e9)].into_iter().enumerate()
        {
            filter.predict(&motion(index as f64, index as f64 + 1.0, step())).unwrap();
            truth = truth * step();
            let outcome = filter.update(&scan(&truth, beams, time));
            assert!(matches!(outcome, Ok(UpdateOutcome::Applied(_))), "{name}: {beams} beams, {outcome:?}");
            assert!(is_finite(filter.as_ref()), "{name}: {beams} beams");
        }
        // More beams than the announced angles have room for: they go around more than once.
        let geometry = ScanGeometry { angle_increment: 0.1, ..*scan(&truth, 90, 0.0).geometry() };
        filter.predict(&motion(8.0, 9.0, step())).unwrap();
        filter.update(&LaserScan::new(at(9.0), geometry, vec![1.5; 1000]).unwrap()).unwrap();
        assert!(is_finite(filter.as_ref()), "{name}");
    }
}

#[test]
fn poses_off_the_map_are_refused_and_driving_there_does_no_harm() {
    for (name, mut filter) in by_scans() {
        filter.initialize(&belief()).unwrap();
        let before = filter.estimate();
        for (x, y) in [(500.0, 0.0), (-1e6, 1e6), (4.0, -30.0)] {
            let far = PoseBelief::around(Se2::new(x, y, 0.0), Matrix3::identity() * 0.01).unwrap();
            assert!(matches!(filter.initialize(&far), Err(LocalizationError::OffMap { .. })), "{name}");
            assert_eq!(filter.estimate(), before, "{name}");
        }
        filter.predict(&motion(0.0, 1.0, Se2::new(1000.0, 0.0, 0.0))).unwrap();
        filter.update(&scan(&start(), 90, 1.0)).unwrap();
        filter.predict(&motion(1.0, 2.0, Se2::new(1e5, 0.0, 3.0))).unwrap();
        filter.update(&scan(&start(), 90, 2.0)).unwrap();
        assert!(is_finite(filter.as_ref()), "{name}");
    }
}

/// A process whose noise is no covariance.
struct Broken(Matrix3<f64>);

impl ProcessModel<PlanarPose, 3> for Broken {
    type Control = ();

    fn transition(&self, state: &PlanarPose, (): &(), _: f64) -> PlanarPose {
        *state
    }

    fn jacobian(&self, _: &PlanarPose, (): &(), _: f64) -> Matrix3<f64> {
        Matrix3::identity()
    }

    fn noise(&self, _: &PlanarPose, (): &(), _: f64) -> Matrix3<f64> {
        self.0
    }
}

#[test]
fn the_unscented_filter_bears_zeros_and_refuses_what_is_no_covariance() {
    let start = PlanarPose::from(Vector3::new(1.0, 2.0, 3.1));
    let mut exact = Ukf::new(start, Matrix3::zeros(), &UkfParams::default()).unwrap();
    let beacon = Landmark::new(Vector2::new(3.0, 1.0), &Vector2::new(0.1, 0.1)).unwrap();
    let drive = Unicycle::new(UnicycleParams::default()).unwrap();
    for dt in [0.0, 0.1] {
        exact.predict(&drive, &Twist2::new(0.5, 0.0, 0.2), dt).unwrap();
        assert!(exact.update(&beacon, &Vector2::new(2.2, 2.0), &Gate::OPEN).is_ok(), "{dt}");
        assert!(exact.covariance().iter().all(|value| value.is_finite()));
    }
    let mut ukf = Ukf::new(start, Matrix3::identity() * 0.01, &UkfParams::default()).unwrap();
    let before = ukf;
    for noise in [-Matrix3::identity(), Matrix3::from_element(f64::NAN), Matrix3::identity() * f64::INFINITY] {
        assert!(ukf.predict(&Broken(noise), &(), 0.1).is_err());
    }
    // On top of a landmark there is no bearing.
    let here = Landmark::new(Vector2::new(1.0, 2.0), &Vector2::new(0.1, 0.1)).unwrap();
    let on_top = ukf.update(&here, &Vector2::new(0.1, 0.0), &Gate::OPEN);
    assert!(on_top.is_err() || ukf.covariance().iter().all(|value| value.is_finite()), "{on_top:?}");
    ukf = before;
    for reading in [Vector2::new(f64::INFINITY, 0.0), Vector2::new(1e200, 0.0), Vector2::new(1.0, f64::NAN)] {
        assert!(ukf.update(&beacon, &reading, &Gate::OPEN).is_err(), "{reading}");
    }
    assert_eq!(ukf, before);
}

#[test]
fn a_landmark_filter_bears_odd_sightings() {
    let place = Vector2::new(4.0, 1.0);
    let map = LandmarkMap::new([(1, place)]).unwrap();
    let known = LandmarkFilterParams { priors: CalibrationPriors::KNOWN, ..LandmarkFilterParams::default() };
    let mut filter = LandmarkFilter::new(map, known).unwrap();
    let reading = |range: f64, bearing: f64, sigma: f64| {
        let reading = UncertainVector::new(Vector2::new(range, bearing), Matrix2::identity() * (sigma * sigma))?;
        LandmarkObservation::new(at(1.0), Some(1), reading)
    };
    for (range, bearing, sigma) in
        [(f64::NAN, 0.0, 0.1), (-1.0, 0.0, 0.1), (1.0, f64::INFINITY, 0.1), (1.0, 0.0, f64::NAN)]
    {
        assert!(reading(range, bearing, sigma).is_err(), "{range} {bearing} {sigma}");
    }
    // Nothing is known but what is exact, and that is read exactly.
    filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::zeros()).unwrap()).unwrap();
    let before = filter.clone();
    assert!(filter.update(&reading(place.norm(), place.y.atan2(place.x), 0.0).unwrap()).is_err());
    assert_eq!(filter, before);
    // The same sighting twice, with the same stamp: two readings.
    filter.initialize(&belief()).unwrap();
    filter.predict(&motion(0.0, 1.0, step())).unwrap();
    let seen = (start() * step()).inverse().act(&place);
    let seen = reading(seen.norm(), seen.y.atan2(seen.x), 0.05).unwrap();
    for _ in 0..2 {
        assert!(matches!(filter.update(&seen), Ok(UpdateOutcome::Applied(_))));
        assert!(is_finite(&filter));
    }
}

#[test]
fn the_marker_localizer_bears_any_image() {
    let codes = MarkerMap::from_exact((0..60).map(|id| (id, Se2::new(0.2 * f64::from(id), 0.0, 0.0)))).unwrap();
    let localizer = MarkerLocalizer::new(codes, MarkerLocalizerParams::default()).unwrap();
    let see = |id: u32, x: f64, sigma: f64| {
        let pose = UncertainPose::new(Se2::new(x, 0.0, 0.0), Matrix3::identity() * (sigma * sigma)).unwrap();
        MarkerObservation::new(at(1.0), id, pose)
    };
    assert!(MarkerMap::from_exact([(1, Se2::new(f64::NAN, 0.0, 0.0))]).is_err());
    // One code, exact or as vague as can be, is a pose.
    for sigma in [0.0, 1e-9, 1e5] {
        let fix = localizer.locate(&[see(3, 0.1, sigma)]).unwrap();
        assert!(fix.observation().unwrap().map_from_base().mean().minus(&Se2::new(0.5, 0.0, 0.0)).norm() < 1e-9);
    }
    assert!(localizer.locate(&[see(3, 0.0, 0.0), see(4, 0.2, 0.0)]).is_err(), "both exact");
    // A number that is read twice, in one place and in two.
    assert!(matches!(localizer.locate(&[see(3, 0.0, 0.01); 2]), Ok(MarkerFix::Located { used: 2, .. })));
    assert_eq!(localizer.locate(&[see(3, 0.0, 0.01), see(3, 1.0, 0.01)]), Ok(MarkerFix::Contradictory));
    // More than are looked at.
    let many: Vec<_> = (0..60).map(|id| see(id, 0.2 * f64::from(id), 0.01)).collect();
    assert!(matches!(localizer.locate(&many), Ok(MarkerFix::Located { rejected: 0, .. })));
}

/// A pose filter and a fusion filter agree on what a measured pose may be.
#[test]
fn measured_poses_without_noise_meet_beliefs_without_doubt() {
    let exact = PoseBelief::around(start(), Matrix3::zeros()).unwrap();
    let seen = PoseObservation::new(at(1.0), UncertainPose::exact(start()));
    let mut filter = PoseFilter::new(PoseFilterParams::default()).unwrap();
    filter.initialize(&exact).unwrap();
    let before = filter;
    assert!(filter.update(&seen).is_err());
    assert_eq!(filter, before);
    let mut fusion = FusionFilter::new(FusionParams::default()).unwrap();
    let tracker = fusion.add_source(SourceParams::pose()).unwrap();
    fusion.initialize(&exact).unwrap();
    // There the source's floor is noise enough.
    fusion.fuse(tracker, seen).unwrap();
    assert!(is_finite(&fusion));
}
