//! Registration of clouds.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::clouds,
};
use agv_nav::core::{
    geometry::{LieGroup, Se3},
    roles::{Alignment, Registration},
};
use agv_nav::ndt::{
    gicp::{PointParams, PointRegistration},
    ndt::{NdtParams, NdtRegistration},
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
fn closest_points() {
    let pair = clouds::pair();
    assert_same_bits("PointRegistration", |par| {
        let mut icp = PointRegistration::new(PointParams::default()).unwrap().with_parallelism(par);
        icp.set_target(&pair.target).unwrap();
        digest(&icp.align(&pair.source, &Se3::identity()).unwrap())
    });
}
