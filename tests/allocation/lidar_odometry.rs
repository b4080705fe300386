//! Lidar odometry: a vehicle goes to and fro between two places, so that the map does not grow for ever.

use crate::{counter, scenes::clouds};
use agv_nav::core::{compute::Seed, geometry::LieGroup, roles::LidarOdometry};
use agv_nav::ndt::{
    gicp::{PointParams, PointRegistration},
    loam::{LoamOdometry, LoamParams, LoamSolve, LoamTarget},
    ndt::{NdtParams, NdtRegistration},
    odometry::{Follow, FollowParams},
    places::{ScanContext, ScanContextParams, ScanContexts},
    preprocess::{GroundFilter, GroundParams, OutlierFilter, OutlierParams},
};
use agv_sim::{CloudPair, LidarParams};

/// Rounds to and fro before and while it is counted.
const ROUNDS: usize = 6;

fn count_again(odometry: &mut dyn LidarOdometry, pair: CloudPair) -> usize {
    let CloudPair { target, source, target_from_source } = pair;
    let round = |odometry: &mut dyn LidarOdometry| {
        for (cloud, prior) in [(&target, target_from_source.inverse()), (&source, target_from_source)] {
            assert!(odometry.process(cloud, Some(&prior)).unwrap().alignment.is_none_or(|a| a.converged()));
        }
    };
    (0..ROUNDS).for_each(|_| round(odometry));
    counter::count(|| (0..ROUNDS).for_each(|_| round(odometry)))
}

#[test]
fn edges_and_surfaces() {
    let lines = CloudPair::in_factory(LidarParams { columns: 900, ..LidarParams::hdl32() }, Seed(3)).unwrap();
    for (target, solve) in [
        (LoamTarget::LocalMap, LoamSolve::Joint),
        (LoamTarget::LastCloud, LoamSolve::Joint),
        (LoamTarget::LocalMap, LoamSolve::TwoStep),
        (LoamTarget::LastCloud, LoamSolve::TwoStep),
        (LoamTarget::LastCloudThenMap, LoamSolve::TwoStep),
    ] {
        let params = LoamParams { target, solve, ..LoamParams::default() };
        assert_eq!(count_again(&mut LoamOdometry::new(params).unwrap(), lines.clone()), 0, "{target:?} {solve:?}");
    }
}

#[test]
fn registrations() {
    let params = FollowParams::default();
    let ndt = NdtRegistration::new(NdtParams::default()).unwrap();
    assert_eq!(count_again(&mut Follow::new(ndt, params).unwrap(), clouds::pair()), 0);
    let generalized = PointRegistration::new(PointParams::default()).unwrap();
    assert_eq!(count_again(&mut Follow::new(generalized, params).unwrap(), clouds::pair()), 0);
}

#[test]
fn places() {
    let clouds = clouds::pair();
    let mut places = ScanContexts::new(ScanContextParams::default()).unwrap();
    let (mut here, mut found) = (ScanContext::default(), Vec::new());
    for _ in 0..20 {
        places.describe_into(&clouds.target, &mut here);
        places.push(&here);
    }
    let mut once = || {
        places.describe_into(&clouds.source, &mut here);
        places.find_into(&here, |place| place % 2 == 0, &mut found);
        assert_eq!(found.len(), 10);
    };
    once();
    assert_eq!(counter::count(once), 0);
}

#[test]
fn ground_and_outliers() {
    let cloud = clouds::pair().target;
    let (mut work, mut marked) = (cloud.clone(), Vec::new());
    let mut ground = GroundFilter::new(GroundParams::default()).unwrap();
    let mut outliers = OutlierFilter::new(OutlierParams::default()).unwrap();
    let mut once = || {
        ground.by_plane_into(&cloud, &mut marked);
        work.copy_from(&cloud);
        outliers.filter(&mut work, agv_nav::core::compute::Par::Seq);
    };
    once();
    assert_eq!(counter::count(once), 0);
}
