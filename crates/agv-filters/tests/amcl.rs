//! The adaptive filter in a room whose scans are computed by marching: kidnapped, switched on anywhere, and given bad input.

use agv_core::{
    Error,
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Twist2, UncertainPose},
    grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams},
    odometry::OdometryIncrement,
    roles::{Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, SkipReason, UpdateOutcome, laws},
    sensors::{LaserScan, PoseObservation, ScanGeometry},
    time::Stamp,
};
use agv_filters::particle::{
    Amcl, AmclParams, DifferentialOdometryModel, FreeSpace, KldParams, LikelihoodFieldModel,
    LikelihoodFieldModelParams, OdometryNoise, PoseProposal, ProposalContext, RecoveryParams, TemperingParams,
    UniformProposal, WeighParticles,
};
use nalgebra::{Matrix3, Vector3};

/// 9 x 6 m with furniture, so that no two places look alike.
fn room() -> Grid<CellState> {
    let layout = GridLayout::new(180, 120, 0.05, Se2::identity()).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    let blocks =
        [(0, 0, 180, 2), (0, 118, 180, 2), (0, 0, 2, 120), (178, 0, 2, 120), (0, 40, 14, 20), (60, 104, 34, 14)];
    for (x0, y0, width, height) in blocks.into_iter().chain([(110, 50, 30, 12), (150, 0, 28, 18), (52, 40, 6, 6)]) {
        for x in x0..x0 + width {
            for y in y0..y0 + height {
                map.set(Cell::new(x, y), CellState::Occupied);
            }
        }
    }
    map
}

fn scan_from(map: &Grid<CellState>, pose: &Se2) -> LaserScan {
    let geometry = ScanGeometry { angle_min: -2.6, angle_increment: 5.2 / 89.0, ..Default::default() };
    let range = |beam: usize| {
        let (sin, cos) = (pose.yaw() + geometry.angle(beam)).sin_cos();
        let is_hit = |r: &f64| {
            let cell = map.layout().cell_at(&[pose.x() + r * cos, pose.y() + r * sin].into());
            cell.is_none_or(|cell| map.get(cell) == Some(&CellState::Occupied))
        };
        (0..1200).map(|k| f64::from(k) * 0.01).find(is_hit).unwrap_or(f64::INFINITY) as f32
    };
    LaserScan::new(Stamp::default(), geometry, (0..90).map(range).collect()).unwrap()
}

type Filter = Amcl<DifferentialOdometryModel, LikelihoodFieldModel>;

fn params() -> AmclParams {
    AmclParams { kld: KldParams { max_particles: 5000, ..Default::default() }, ..Default::default() }
}

fn filter_with(params: &AmclParams, seed: u64) -> Result<Filter, Error> {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.05)).unwrap();
    Amcl::new(motion, sensor, FreeSpace::new(&map, 0.2).unwrap().largest(), *params, Seed(seed))
}

fn filter(seed: u64) -> Filter {
    filter_with(&params(), seed).unwrap()
}

fn around(pose: Se2) -> PoseBelief<Se2> {
    PoseBelief::around(pose, Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.02))).unwrap()
}

/// The motion of each step.
fn step() -> OdometryIncrement {
    let end = Twist2::new(0.25, 0.0, 0.25).integrate(1.0);
    OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &end).unwrap()
}

/// Drives some steps from a pose; returns where it ends.
fn drive(filter: &mut Filter, map: &Grid<CellState>, from: Se2, steps: usize) -> Se2 {
    (0..steps).fold(from, |pose, _| {
        let pose = pose * step().start_from_end;
        filter.predict(&step()).unwrap();
        filter.update(&scan_from(map, &pose)).unwrap();
        pose
    })
}

fn error(filter: &Filter, truth: &Se2) -> f64 {
    (filter.estimate().unwrap().map_from_base().translation() - truth.translation()).norm()
}

/// Two places whose circles of one metre are free.
const HERE: (f64, f64, f64) = (3.0, 1.0, 0.0);
const THERE: (f64, f64, f64) = (6.0, 3.6, 1.0);

#[test]
fn a_kidnap_is_noticed_and_the_vehicle_found() {
    let map = room();
    let (here, there) = (Se2::new(HERE.0, HERE.1, HERE.2), Se2::new(THERE.0, THERE.1, THERE.2));
    for seed in 0..10 {
        let mut filter = filter(seed);
        filter.initialize(&around(here)).unwrap();
        let truth = drive(&mut filter, &map, here, 12);
        assert!(error(&filter, &truth) < 0.1 && filter.status() == LocalizationStatus::Tracking, "seed {seed}");
        assert!(filter.particles().len() < 1000 && filter.diagnostics().fresh == 0);
        let truth = drive(&mut filter, &map, there, 1);
        assert!(error(&filter, &truth) > 1.0 || filter.diagnostics().fresh > 0);
        let truth = drive(&mut filter, &map, truth, 12);
        assert!(error(&filter, &truth) < 0.1 && filter.status() == LocalizationStatus::Tracking, "seed {seed}");
        assert_eq!(filter.hypotheses().len(), 1);
    }
}

