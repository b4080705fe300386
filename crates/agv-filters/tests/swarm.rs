//! First particles from the improved swarm, in a room in which two places look alike.

#[allow(dead_code, reason = "each test binary uses its part")]
mod room;

use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, UncertainPose},
    grid::{LikelihoodField, LikelihoodFieldParams},
    roles::{LocalizationError, LocalizationStatus, Localizer, SkipReason, UpdateOutcome},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_filters::particle::{
    Amcl, AmclParams, AroundPose, BlendedPoses, DifferentialOdometryModel, FreeSpace, ImprovedSwarm, InitialPoses,
    LikelihoodFieldModel, LikelihoodFieldModelParams, Mcl, OdometryNoise, StratifiedPoses, SwarmParams, UniformPoses,
};
use nalgebra::Matrix3;
use room::Laser;
use std::f64::consts::PI;

type Filter = Mcl<DifferentialOdometryModel, LikelihoodFieldModel>;

const TRUTH: (f64, f64, f64) = (2.0, 1.5, 0.4);

fn models() -> (DifferentialOdometryModel, LikelihoodFieldModel) {
    let field = LikelihoodField::new(&room::room(), LikelihoodFieldParams::default()).unwrap();
    let sensor = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    (DifferentialOdometryModel::new(OdometryNoise::default()).unwrap(), sensor)
}

fn filter(seed: u64) -> Filter {
    let (motion, sensor) = models();
    room::filter(motion, sensor, 500, seed)
}

fn truth() -> Se2 {
    Se2::new(TRUTH.0, TRUTH.1, TRUTH.2)
}

fn scan(seed: u64) -> LaserScan {
    scan_from(&truth(), seed)
}

fn scan_from(pose: &Se2, seed: u64) -> LaserScan {
    Laser::ahead(90).scan(pose, &[], &mut Seed(seed).stream(0, 0))
}

fn swarm<P: InitialPoses>(poses: P) -> ImprovedSwarm<P> {
    ImprovedSwarm::new(poses, SwarmParams::default()).unwrap()
}

/// Particles within half a metre and 20° of the true pose, and of the one that looks alike.
fn near(poses: &[Se2]) -> [usize; 2] {
    near_to(&truth(), poses)
}

fn near_to(truth: &Se2, poses: &[Se2]) -> [usize; 2] {
    let twin = Se2::new(room::ROOM.0 - truth.x(), room::ROOM.1 - truth.y(), truth.yaw() + PI);
    [*truth, twin].map(|place| {
        let is_near = |pose: &&Se2| {
            let off = pose.minus(&place);
            off.xy().norm() < 0.5 && off.z.abs() < 20_f64.to_radians()
        };
        poses.iter().filter(is_near).count()
    })
}

/// Half a metre and 20° around a pose are 2 % of the room and a ninth of the headings: about one particle in 450. Weighed
/// by two scans, each of the two places holds a tenth at least, and still more than one different pose.
///
/// Strata are the same for each seed, to a decimetre and 6°, so the vehicle stands elsewhere each time: which of two like places has a
/// candidate that fits better is chance. A tenth of the particles, 50, are effective, and the share `p` of a place has the deviation
/// `√(p (1 - p) / 50)`, 0.05 for 0.13, of one start; of twenty, 0.011.
#[test]
fn particles_gather_where_the_scans_fit() {
    let (mut plain, mut weighed) = ([0; 2], [0; 2]);
    for seed in 0..20 {
        let step = seed as f64 - 10.0;
        let truth = Se2::new(TRUTH.0 + 0.047 * step, TRUTH.1 + 0.031 * step, TRUTH.2 + 0.02 * step);
        let mut filter = filter(seed);
        let outcome = filter.initialize_swarm::<LaserScan, _>(&ImprovedSwarm::default(), &[]).unwrap();
        assert!(matches!(outcome, UpdateOutcome::Skipped(SkipReason::TooFewReadings { .. })));
        let counts = near_to(&truth, filter.particles().states());
        (0..2).for_each(|i| plain[i] += counts[i]);

        let scans = [2 * seed, 2 * seed + 1].map(|seed| scan_from(&truth, seed));
        let outcome = filter.initialize_swarm(&ImprovedSwarm::default(), &[&scans[0], &scans[1]]).unwrap();
        assert!(matches!(outcome, UpdateOutcome::Applied(_)));
        let states = filter.particles().states();
        let counts = near_to(&truth, states);
        (0..2).for_each(|i| weighed[i] += counts[i]);
        let mut different: Vec<u64> = states.iter().map(|pose| pose.x().to_bits()).collect();
        different.sort_unstable();
        different.dedup();
        assert!(different.len() > 50, "{}", different.len());
        assert_eq!((states.len(), filter.status()), (500, converging(&filter)));
    }
    for i in 0..2 {
        assert!(plain[i] < 60 && weighed[i] > 20 * 50, "{plain:?} {weighed:?}");
    }
}

