//! How well a cloud fits at a pose, and which directions it fixes.
//!
//! A point's nearest distribution is the one of the least squared Mahalanobis distance `m`. A point is an inlier if it is
//! no farther than 95 of 100 points of the distribution itself.
//!
//! Which directions are fixed is a question of surfaces, and of the inliers alone: a wall that nothing fits to fixes nothing. A
//! distribution in a wall pulls along the wall too, towards the middle of its voxel, and so the Hessian of a long corridor seems
//! to know the place along it. Each inlier therefore counts with its distribution's information relative to its trace,
//! squared: a surface counts its normal once, and what is ten times as wide
//! counts a hundredth. What that says of directions is in [`Facing`].

use super::kernel::{Block, CHUNK, Frame, LANES, Moved, turn};
use super::objective::ScoreObjective;
use super::search::MAX_BLOCKS;
use crate::cells::pack;
use crate::preprocess::is_one_of_every;
use crate::registration::{Facing, INLIER};
use agv_core::geometry::Se3;
use nalgebra::{Matrix3, Matrix6, Vector3};
use std::ops::Range;

/// One of so many points has its directions summed up: shares need no more.
const STRIDE: usize = 4;

/// What a pose explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    /// Share of the points that are inliers.
    pub(super) inlier_ratio: f64,
    /// Mean over the points near distributions of the likelihood that their nearest one gives them, from 0 to 1.
    pub(super) nearest_likelihood: f64,
    /// Projector onto the directions that are not fixed.
    pub(super) unobserved: Matrix6<f64>,
}

/// Sums over points.
#[derive(Debug, Clone, Copy, Default)]
struct FitSums {
    facing: Facing,
    likelihood: f64,
    inliers: usize,
    matches: usize,
}

impl FitSums {
    fn merged(self, other: Self) -> Self {
        Self {
            facing: self.facing.merged(other.facing),
            likelihood: self.likelihood + other.likelihood,
            inliers: self.inliers + other.inliers,
            matches: self.matches + other.matches,
        }
    }
}

impl ScoreObjective<'_> {
    /// How the source fits at `pose`. A direction among those of the projector `free` that less than `min_share` of the points face
    /// is not observed.
    pub(super) fn fit(&self, pose: &Se3, min_share: f64, free: &Matrix6<f64>) -> Fit {
        let (frame, [x, y, z]) = (self.frame(pose), self.source.coordinates());
        let chunks = x.len().div_ceil(CHUNK);
        let sums = self.par.map_reduce(
            chunks,
            |chunk| {
                let range = chunk * CHUNK..x.len().min((chunk + 1) * CHUNK);
                let mut moved = Moved::new();
                let points = [&x[range.clone()], &y[range.clone()], &z[range.clone()]];
                self.arch.dispatch(
                    #[inline(always)]
                    || turn(&frame, points, &mut moved),
                );
                self.fit_chunk(&frame, &moved, range)
            },
            FitSums::merged,
        );
        let sums = sums.unwrap_or_default();
        Fit {
            inlier_ratio: sums.inliers as f64 / x.len().max(1) as f64,
            nearest_likelihood: sums.likelihood / sums.matches.max(1) as f64,
            unobserved: sums.facing.unobserved(pose, min_share, free),
        }
    }

    /// The sums over the points of a range, as they were moved.
    fn fit_chunk(&self, frame: &Frame, moved: &Moved, range: Range<usize>) -> FitSums {
        let mut sums = FitSums::default();
        let mut own = [Block::default(); MAX_BLOCKS];
        for (i, index) in range.enumerate() {
            let cell = [moved.cell[0][i], moved.cell[1][i], moved.cell[2][i]];
            let Some(key) = pack(cell) else { continue };
            let y = [moved.y[0][i], moved.y[1][i], moved.y[2][i]];
            let number = self.surroundings.number(key);
            let blocks = self.surroundings.blocks_or_own(self.level, self.search, (cell, number), &mut own);
            let nearest = nearest(frame, y, blocks);
            let Some((distance, block, lane)) = nearest else { continue };
            sums.matches += 1;
            let inlier = distance <= INLIER as f32;
            sums.inliers += usize::from(inlier);
            sums.likelihood += f64::from(frame.likelihood(distance));
            if inlier && is_one_of_every(STRIDE, index) {
                let [xx, xy, xz, yy, yz, zz] = [0, 1, 2, 3, 4, 5].map(|k| f64::from(block.information[k][lane]));
                let relative = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) / (xx + yy + zz);
                sums.facing.add(&Vector3::from(y.map(f64::from)), &(relative * relative));
            }
        }
        sums
    }
}

/// The nearest distribution of the blocks: its squared Mahalanobis distance, block and lane.
#[inline]
fn nearest<'a>(frame: &Frame, y: [f32; 3], blocks: &'a [Block]) -> Option<(f32, &'a Block, usize)> {
    let mut best: Option<(f32, &Block, usize)> = None;
    for block in blocks {
        let distances = frame.distances(y, block);
        for (lane, &distance) in distances.iter().enumerate().take(LANES) {
            if best.is_none_or(|(least, ..)| distance < least) && distance < f32::INFINITY {
                best = Some((distance, block, lane));
            }
        }
    }
    best
}