#[test]
fn a_vehicle_that_is_switched_on_anywhere_is_found_with_few_particles() {
    let map = room();
    for seed in 0..10 {
        let mut filter = filter(seed);
        filter.initialize(&PoseBelief::Anywhere).unwrap();
        assert_eq!(filter.particles().len(), 5000);
        let truth = drive(&mut filter, &map, Se2::new(HERE.0, HERE.1, HERE.2), 15);
        assert!(error(&filter, &truth) < 0.1, "seed {seed}: {}", error(&filter, &truth));
        assert!(filter.particles().len() < 1500, "seed {seed}: {}", filter.particles().len());
    }
}

#[test]
fn without_recovery_a_kidnapped_vehicle_stays_lost() {
    let map = room();
    // Nor tempering, whose kernel spreads the particles, nor refinement, which helps a wrong place to explain more.
    let plain = AmclParams {
        recovery: RecoveryParams::never(),
        tempering: TemperingParams::never(),
        refine: false,
        ..params()
    };
    let mut filter = filter_with(&plain, 1).unwrap();
    filter.initialize(&around(Se2::new(HERE.0, HERE.1, HERE.2))).unwrap();
    drive(&mut filter, &map, Se2::new(HERE.0, HERE.1, HERE.2), 12);
    let truth = drive(&mut filter, &map, Se2::new(THERE.0, THERE.1, THERE.2), 12);
    assert!(error(&filter, &truth) > 0.5);
    assert!(matches!(filter.status(), LocalizationStatus::Lost { .. }), "{:?}", filter.status());
}

/// A vehicle between two equal rooms: both hypotheses are there, and the estimate says how far off it may be.
#[test]
fn two_places_that_look_alike_are_two_hypotheses() {
    let mut map = Grid::filled(GridLayout::new(162, 82, 0.05, Se2::identity()).unwrap(), CellState::Free);
    for x in 0..162 {
        for y in 0..82 {
            if x % 80 < 2 || !(2..80).contains(&y) || (x % 80 > 60 && y > 55) {
                map.set(Cell::new(x, y), CellState::Occupied);
            }
        }
    }
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.05)).unwrap();
    let mut amcl = Amcl::new(motion, sensor, FreeSpace::new(&map, 0.2).unwrap(), params(), Seed(1)).unwrap();
    amcl.initialize(&PoseBelief::Anywhere).unwrap();
    let scan = scan_from(&map, &Se2::new(1.5, 1.5, 0.3));
    for _ in 0..6 {
        amcl.request_update();
        amcl.update(&scan).unwrap();
    }
    let mut found: Vec<(f64, f64)> =
        amcl.hypotheses().iter().filter(|h| h.weight > 0.2).map(|h| (h.pose.mean().x(), h.weight)).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert_eq!(found.len(), 2, "{found:?}");
    assert!((found[0].0 - 1.5).abs() < 0.2 && (found[1].0 - 5.5).abs() < 0.2, "{found:?}");
    assert!(amcl.estimate().unwrap().pose.position_deviation() > 1.0);
    let mut copied = Vec::new();
    amcl.hypotheses_into(&mut copied);
    assert_eq!(copied, amcl.hypotheses());
}

/// A laser, and codes on the floor.
#[derive(Clone)]
struct Sensors(LikelihoodFieldModel);

impl WeighParticles<LaserScan> for Sensors {
    fn weigh(&mut self, scan: &LaserScan, poses: &[Se2], out: &mut [f64], par: Par) -> Result<(), SkipReason> {
        self.0.weigh(scan, poses, out, par)
    }
}

impl WeighParticles<PoseObservation<Se2>> for Sensors {
    fn weigh(&mut self, code: &PoseObservation<Se2>, poses: &[Se2], out: &mut [f64], _: Par) -> Result<(), SkipReason> {
        let seen = code.map_from_base();
        let information = seen.covariance().try_inverse().ok_or(SkipReason::Unexplained)?;
        for (value, pose) in out.iter_mut().zip(poses) {
            let residual = pose.minus(seen.mean());
            *value = ((-0.5 * residual.dot(&(information * residual))).exp() + 1e-3).ln();
        }
        Ok(())
    }
}

