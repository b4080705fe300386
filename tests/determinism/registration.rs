//! Registration of clouds.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::clouds,
};
use agv_nav::core::{
    geometry::{LieGroup, Se3},
    nalgebra::Matrix6,
    roles::{Alignment, Correct, Localizer, PoseBelief, Registration},
};
use agv_nav::ndt::{
    gicp::{PointParams, PointRegistration},
    ndt::{DistributionRegistration, NdtLocalizer, NdtLocalizerParams, NdtMap, NdtParams, NdtRegistration},
};

fn digest(found: &Alignment<Se3>) -> Digest {
    let (translation, rotation) =
        (found.target_from_source.translation(), found.target_from_source.rotation().matrix());
    let numbers = translation.iter().chain(rotation.iter()).chain(found.information.iter());
    let numbers = numbers.copied().chain([found.score, found.inlier_ratio]).map(f64::to_bits);
    Digest::new().bits(numbers).integers([found.iterations as i64])
}

#[test]
fn normal_distributions() {
    let pair = clouds::pair();
    assert_same_bits("NdtRegistration", |par| {
        let mut ndt = NdtRegistration::new(NdtParams::default()).unwrap().with_parallelism(par);
        ndt.set_target(&pair.target).unwrap();
        digest(&ndt.align(&pair.source, &Se3::identity()).unwrap())
    });
}

#[test]
fn distributions() {
    let pair = clouds::pair();
    assert_same_bits("DistributionRegistration", |par| {
        let mut ndt = DistributionRegistration::new(NdtParams::default()).unwrap().with_parallelism(par);
        ndt.set_target(&pair.target).unwrap();
        digest(&ndt.align(&pair.source, &Se3::identity()).unwrap())
    });
}

#[test]
fn localization_in_a_map() {
    let (pair, params) = (clouds::pair(), NdtLocalizerParams::default());
    let mut map = NdtMap::new(params.ndt.voxels).unwrap();
    map.insert(&pair.target, &pair.target.base_from_sensor());
    let around = PoseBelief::around(Se3::default(), Matrix6::identity() * 0.25).unwrap();
    assert_same_bits("NdtLocalizer", |par| {
        let mut localizer = NdtLocalizer::new(&map, params).unwrap().with_parallelism(par);
        localizer.initialize(&around).unwrap();
        localizer.update(&pair.source).unwrap();
        let estimate = localizer.estimate().unwrap();
        let covariance = estimate.covariance().iter().copied().map(f64::to_bits);
        digest(localizer.alignment().unwrap()).bits(covariance)
    });
}

#[test]
fn closest_points() {
    let pair = clouds::pair();
    assert_same_bits("PointRegistration", |par| {
        let mut icp = PointRegistration::new(PointParams::default()).unwrap().with_parallelism(par);
        icp.set_target(&pair.target).unwrap();
        digest(&icp.align(&pair.source, &Se3::identity()).unwrap())
    });
}
