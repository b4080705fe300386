//! Key frames, loops, and the maps that they make.

use crate::digest::{Digest, assert_same_bits};
use agv_nav::core::compute::Seed;
use agv_nav::ndt::ndt::{NdtParams, NdtRegistration};
use agv_nav::pipeline::mapping::{KeyFrameMapper, KeyFrameParams};
use laps::{Drift, Laps};

#[path = "../scenes/laps.rs"]
mod laps;

#[test]
fn closed_loops() {
    let site = laps::hall(22.0, 9.0, 0.8, Seed(1));
    let laps = Laps::around(&site, 120, Drift { scale: 0.01, heading: 0.003 }, Seed(1));
    assert_same_bits("KeyFrameMapper", |par| {
        let registration = NdtRegistration::new(NdtParams::default()).unwrap().with_parallelism(par);
        let mut mapper =
            KeyFrameMapper::new(registration, KeyFrameParams { distance: 2.5, ..Default::default() }).unwrap();
        let mut closures = 0;
        for (index, cloud) in laps.clouds.iter().enumerate() {
            closures += mapper.process(&laps.step(index), cloud).unwrap().closures;
        }
        assert!(closures > 0);
        let numbers = mapper.map().trajectory().flat_map(|(_, pose)| {
            let (translation, rotation) = (pose.translation(), pose.rotation().matrix());
            translation.iter().chain(rotation.iter()).map(|number| number.to_bits()).collect::<Vec<_>>()
        });
        let cloud = mapper.map().thinned_cloud(0.5).unwrap();
        Digest::new().bits(numbers).singles(cloud.x()).singles(cloud.z())
    });
}