#[test]
fn one_code_brings_the_belief_to_where_it_is() {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let sensors = Sensors(LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap());
    let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.05)).unwrap();
    let space = FreeSpace::new(&map, 0.2).unwrap().largest();
    let mut amcl = Amcl::new(motion, sensors, space, params(), Seed(1)).unwrap();
    amcl.initialize(&around(Se2::new(HERE.0, HERE.1, HERE.2))).unwrap();
    let there = Se2::new(THERE.0, THERE.1, THERE.2);
    let spread = Matrix3::from_diagonal(&Vector3::new(25e-6, 25e-6, 76e-6));
    let code = PoseObservation::new(Stamp::default(), UncertainPose::new(there, spread).unwrap());
    assert!(matches!(amcl.update(&code), Ok(UpdateOutcome::Applied(_))));
    let estimate = amcl.estimate().unwrap();
    assert!(estimate.map_from_base().minus(&there).norm() < 0.02, "{estimate:?}");
    assert!(amcl.diagnostics().fresh > amcl.particles().len() / 2);
    // One that agrees brings a share as well.
    amcl.request_update();
    amcl.update(&code).unwrap();
    let fresh = amcl.diagnostics().fresh as f64 / amcl.particles().len() as f64;
    assert!((fresh - 0.3).abs() < 0.01, "{fresh}");
}

/// Proposes what is no pose.
struct Nowhere;

impl<Z: ?Sized, S> PoseProposal<Z, S> for Nowhere {
    fn propose(&mut self, _: &Z, _: &mut S, _: &ProposalContext<'_>, poses: &mut [Se2]) -> usize {
        poses.fill(Se2::new(f64::NAN, 0.0, 0.0));
        poses.len() + 7
    }

    fn share(&self, _: &Z, _: &UncertainPose<Se2>, _: f64) -> f64 {
        f64::NAN
    }
}

struct AlwaysNowhere;

impl<Z: ?Sized, S> PoseProposal<Z, S> for AlwaysNowhere {
    fn propose(&mut self, z: &Z, s: &mut S, context: &ProposalContext<'_>, poses: &mut [Se2]) -> usize {
        Nowhere.propose(z, s, context, poses)
    }

    fn share(&self, _: &Z, _: &UncertainPose<Se2>, _: f64) -> f64 {
        7.0
    }
}

#[test]
fn proposals_that_are_no_poses_are_dropped() {
    let map = room();
    let here = Se2::new(HERE.0, HERE.1, HERE.2);
    let scan = scan_from(&map, &here);
    let mut one = filter(1).with_proposal(Nowhere);
    one.initialize(&around(here)).unwrap();
    one.update(&scan).unwrap();
    let mut other = filter(1).with_proposal(AlwaysNowhere);
    other.initialize(&around(here)).unwrap();
    other.update(&scan).unwrap();
    for particles in [one.particles(), other.particles()] {
        assert!(particles.states().iter().all(LieGroup::is_finite) && particles.len() >= 400);
    }
    let mut anywhere = filter(1).with_proposal(UniformProposal);
    anywhere.initialize(&around(here)).unwrap();
    assert!(matches!(anywhere.update(&scan), Ok(UpdateOutcome::Applied(_))));
}

#[test]
fn it_keeps_the_laws_of_its_role() {
    let here = Se2::new(HERE.0, HERE.1, HERE.2);
    laws::localizer(&mut filter(1), &here, &Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.02)), &step()).unwrap();
    let mut filter = filter(1);
    filter.initialize(&around(here)).unwrap();
    let empty = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![]).unwrap();
    laws::correct(&mut filter, &empty).unwrap();
    assert!(matches!(filter.update(&empty), Ok(UpdateOutcome::Skipped(SkipReason::TooFewReadings { .. }))));
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let mut filter = filter(1);
    let scan = scan_from(&room(), &Se2::new(HERE.0, HERE.1, HERE.2));
    assert_eq!(filter.update(&scan), Err(LocalizationError::NotInitialized));
    filter.initialize(&around(Se2::new(HERE.0, HERE.1, HERE.2))).unwrap();
    let before = (filter.particles().clone(), filter.estimate(), filter.hypotheses().to_vec());
    assert_eq!(before.0.len(), 2000);
    let far = filter.initialize(&around(Se2::new(500.0, 0.0, 0.0)));
    assert!(matches!(far, Err(LocalizationError::OffMap { .. })));
    assert!((filter.particles().clone(), filter.estimate(), filter.hypotheses().to_vec()) == before);
    let good = params();
    for bad in [
        AmclParams { particles: 0, ..good },
        AmclParams { particles: 6000, ..good },
        AmclParams { tempering: TemperingParams { target: 1.5, ..good.tempering }, ..good },
        AmclParams { tempering: TemperingParams { collapse: f64::NAN, ..good.tempering }, ..good },
        AmclParams { kld: KldParams { min_particles: 0, ..good.kld }, ..good },
        AmclParams { recovery: RecoveryParams { max_share: 2.0, ..good.recovery }, ..good },
    ] {
        assert!(filter_with(&bad, 0).is_err(), "{bad:?}");
    }
}
