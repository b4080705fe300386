//! The filter with parts of one's own: sensors behind pointers, several sensors, numbers of particles that change, policies.

use agv_core::{
    compute::{Par, Seed, Stream},
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, SkipReason, UpdateOutcome, UpdateReport},
    sensors::{LaserScan, Observation, SensorId},
    time::Stamp,
};
use agv_filters::particle::{
    DifferentialOdometryModel, EveryNth, FreeSpace, LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, MclParams,
    MotionThreshold, OdometryNoise, ParticleSet, PerPose, PoseLikelihood, ResamplePolicy, SampleSize, SensorModel,
    Systematic, TemperingParams, WeighParticles,
};
use nalgebra::{Matrix3, Vector2};

/// A position fix by one of several beacons.
#[derive(Clone, Copy)]
struct Fix {
    sensor: SensorId,
    position: Vector2<f64>,
}

impl Observation for Fix {
    fn sensor(&self) -> SensorId {
        self.sensor
    }
}

#[derive(Clone, Copy)]
struct FixModel;

impl SensorModel<Fix> for FixModel {
    fn condition<'a>(&'a mut self, fix: &'a Fix) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        Ok(move |pose: &Se2| -50.0 * (pose.translation() - fix.position).norm_squared())
    }
}

fn fix(sensor: u16, x: f64, y: f64) -> Fix {
    Fix { sensor: SensorId(sensor), position: Vector2::new(x, y) }
}

fn plain() -> Grid<CellState> {
    Grid::filled(GridLayout::new(100, 100, 0.1, Se2::default()).unwrap(), CellState::Free)
}

fn filter<S>(sensor: S) -> Mcl<DifferentialOdometryModel, S> {
    filter_with(sensor, MclParams { particles: 800, ..Default::default() })
}

fn filter_with<S>(sensor: S, params: MclParams) -> Mcl<DifferentialOdometryModel, S> {
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let mut mcl = Mcl::new(motion, sensor, FreeSpace::new(&plain(), 0.2).unwrap(), params, Seed(3)).unwrap();
    mcl.initialize(&PoseBelief::around(Se2::new(5.0, 5.0, 0.0), Matrix3::identity() * 0.04).unwrap()).unwrap();
    mcl
}

fn ahead(x: f64, yaw: f64) -> OdometryIncrement {
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &Se2::new(x, 0.0, yaw)).unwrap()
}

fn is_applied(mcl: &mut impl Correct<Fix>, fix: &Fix) -> bool {
    matches!(mcl.update(fix), Ok(UpdateOutcome::Applied(_)))
}

#[test]
fn sensors_may_be_chosen_at_run_time() {
    let fixes = [fix(0, 5.1, 5.0), fix(1, 5.1, 5.1)];
    let run = |mcl: &mut dyn Correct<Fix, Pose = Se2>| {
        for fix in &fixes {
            assert!(matches!(mcl.update(fix), Ok(UpdateOutcome::Applied(_))));
        }
        mcl.estimate()
    };
    let boxed: Box<dyn WeighParticles<Fix> + Send> = Box::new(PerPose(FixModel));
    let mut borrowed = PerPose(FixModel);
    let expected = run(&mut filter(PerPose(FixModel)));
    assert_eq!(run(&mut filter(boxed)), expected);
    assert_eq!(run(&mut filter(&mut borrowed)), expected);

    let field = LikelihoodField::new(&plain(), LikelihoodFieldParams::default()).unwrap();
    let laser = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let boxed: Box<dyn WeighParticles<LaserScan> + Send> = Box::new(laser);
    let role: Box<dyn Correct<LaserScan, Pose = Se2> + Send> = Box::new(filter(boxed));
    assert!(role.estimate().is_some());
}

