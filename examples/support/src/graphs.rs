//! Pose graphs that the literature compares solvers on, generated: their truth is known, and they are there without a download.
//!
//! | graph | poses, relations | after |
//! |---|---|---|
//! | [`sphere`] | 2500, 4949 | Kaess et al., *iSAM2*, 2012: up a sphere in rings, each pose seen from the ring below |
//! | [`torus`] | 1000, 1979 | Carlone et al., *Initialization techniques for 3D SLAM*, 2015: around a torus, likewise |
//! | [`manhattan`] | 3500, some 5000 | Olson et al., *Fast iterative alignment of pose graphs*, 2006: a walk along the streets of a city |
//!
//! The guesses are those of odometry, as in the files of the originals; the noise is Gaussian, in the frame of the pose that was
//! looked at.

use crate::g2o::{Edge, G2o};
use agv_core::{
    compute::{Seed, Stream},
    geometry::{LieGroup, Se2, Se3, So3},
    nalgebra::Vector3,
};
use rand::RngExt as _;
use rand_distr::StandardNormal;
use std::{
    collections::BTreeMap,
    f64::consts::{FRAC_PI_2, PI, TAU},
};

/// A generated graph, and the poses that it was measured at.
#[derive(Debug, Clone, PartialEq)]
pub struct World<G: LieGroup> {
    /// The poses as they were, by identity.
    pub truth: Vec<G>,
    /// The graph that odometry would start from; the first pose is where it was.
    pub graph: G2o<G>,
}

/// The sphere: 50 rings of 50 poses on a radius of 50 m, with standard deviations of 0.1 m and 0.02 rad.
pub fn sphere(seed: Seed) -> World<Se3> {
    let (rings, round) = (50, 50);
    let poses = (0..rings * round).map(|i| {
        // From pole to pole, without standing on one of them.
        let latitude = PI * ((f64::from(i) / f64::from(round) + 1.0) / f64::from(rings + 2) - 0.5);
        let around = TAU * f64::from(i) / f64::from(round);
        let out = Vector3::new(latitude.cos() * around.cos(), latitude.cos() * around.sin(), latitude.sin());
        Se3::from_parts(out * 50.0, So3::from_roll_pitch_yaw(0.0, -latitude, around + FRAC_PI_2))
    });
    rounds(poses.collect(), round as usize, [0.1, 0.02], seed)
}

/// The torus: 50 turns of 20 poses around a tube of 5 m along a circle of 20 m, with standard deviations of 0.05 m and 0.02 rad.
pub fn torus(seed: Seed) -> World<Se3> {
    let (turns, round) = (50, 20);
    let poses = (0..turns * round).map(|i| {
        let along = TAU * f64::from(i) / f64::from(turns * round);
        let around = TAU * f64::from(i) / f64::from(round);
        let radius = 20.0 + 5.0 * around.cos();
        let place = Vector3::new(radius * along.cos(), radius * along.sin(), 5.0 * around.sin());
        Se3::from_parts(place, So3::from_roll_pitch_yaw(around, 0.0, along + FRAC_PI_2))
    });
    rounds(poses.collect(), round as usize, [0.05, 0.02], seed)
}

/// The city: 3500 steps of 1 m along streets that cross every 4 m, within 30 m of the middle, and at every second step a sight of
/// where the vehicle stood there before; standard deviations of 0.05 m and 0.02 rad.
pub fn manhattan(seed: Seed) -> World<Se2> {
    let (mut stream, mut truth) = (seed.stream(0, 0), vec![Se2::default()]);
    let (mut x, mut y, mut heading) = (0_i32, 0_i32, 0_u8);
    // Poses by the place where they stand.
    let (mut stood, mut sights) = (BTreeMap::from([((0, 0), vec![0_usize])]), Vec::new());
    while truth.len() < 3500 {
        if x % 4 == 0 && y % 4 == 0 {
            let turned = |turn: u8| (heading + turn) % 4;
            // Ahead, left or right, but not out of the city.
            let ways: Vec<u8> =
                [0, 0, 1, 3].map(turned).into_iter().filter(|way| inside(stepped(x, y, *way))).collect();
            heading = ways[stream.random_range(0..ways.len())];
        }
        (x, y) = stepped(x, y, heading);
        let pose = truth.len();
        truth.push(Se2::new(f64::from(x), f64::from(y), f64::from(heading) * FRAC_PI_2));
        let here = stood.entry((x, y)).or_default();
        if !here.is_empty() && stream.random_bool(0.5) {
            sights.push((here[stream.random_range(0..here.len())], pose));
        }
        here.push(pose);
    }
    measure(truth, &sights, [0.05, 0.02], &mut stream)
}

