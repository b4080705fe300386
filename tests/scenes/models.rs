//! The models that a particle filter exchanges, in the shared room.

use super::{room, start};
use agv_nav::core::{
    geometry::{LieGroup, Se2, UncertainPose, UncertainVector},
    grid::{GaussianGrid, GaussianParams, LikelihoodField, LikelihoodFieldParams, UnknownSpace},
    nalgebra::{Matrix3, Vector2},
    odometry::OdometryIncrement,
    sensors::{LandmarkObservation, LaserScan, MarkerObservation},
    time::Stamp,
};
use agv_nav::filters::particle::{
    AckermannOdometryModel, AckermannOdometryParams, BeamModel, BeamModelParams, BeamSkipping, BeamSkippingParams,
    LandmarkModel, LandmarkModelParams, LikelihoodFieldModel, LikelihoodFieldModelParams, MarkerModel,
    MarkerModelParams, MotionModel, Multinomial, NdtMapModel, NdtMapModelParams, OmnidirectionalNoise,
    OmnidirectionalOdometryModel, PriorMotionModel, PriorNoise, Resampler, Residual, Stratified, VelocityModel,
    VelocityNoise, WeighParticles,
};

type Named<T> = (&'static str, T);

/// Every model of scans but the likelihood field, which the filter of the other tests has; beam skipping is around it.
pub(crate) fn scan_models() -> Vec<Named<Box<dyn WeighParticles<LaserScan> + Send>>> {
    let map = room();
    let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
    let field = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default()).unwrap();
    let skipping = BeamSkippingParams { distance: 0.1, converged_within: 10.0, threshold: 0.5, ..Default::default() };
    let distributions = GaussianGrid::from_map(&map, 0.5, GaussianParams::default()).unwrap();
    let beam = BeamModelParams { unknown: UnknownSpace::Uniform, ..Default::default() };
    vec![
        ("BeamSkipping", Box::new(BeamSkipping::new(field, &map, skipping).unwrap())),
        ("NdtMapModel", Box::new(NdtMapModel::new(&distributions, NdtMapModelParams::default()).unwrap())),
        ("BeamModel", Box::new(BeamModel::new(&map, beam).unwrap())),
    ]
}

/// Four reflectors, seen from the start; every other by its number.
pub(crate) fn landmarks() -> (LandmarkModel, Vec<LandmarkObservation>) {
    let places = [(8.0, 1.0), (6.0, 5.0), (2.0, 5.0), (0.0, 3.0)].map(|(x, y)| Vector2::new(x, y));
    let model = LandmarkModel::new((0..).zip(places), LandmarkModelParams::default()).unwrap();
    let see = |(id, place): (u32, &Vector2<f64>)| {
        let towards = start().inverse().act(place);
        let reading = Vector2::new(towards.norm(), towards.y.atan2(towards.x));
        let reading = UncertainVector::from_sigmas(reading, &Vector2::new(0.05, 0.01)).unwrap();
        LandmarkObservation::new(Stamp::default(), Some(id).filter(|id| id % 2 == 0), reading).unwrap()
    };
    (model, (0..).zip(&places).map(see).collect())
}

/// A code beside the start, and one of the same number elsewhere.
pub(crate) fn codes() -> (MarkerModel, Vec<MarkerObservation<Se2>>) {
    let code = Se2::new(4.1, 0.9, 0.5);
    let codes = [code, Se2::new(2.0, 2.0, 1.0)].map(|pose| (7, UncertainPose::exact(pose)));
    let seen = MarkerObservation::new(Stamp::default(), 7, UncertainPose::exact(start().between(&code)));
    (MarkerModel::new(codes, MarkerModelParams::default()).unwrap(), vec![seen])
}

/// The motion models that the filter of the other tests does not have, with a motion that states its covariance; `body` is
/// called with each.
pub(crate) fn for_each_motion_model(mut body: impl MotionBody) {
    let step = Se2::new(0.25, 0.01, 0.1);
    let motion = OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &step).unwrap();
    let motion = OdometryIncrement { covariance: Matrix3::identity() * 1e-4, ..motion };
    let omnidirectional = OmnidirectionalOdometryModel::new(OmnidirectionalNoise::default()).unwrap();
    body.call("OmnidirectionalOdometryModel", &omnidirectional, &motion);
    let steered = AckermannOdometryModel::new(AckermannOdometryParams::default()).unwrap();
    body.call("AckermannOdometryModel", &steered, &motion);
    body.call("VelocityModel", &VelocityModel::new(VelocityNoise::default()).unwrap(), &motion);
    body.call("PriorMotionModel", &PriorMotionModel::new(PriorNoise::default()).unwrap(), &motion);
}

/// What is done with every motion model: closures cannot be generic.
pub(crate) trait MotionBody {
    fn call(&mut self, name: &str, model: &impl MotionModel<Motion = OdometryIncrement>, motion: &OdometryIncrement);
}

/// The resamplers that the filter of the other tests does not have.
pub(crate) fn resamplers() -> Vec<Named<Box<dyn Resampler>>> {
    vec![("Multinomial", Box::new(Multinomial)), ("Stratified", Box::new(Stratified)), ("Residual", Box::new(Residual))]
}