/// Two beacons, one along each axis: what one has told is no reason not to listen to the other, and the threshold counts
/// from each one's own last update.
#[test]
fn each_sensor_has_its_own_threshold() {
    let mut mcl = filter(PerPose(FixModel));
    assert!(is_applied(&mut mcl, &fix(0, 5.0, 5.0)));
    assert!(is_applied(&mut mcl, &fix(1, 5.0, 5.0)));
    mcl.predict(&ahead(0.15, 0.0)).unwrap();
    for sensor in [0, 1] {
        assert_eq!(mcl.update(&fix(sensor, 5.1, 5.0)), Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion)));
    }
    mcl.predict(&ahead(0.1, 0.0)).unwrap();
    assert!(is_applied(&mut mcl, &fix(0, 5.25, 5.0)));
    mcl.predict(&ahead(0.1, 0.0)).unwrap();
    assert!(!is_applied(&mut mcl, &fix(0, 5.35, 5.0)), "0.1 m after its last");
    assert!(is_applied(&mut mcl, &fix(1, 5.35, 5.0)), "0.35 m after its last");
    mcl.request_update();
    assert!(is_applied(&mut mcl, &fix(0, 5.35, 5.0)) && is_applied(&mut mcl, &fix(1, 5.35, 5.0)));
    assert_eq!(mcl.diagnostics().updates, 6);
}

/// What is seen once a lap is seen from the same place each time, and a lap lies between: it is no repetition.
#[test]
fn who_comes_back_after_a_lap_has_moved() {
    let mut mcl = filter(PerPose(FixModel));
    let turn = std::f64::consts::FRAC_PI_2;
    for _ in 0..3 {
        assert!(is_applied(&mut mcl, &fix(0, 5.0, 5.0)));
        assert!(!is_applied(&mut mcl, &fix(0, 5.0, 5.0)), "nothing lies between");
        (0..4).for_each(|_| mcl.predict(&ahead(1.0, turn)).unwrap());
    }
    // Rocking on the spot leads nowhere.
    assert!(is_applied(&mut mcl, &fix(0, 5.0, 5.0)));
    for _ in 0..20 {
        mcl.predict(&ahead(0.15, 0.0)).unwrap();
        mcl.predict(&ahead(-0.15, 0.0)).unwrap();
        assert!(!is_applied(&mut mcl, &fix(0, 5.0, 5.0)));
    }
}

/// The motion is drawn once for all odometry between two updates: its noise does not depend on how finely the odometry is
/// cut, nor on how many observations were skipped on the way.
#[test]
fn the_rate_of_odometry_and_of_skipped_observations_does_not_matter() {
    let run = |parts: usize| {
        let mut mcl = filter(PerPose(FixModel));
        assert!(is_applied(&mut mcl, &fix(0, 5.0, 5.0)));
        for _ in 0..parts {
            mcl.predict(&ahead(0.19 / parts as f64, 0.0)).unwrap();
            assert!(!is_applied(&mut mcl, &fix(0, 5.0, 5.0)));
        }
        mcl.predict(&ahead(0.2, 0.1)).unwrap();
        let before = mcl.estimate().unwrap();
        assert!(is_applied(&mut mcl, &fix(0, 5.4, 5.0)));
        (mcl, before)
    };
    let ((coarse, a), (fine, b)) = (run(1), run(20));
    let differences = coarse.particles().states().iter().zip(fine.particles().states());
    assert!(differences.map(|(a, b)| a.minus(b).norm()).fold(0.0, f64::max) < 1e-9);
    assert!((a.covariance() - b.covariance()).norm() < 1e-9);
}