fn stepped(x: i32, y: i32, heading: u8) -> (i32, i32) {
    match heading {
        0 => (x + 1, y),
        1 => (x, y + 1),
        2 => (x - 1, y),
        _ => (x, y - 1),
    }
}

fn inside((x, y): (i32, i32)) -> bool {
    x.abs() <= 28 && y.abs() <= 28
}

/// Each pose seen from the one of the round before.
fn rounds(truth: Vec<Se3>, round: usize, sigmas: [f64; 2], seed: Seed) -> World<Se3> {
    let sights: Vec<_> = (round..truth.len()).map(|to| (to - round, to)).collect();
    measure(truth, &sights, sigmas, &mut seed.stream(0, 0))
}

/// Measures every step and every sight, with standard deviations of translation and rotation.
fn measure<G: LieGroup>(truth: Vec<G>, sights: &[(usize, usize)], sigmas: [f64; 2], stream: &mut Stream) -> World<G> {
    let sigma = |entry: usize| sigmas[usize::from(entry >= G::TRANSLATION_DOF)];
    let information: Vec<f64> = (0..G::DOF * G::DOF)
        .map(|i| if i % (G::DOF + 1) == 0 { sigma(i / (G::DOF + 1)).powi(-2) } else { 0.0 })
        .collect();
    let information = G::matrix_from_slice(&information);
    let mut edge = |from: usize, to: usize| {
        let noise: Vec<f64> = (0..G::DOF).map(|i| sigma(i) * stream.sample::<f64, _>(StandardNormal)).collect();
        let from_from_to = truth[from].between(&truth[to]).plus(&G::tangent_from_slice(&noise));
        Edge { from: from as u64, to: to as u64, from_from_to, information }
    };
    let mut edges: Vec<Edge<G>> = (1..truth.len()).map(|to| edge(to - 1, to)).collect();
    edges.extend(sights.iter().map(|&(from, to)| edge(from, to)));
    let mut guess = truth[0];
    let odometry = edges[..truth.len() - 1].iter().map(|edge| {
        guess = guess.compose(&edge.from_from_to);
        guess
    });
    let vertices = (0..).zip(std::iter::once(truth[0]).chain(odometry)).collect();
    World { truth, graph: G2o { vertices, edges, fixed: Vec::new() } }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The truth explains the measurements as their noise says: the sum of squares of `n` of them is within five deviations of `n`.
    fn noise_is_as_stated<G: LieGroup>(world: &World<G>, poses: usize, relations: std::ops::RangeInclusive<usize>) {
        assert_eq!((world.truth.len(), world.graph.vertices.len()), (poses, poses));
        let edges = &world.graph.edges;
        assert!(relations.contains(&edges.len()), "{}", edges.len());
        let square = |edge: &Edge<G>| {
            let predicted = world.truth[edge.from as usize].between(&world.truth[edge.to as usize]);
            let error = edge.from_from_to.between(&predicted).log();
            let weighted = edge.information * error;
            G::tangent_slice(&error).iter().zip(G::tangent_slice(&weighted)).map(|(a, b)| a * b).sum::<f64>()
        };
        let (sum, n) = (edges.iter().map(square).sum::<f64>(), (G::DOF * edges.len()) as f64);
        assert!((sum - n).abs() < 5.0 * (2.0 * n).sqrt(), "{sum} of {n}");
        // Neighbours are near: no relation spans the world.
        assert!(edges.iter().all(|edge| G::tangent_slice(&edge.from_from_to.log()).iter().all(|v| v.abs() < 12.0)));
    }

    #[test]
    fn worlds_are_measured_as_they_say() {
        noise_is_as_stated(&sphere(Seed(1)), 2500, 4949..=4949);
        noise_is_as_stated(&torus(Seed(1)), 1000, 1979..=1979);
        noise_is_as_stated(&manhattan(Seed(1)), 3500, 4500..=5500);
        assert_ne!(manhattan(Seed(1)), manhattan(Seed(2)));
    }
}
