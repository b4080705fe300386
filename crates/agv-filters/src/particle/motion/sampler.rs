//! Draws of a turn, a straight run with a drift to its side, and a turn, for one particle or many.
//!
//! The mean turns are composed as they are; only the noise, a small angle, needs a sine. For many particles the random bits are
//! drawn first, in the order of the particles, and the rest is arithmetic that the compiler vectorises for the machine that it
//! finds at run time: the same operations as for one, and the same bits.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{
    super::{
        normal,
        trig::{SERIES_LIMIT, series},
    },
    differential::{NoisyParts, small_turn},
};
use agv_core::{
    compute::Stream,
    geometry::{LieGroup, Se2, So2},
};
use nalgebra::{UnitComplex, Vector2, Vector4};
use pulp::{Arch, Simd, WithSimd};

/// Particles whose noise is drawn before they move.
const BLOCK: usize = 128;

/// A motion taken apart, with all that does not depend on the particle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sampler {
    first: So2,
    last: So2,
    /// The mean run, and the drift to its left.
    run: f64,
    drift: f64,
    /// Standard deviations of the first turn, the run, the last turn and the drift.
    sigma: Vector4<f64>,
}

impl Sampler {
    pub(super) fn new(&NoisyParts { parts, drift, sigma }: &NoisyParts) -> Self {
        let (first, last) = (So2::from_angle(parts.rotation1), So2::from_angle(parts.rotation2));
        Self { first, last, run: parts.translation, drift, sigma }
    }

    /// Noise of the first turn, the run, the last turn and the drift.
    #[inline]
    pub(super) fn draw(&self, stream: &mut Stream) -> [f64; 4] {
        let ([first, run], [last, drift]) = (normal::pair(stream), normal::pair(stream));
        let sigma = &self.sigma;
        [sigma[0] * first, sigma[1] * run, sigma[2] * last, sigma[3] * drift]
    }

    /// Where the motion ends, given the noise of its parts.
    #[inline(always)]
    pub(super) fn moved(&self, pose: &Se2, run: f64, drift: f64, first: &So2, last: &So2) -> Se2 {
        let heading = pose.rotation().compose(&self.first).compose(first);
        let travel = heading.act(&Vector2::new(self.run + run, self.drift + drift));
        Se2::from_parts(pose.translation() + travel, heading.compose(&self.last).compose(last))
    }

    /// Moves many particles.
    pub(super) fn propagate(&self, poses: &[Se2], moved: &mut [Se2], stream: &mut Stream, arch: Arch) {
        let mut bits = [[0_u32; BLOCK]; 4];
        for (poses, moved) in poses.chunks(BLOCK).zip(moved.chunks_mut(BLOCK)) {
            let [a, b, c, d] = &mut bits;
            for ((a, b), (c, d)) in a.iter_mut().zip(b).zip(c.iter_mut().zip(d)).take(poses.len()) {
                [*a, *b] = normal::word(stream);
                [*c, *d] = normal::word(stream);
            }
            arch.dispatch(Moves { sampler: self, bits: &bits, poses, moved });
        }
    }

    /// The noise of a block, as [`draw`](Self::draw) has it.
    #[inline(always)]
    fn noise(&self, [a, b, c, d]: &[[u32; BLOCK]; 4]) -> Noise {
        let mut noise = Noise { first: [0.0; BLOCK], run: [0.0; BLOCK], last: [0.0; BLOCK], drift: [0.0; BLOCK] };
        let sigma = &self.sigma;
        for i in 0..BLOCK {
            let ([first, run], [last, drift]) = (normal::from_bits(a[i], b[i]), normal::from_bits(c[i], d[i]));
            (noise.first[i], noise.run[i]) = (sigma[0] * f64::from(first), sigma[1] * f64::from(run));
            (noise.last[i], noise.drift[i]) = (sigma[2] * f64::from(last), sigma[3] * f64::from(drift));
        }
        noise
    }
}

/// [`small_turn`] of an angle up to [`SERIES_LIMIT`].
#[inline(always)]
fn smaller_turn(angle: f64) -> So2 {
    let (sin, cos) = series(angle);
    UnitComplex::from_cos_sin_unchecked(cos, sin).into()
}

/// The noise of a block of particles: of both turns in radians, of the run and the drift in metres.
struct Noise {
    first: [f64; BLOCK],
    run: [f64; BLOCK],
    last: [f64; BLOCK],
    drift: [f64; BLOCK],
}

/// The moves of a block, compiled once for each instruction set.
struct Moves<'a> {
    sampler: &'a Sampler,
    bits: &'a [[u32; BLOCK]; 4],
    poses: &'a [Se2],
    moved: &'a mut [Se2],
}

impl WithSimd for Moves<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { sampler, bits, poses, moved } = self;
        let noise = sampler.noise(bits);
        let turns = noise.first[..poses.len()].iter().chain(&noise.last[..poses.len()]);
        let small: usize = turns.map(|turn| usize::from(turn.abs() <= SERIES_LIMIT)).sum();
        let turns = noise.first.iter().zip(&noise.last);
        let draws = turns.zip(noise.run.iter().zip(&noise.drift));
        if small == 2 * poses.len() {
            for ((moved, pose), ((&first, &last), (&run, &drift))) in moved.iter_mut().zip(poses).zip(draws) {
                *moved = sampler.moved(pose, run, drift, &smaller_turn(first), &smaller_turn(last));
            }
        } else {
            for ((moved, pose), ((&first, &last), (&run, &drift))) in moved.iter_mut().zip(poses).zip(draws) {
                *moved = sampler.moved(pose, run, drift, &small_turn(first), &small_turn(last));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::particle::{DifferentialOdometryModel, MotionModel, OdometryNoise, simd};
    use agv_core::{compute::Seed, geometry::Se2, odometry::OdometryIncrement, time::Stamp};
    use proptest::prelude::*;

    proptest! {
        /// Many or one at a time, for noise of any size and on any instruction set: the same bits.
        #[test]
        fn many_move_as_each_of_them(alpha in prop_oneof![Just(0.0), 0.0..0.5_f64, 1.0..9.0_f64],
            x in -0.5..0.5_f64, yaw in -1.0..1.0_f64, count in 1_usize..300) {
            let poses: Vec<Se2> = (0..count).map(|i| Se2::new(i as f64, -1.0, 0.1 * i as f64)).collect();
            let model = DifferentialOdometryModel::new(OdometryNoise::uniform(alpha)).unwrap();
            let stamp = Stamp::default();
            let motion = OdometryIncrement::between(stamp, &Se2::default(), stamp, &Se2::new(x, 0.02, yaw)).unwrap();
            let mut stream = Seed(3).stream(0, 0);
            let sample = model.condition(&motion);
            let single: Vec<Se2> = poses.iter().map(|pose| sample(pose, &mut stream)).collect();
            let mut many = poses.clone();
            let mut stream_of_many = Seed(3).stream(0, 0);
            model.propagate(&motion, &poses, &mut many, &mut stream_of_many);
            prop_assert!(many == single && stream_of_many == stream);
            for arch in simd::archs() {
                let sampler = super::Sampler::new(&model.take_apart(&motion.start_from_end));
                sampler.propagate(&poses, &mut many, &mut Seed(3).stream(0, 0), arch);
                prop_assert!(many == single, "{:?}", arch);
            }
        }
    }
}
