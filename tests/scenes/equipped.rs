//! A vehicle with two lasers and a camera that reads codes on the floor, in the shared room.

use super::{ahead, circle_step, room, seen, start};
use agv_nav::core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, UncertainPose},
    grid::{LikelihoodField, LikelihoodFieldParams},
    nalgebra::Matrix3,
    odometry::OdometryIncrement,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
    sensors::{LaserScan, MarkerObservation, ScanGeometry, SensorId},
    time::Stamp,
};
use agv_nav::filters::{
    marker::{MarkerLocalizer, MarkerLocalizerParams, MarkerMap},
    particle::{
        Amcl, AmclParams, DifferentialOdometryModel, FreeSpace, KldParams, LikelihoodFieldModel,
        LikelihoodFieldModelParams, LikelihoodSearch, LikelihoodSearchParams, MarkerModel, MarkerModelParams,
        MarkerProposal, OdometryNoise, Sensors,
    },
};
use std::f64::consts::PI;

type Models = Sensors<LikelihoodFieldModel, Option<MarkerModel>>;

/// Scans weigh it, codes too, and lost particles are drawn from either.
pub(crate) type EquippedFilter = Amcl<DifferentialOdometryModel, Models, MarkerProposal<LikelihoodSearch>>;

/// What a step brings.
pub(crate) struct Step {
    odometry: OdometryIncrement,
    scans: [LaserScan; 2],
    code: Option<MarkerObservation<Se2>>,
}

/// Every fourth step ends at a code.
const CODE_PITCH: usize = 4;

fn places(steps: usize) -> impl Iterator<Item = Se2> {
    (0..steps).scan(start(), |pose, _| {
        *pose = *pose * circle_step().start_from_end;
        Some(*pose)
    })
}

/// Codes along the first round of the circle.
fn codes() -> impl Iterator<Item = (u32, Se2)> {
    (0..).zip(places(32).skip(CODE_PITCH - 1).step_by(CODE_PITCH))
}

/// The circle, by a laser that looks ahead, one that looks back from the tail, and codes.
pub(crate) fn round(steps: usize) -> Vec<Step> {
    let map = room();
    let back = ScanGeometry { base_from_sensor: Se2::new(-0.2, 0.0, PI), sensor: SensorId(1), ..ahead() };
    let step = |(index, pose): (usize, Se2)| {
        let code = (index % CODE_PITCH == CODE_PITCH - 1).then(|| codes().nth(index / CODE_PITCH)).flatten();
        let see = |(id, code): (u32, Se2)| {
            let lies = UncertainPose::new(pose.between(&code), Matrix3::identity() * 1e-4).unwrap();
            MarkerObservation::new(Stamp::default(), id, lies)
        };
        Step {
            odometry: circle_step(),
            scans: [ahead(), back].map(|laser| seen(&map, &pose, laser)),
            code: code.map(see),
        }
    };
    places(steps).enumerate().map(step).collect()
}

/// A filter for a vehicle that may be anywhere.
pub(crate) fn filter(par: Par) -> EquippedFilter {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let scans = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let exact = codes().map(|(id, pose)| (id, UncertainPose::exact(pose)));
    let markers = Some(MarkerModel::new(exact, MarkerModelParams::default()).unwrap());
    let localizer = MarkerMap::from_exact(codes()).unwrap();
    let localizer = MarkerLocalizer::new(localizer, MarkerLocalizerParams::default()).unwrap();
    let search = LikelihoodSearch::new(LikelihoodSearchParams::default()).unwrap();
    let motion = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
    let kld = KldParams { max_particles: 4000, ..Default::default() };
    let (sensors, params) = (Sensors { scans, markers, landmarks: () }, AmclParams { kld, ..Default::default() });
    let amcl = Amcl::new(motion, sensors, FreeSpace::new(&map, 0.2).unwrap(), params, Seed(7)).unwrap();
    let mut filter = amcl.with_proposal(MarkerProposal::new(localizer, search)).with_parallelism(par);
    filter.initialize(&PoseBelief::Anywhere).unwrap();
    filter
}

/// How many updates by the second laser, and how many by codes, were applied.
pub(crate) fn run(filter: &mut EquippedFilter, steps: &[Step]) -> (usize, usize) {
    let (mut by_second, mut by_code) = (0, 0);
    for step in steps {
        filter.predict(&step.odometry).unwrap();
        assert!(matches!(filter.update(&step.scans[0]), Ok(UpdateOutcome::Applied(_))));
        by_second += usize::from(matches!(filter.update(&step.scans[1]), Ok(UpdateOutcome::Applied(_))));
        if let Some(code) = &step.code {
            by_code += usize::from(matches!(filter.update(code), Ok(UpdateOutcome::Applied(_))));
        }
    }
    (by_second, by_code)
}
