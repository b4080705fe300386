//! Registration of clouds.

use crate::{counter, scenes::clouds};
use agv_nav::core::{
    geometry::{LieGroup, Se3},
    roles::Registration,
};
use agv_nav::ndt::{
    gicp::{PointMetric, PointParams, PointRegistration},
    ndt::{NdtParams, NdtRegistration, VoxelSearch},
    registration::Optimizer,
};

/// Aligns once, and counts while the same is done again from elsewhere; the map is built anew in between.
fn count_again(registration: &mut dyn Registration) -> usize {
    let clouds::CloudPair { target, source, target_from_source } = clouds::pair();
    registration.set_target(&target).unwrap();
    registration.set_target(&target).unwrap();
    registration.align(&source, &Se3::identity()).unwrap();
    let mut found = None;
    let count = counter::count(|| {
        registration.set_target(&target).unwrap();
        found = Some(registration.align(&source, &Se3::identity()).unwrap());
    });
    assert!((found.unwrap().target_from_source.minus(&target_from_source)).norm() < 0.05, "{found:?}");
    count
}

#[test]
fn normal_distributions() {
    for search in [VoxelSearch::Direct7, VoxelSearch::Radius] {
        for optimizer in [Optimizer::TrustRegion, Optimizer::LineSearch] {
            let params = NdtParams { search, optimizer, ..NdtParams::default() };
            assert_eq!(count_again(&mut NdtRegistration::new(params).unwrap()), 0, "{search:?} {optimizer:?}");
        }
    }
}

#[test]
fn closest_points() {
    for metric in [PointMetric::PointToPlane, PointMetric::Generalized, PointMetric::Voxelized] {
        let params = PointParams { metric, ..PointParams::default() };
        assert_eq!(count_again(&mut PointRegistration::new(params).unwrap()), 0, "{metric:?}");
    }
}
