//! The models that a particle filter exchanges.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::{
        circle, initialized,
        models::{codes, landmarks, scan_models},
    },
};
use agv_nav::core::compute::Par;
use agv_nav::filters::particle::WeighParticles;

#[test]
fn weighing_does_not_depend_on_threads() {
    // Not a multiple of the chunk, and several chunks per thread.
    let (drive, poses) = (circle(2), initialized(3001, Par::Seq).particles().states().to_vec());
    for (index, (name, _)) in scan_models().into_iter().enumerate() {
        assert_same_bits(name, |par| {
            let (mut model, mut out) = (scan_models().remove(index).1, vec![0.0; poses.len()]);
            let mut digest = Digest::new();
            for (_, scan) in &drive {
                model.weigh(scan, &poses, &mut out, par).unwrap();
                digest = digest.bits(out.iter().map(|l| l.to_bits()));
            }
            digest
        });
    }
    assert_same_bits("LandmarkModel", |par| {
        let ((mut model, seen), mut out) = (landmarks(), vec![0.0; poses.len()]);
        model.weigh(seen.as_slice(), &poses, &mut out, par).unwrap();
        Digest::new().bits(out.iter().map(|l| l.to_bits()))
    });
    assert_same_bits("MarkerModel", |par| {
        let ((mut model, read), mut out) = (codes(), vec![0.0; poses.len()]);
        model.weigh(read.as_slice(), &poses, &mut out, par).unwrap();
        Digest::new().bits(out.iter().map(|l| l.to_bits()))
    });
}