fn converging(filter: &Filter) -> LocalizationStatus {
    let status = filter.status();
    assert!(matches!(status, LocalizationStatus::Converging { .. }), "{status:?}");
    status
}

/// Without scans the swarm is the distribution that it was given.
#[test]
fn distributions_compose() {
    let mut filter = filter(1);
    let parked = UncertainPose::new(truth(), Matrix3::identity() * 1e-4).unwrap();
    let mut at_home = |start: &dyn Fn(&mut Filter) -> UpdateOutcome| {
        start(&mut filter);
        filter.particles().states().iter().filter(|pose| pose.minus(&truth()).amax() < 0.05).count()
    };
    let around = AroundPose::new(&parked);
    let blend = BlendedPoses::new(around, 0.6, StratifiedPoses).unwrap();
    assert!(blend.is_anywhere() && !around.is_anywhere());
    assert_eq!(at_home(&|f| f.initialize_swarm::<LaserScan, _>(&swarm(around), &[]).unwrap()), 500);
    let blended = at_home(&|f| f.initialize_swarm::<LaserScan, _>(&swarm(blend), &[]).unwrap());
    assert!((300..305).contains(&blended), "{blended}");
    assert!(at_home(&|f| f.initialize_swarm::<LaserScan, _>(&swarm(UniformPoses), &[]).unwrap()) < 5);
    // A scan decides between home and the place that looks alike by what is there: both, and home more.
    let seen = at_home(&|f| f.initialize_swarm(&swarm(blend), &[&scan(3)]).unwrap());
    assert!(seen > 300, "{seen}");
}

/// The adaptive filter finds the room's two places from one scan each, and goes on searching unless it was told where it is.
#[test]
fn an_adaptive_filter_starts_from_a_swarm() {
    let (motion, sensor) = models();
    let space = FreeSpace::new(&room::room(), 0.2).unwrap();
    let mut amcl = Amcl::new(motion, sensor, space, AmclParams::default(), Seed(1)).unwrap();
    amcl.initialize_swarm(&swarm(StratifiedPoses), &[&scan(1)]).unwrap();
    assert!(near(amcl.particles().states()).iter().all(|&count| count > amcl.particles().len() / 20));
    assert_eq!(amcl.hypotheses().len(), 1, "until the next update");
}

#[test]
fn threads_do_not_change_a_bit() {
    let run = |par: Par| {
        let mut filter = filter(3).with_parallelism(par);
        filter.initialize_swarm(&ImprovedSwarm::default(), &[&scan(1)]).unwrap();
        filter.particles().clone()
    };
    assert!(run(Par::Seq) == run(Par::threads(3)));
}

#[test]
fn bad_input_is_refused_and_changes_nothing() {
    let good = SwarmParams::default();
    for bad in [
        SwarmParams { candidates: 0, ..good },
        SwarmParams { candidates: 1001, ..good },
        SwarmParams { effective: 0.0, ..good },
        SwarmParams { effective: 1.1, ..good },
        SwarmParams { effective: f64::NAN, ..good },
    ] {
        assert!(ImprovedSwarm::new(UniformPoses, bad).is_err(), "{bad:?}");
    }
    for bad in [-0.1, 1.1, f64::NAN] {
        assert!(BlendedPoses::new(UniformPoses, bad, StratifiedPoses).is_err());
    }
    let mut filter = filter(1);
    filter.initialize_swarm(&ImprovedSwarm::default(), &[&scan(1)]).unwrap();
    let (before, estimate) = (filter.particles().clone(), filter.estimate());
    let outside = AroundPose::new(&UncertainPose::exact(Se2::new(900.0, 0.0, 0.0)));
    let refused = filter.initialize_swarm(&swarm(outside), &[&scan(1)]);
    assert!(matches!(refused, Err(LocalizationError::OffMap { .. })));
    assert!(*filter.particles() == before && filter.estimate() == estimate);
    // Scans that say nothing leave the swarm unweighed.
    let geometry = *scan(1).geometry();
    for ranges in [vec![], vec![f32::NAN; 90], vec![f32::INFINITY; 90]] {
        let empty = LaserScan::new(Stamp::default(), ScanGeometry { ..geometry }, ranges).unwrap();
        let outcome = filter.initialize_swarm(&ImprovedSwarm::default(), &[&empty]).unwrap();
        assert!(matches!(outcome, UpdateOutcome::Skipped(SkipReason::TooFewReadings { .. })), "{outcome:?}");
        assert!(near(filter.particles().states())[0] < 20);
    }
}
