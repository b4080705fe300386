//! Registration of clouds.

use crate::{counter, scenes::clouds};
use agv_nav::core::{
    geometry::{LieGroup, Se3, So3},
    nalgebra::Vector3,
    roles::Registration,
};
use agv_nav::ndt::{
    gicp::{PointMetric, PointParams, PointRegistration},
    ndt::{NdtParams, NdtRegistration, VoxelSearch},
    registration::Optimizer,
};
use agv_sim::CloudPair;

/// Aligns twice from far away, which meets more voxels than the next does, and counts while the map is built anew and the same is
/// done from guesses nearby.
fn count_again(registration: &mut dyn Registration) -> usize {
    let CloudPair { target, source, target_from_source } = clouds::pair();
    let off = |x: f64, yaw: f64| {
        let offset = Se3::from_parts(Vector3::new(x, 0.4 * x, 0.1 * x), So3::from_roll_pitch_yaw(0.0, 0.0, yaw));
        target_from_source * offset
    };
    for guess in [off(1.2, 0.2), off(-1.2, -0.2)] {
        registration.set_target(&target).unwrap();
        registration.align(&source, &guess).unwrap();
    }
    let mut found = None;
    let count = counter::count(|| {
        registration.set_target(&target).unwrap();
        for guess in [off(-0.4, 0.03), off(0.3, -0.05), Se3::identity()] {
            found = Some(registration.align(&source, &guess).unwrap());
        }
    });
    assert!((found.unwrap().target_from_source.minus(&target_from_source)).norm() < 0.05, "{found:?}");
    count
}

#[test]
fn normal_distributions() {
    for search in [VoxelSearch::Direct7, VoxelSearch::Direct8, VoxelSearch::Radius] {
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