/// The estimate that odometry carries on is what the particles say once they have moved.
#[test]
fn the_carried_estimate_agrees_with_the_moved_particles() {
    struct Mute;
    impl WeighParticles<Fix> for Mute {
        fn weigh(&mut self, _: &Fix, _: &[Se2], log_likelihoods: &mut [f64], _: Par) -> Result<(), SkipReason> {
            log_likelihoods.fill(0.0);
            Ok(())
        }
    }
    for (x, yaw) in [(0.4, 0.0), (0.3, 0.2), (-0.3, 0.1)] {
        let mut mcl = filter(Mute);
        mcl.initialize(&PoseBelief::around(Se2::new(5.0, 5.0, 1.0), Matrix3::identity() * 0.01).unwrap()).unwrap();
        mcl.predict(&ahead(x, yaw)).unwrap();
        let carried = mcl.estimate().unwrap();
        assert!(is_applied(&mut mcl, &fix(0, 0.0, 0.0)));
        let moved = mcl.estimate().unwrap();
        let (n, spread) = (800.0_f64, carried.covariance());
        let difference = moved.map_from_base().minus(carried.map_from_base());
        for i in 0..3 {
            // Five standard errors of the drawn noise; second order of a turn shortens a run by 1 - cos.
            let bound = 5.0 * (spread[(i, i)] / n).sqrt() + 0.05 * x.abs();
            assert!(difference[i].abs() < bound, "{x} {yaw}: {difference}");
            let ratio = moved.covariance()[(i, i)] / spread[(i, i)];
            assert!((ratio - 1.0).abs() < 5.0 * (2.0 / n).sqrt() + 0.05, "{x} {yaw}: variance {i} off by {ratio}");
        }
    }
}

/// Few particles where they agree, many where they do not.
struct BySpread;

impl SampleSize for BySpread {
    fn most(&self) -> Option<usize> {
        Some(3000)
    }

    fn sample_size(&mut self, particles: &ParticleSet, _: &mut Stream) -> usize {
        let spread = particles.estimate(Par::Seq).map_or(1.0, |pose| pose.position_deviation());
        (spread * 10_000.0) as usize
    }
}

#[test]
fn the_number_of_particles_may_change_at_each_resampling() {
    // An observation that is taken in by degrees draws the set anew whatever the policy.
    let params = MclParams { particles: 800, tempering: TemperingParams::never(), ..Default::default() };
    let mcl = filter_with(PerPose(FixModel), params).with_resampling(Systematic, EveryNth(2));
    let mut mcl = mcl.with_sample_size(BySpread).unwrap();
    mcl.initialize(&PoseBelief::around(Se2::new(5.0, 5.0, 0.0), Matrix3::identity()).unwrap()).unwrap();
    assert_eq!((mcl.particles().len(), mcl.particles().capacity()), (3000, 3000));
    let mut counts = Vec::new();
    for k in 1..=8 {
        mcl.predict(&ahead(0.21, 0.0)).unwrap();
        assert!(is_applied(&mut mcl, &fix(0, 5.0 + 0.21 * f64::from(k), 5.0)));
        counts.push(mcl.particles().len());
        assert_eq!(mcl.diagnostics().resampled, k % 2 == 0);
    }
    assert_eq!(counts[0], 3000);
    assert!(counts[1] < 2000 && counts[7] < counts[1] && counts[7] > 100, "{counts:?}");
    let error = mcl.estimate().unwrap().map_from_base().translation() - Vector2::new(6.68, 5.0);
    assert!(error.norm() < 0.2, "{error}");
}

#[test]
fn resampling_on_motion_spares_a_standing_vehicle() {
    let policy = EveryNth(1).and(MotionThreshold { distance: 0.5, angle: 1.0 });
    let mut mcl = filter(PerPose(FixModel)).with_resampling(Systematic, policy);
    let mut resampled = Vec::new();
    for k in 1..=6 {
        mcl.predict(&ahead(0.21, 0.0)).unwrap();
        assert!(is_applied(&mut mcl, &fix(0, 5.0 + 0.21 * f64::from(k), 5.0)));
        resampled.push(mcl.diagnostics().resampled);
    }
    assert_eq!(resampled, [false, false, true, false, false, true]);
    for _ in 0..3 {
        mcl.request_update();
        assert!(is_applied(&mut mcl, &fix(0, 6.26, 5.0)) && !mcl.diagnostics().resampled);
    }
}

#[test]
fn a_model_that_cannot_tell_reports_nothing() {
    let report = filter(PerPose(FixModel)).update(&fix(0, 5.0, 5.0));
    assert_eq!(report, Ok(UpdateOutcome::Applied(UpdateReport::default())));
}
