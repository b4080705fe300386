//! The score of a cloud against one level of a map, as a cost over poses.

use super::kernel::{Block, CHUNK, Frame, LaneSums, Moved, accumulate, turn};
use super::level::Level;
use super::mixture::Mixture;
use super::search::{MAX_BLOCKS, Surroundings, UNKNOWN, VoxelSearch};
use crate::cells::{floor, pack, unpack};
use crate::preprocess::one_of_every;
use crate::registration::{Objective, Quadratic, quadratic::MotionSums};
use agv_core::{compute::Par, geometry::Se3, sensors::PointSource};
use nalgebra::Vector3;
use pulp::Arch;

/// The source's points as the loops want them, and the blocks that each was seen with last.
#[derive(Debug, Clone, Default)]
pub(super) struct SourcePoints {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    key: Vec<u64>,
    block: Vec<u32>,
}

/// Not the key of any voxel.
const NO_KEY: u64 = u64::MAX;

impl SourcePoints {
    /// Takes the finite points of a source; the memory is used again.
    pub(super) fn refill(&mut self, source: &(impl PointSource + ?Sized)) {
        self.clear(source.len());
        let finite = |point: &Vector3<f32>| point.x.is_finite() && point.y.is_finite() && point.z.is_finite();
        for point in (0..source.len()).map(|index| source.point(index)).filter(finite) {
            self.push(&point);
        }
        self.forget();
    }

    /// Takes one of every `stride` points of another.
    pub(super) fn thin(&mut self, other: &Self, stride: usize) {
        self.clear(other.len() / stride.max(1) + 1);
        for index in one_of_every(stride, other.len()) {
            self.x.push(other.x[index]);
            self.y.push(other.y[index]);
            self.z.push(other.z[index]);
        }
        self.forget();
    }

    pub(super) const fn len(&self) -> usize {
        self.x.len()
    }

    #[cfg(test)]
    pub(super) fn point(&self, index: usize) -> Vector3<f32> {
        Vector3::new(self.x[index], self.y[index], self.z[index])
    }

    pub(super) fn coordinates(&self) -> [&[f32]; 3] {
        [&self.x, &self.y, &self.z]
    }

    fn clear(&mut self, room: usize) {
        for coordinates in [&mut self.x, &mut self.y, &mut self.z] {
            coordinates.clear();
            coordinates.reserve(room);
        }
    }

    fn push(&mut self, point: &Vector3<f32>) {
        self.x.push(point.x);
        self.y.push(point.y);
        self.z.push(point.z);
    }

    /// No point has a voxel yet.
    fn forget(&mut self) {
        self.key.clear();
        self.block.clear();
        self.key.resize(self.x.len(), NO_KEY);
        self.block.resize(self.x.len(), UNKNOWN);
    }
}

/// The negative score of `source` against `level`.
pub(super) struct ScoreObjective<'a> {
    pub(super) level: &'a Level,
    pub(super) source: &'a mut SourcePoints,
    pub(super) surroundings: &'a mut Surroundings,
    pub(super) mixture: Mixture,
    pub(super) search: VoxelSearch,
    /// Share of the true curvature in the Hessian: 1 is Newton's, 0 that of Gauss and Newton.
    pub(super) curvature: f64,
    pub(super) par: Par,
    pub(super) arch: Arch,
}

impl ScoreObjective<'_> {
    /// Forgets what is known of another level or place, and looks around the points as they lie at `pose`.
    pub(super) fn prepare(&mut self, pose: &Se3) {
        let origin = (pose.translation() / self.level.edge).map(floor);
        self.surroundings.clear([origin.x, origin.y, origin.z]);
        let frame = self.frame(pose);
        let (surroundings, arch) = (&mut *self.surroundings, self.arch);
        let source = &mut *self.source;
        let points = (source.x.as_slice(), source.y.as_slice(), source.z.as_slice());
        self.par.for_each_chunk(
            (points.0, points.1, points.2, source.key.as_mut_slice()),
            CHUNK,
            |_, (x, y, z, keys)| {
                let mut moved = Moved::new();
                arch.dispatch(
                    #[inline(always)]
                    || turn(&frame, [x, y, z], &mut moved),
                );
                for (i, key) in keys.iter_mut().enumerate() {
                    *key = pack([moved.cell[0][i], moved.cell[1][i], moved.cell[2][i]]).unwrap_or(NO_KEY);
                }
            },
        );
        // Neighbours mostly share a voxel: the last one is tried before the table.
        let (mut last_key, mut last_block) = (NO_KEY, UNKNOWN);
        for (&key, block) in source.key.iter().zip(&mut source.block) {
            if key != last_key {
                last_key = key;
                last_block = if key == NO_KEY { UNKNOWN } else { surroundings.enter(unpack(key), key) };
            }
            *block = last_block;
        }
        surroundings.fill(self.level, self.search, self.par);
    }

    /// Makes the blocks of voxels that points have come to since.
    #[cold]
    fn look_again(&mut self) {
        let source = &mut *self.source;
        for (&key, block) in source.key.iter().zip(&mut source.block).filter(|(_, block)| **block == UNKNOWN) {
            if key != NO_KEY {
                *block = self.surroundings.enter(unpack(key), key);
            }
        }
        self.surroundings.fill(self.level, self.search, self.par);
    }

    pub(super) fn frame(&self, pose: &Se3) -> Frame {
        let origin = Vector3::from(self.surroundings.origin.map(f64::from)) * self.level.edge;
        Frame::new(pose, &origin, self.level.edge, &self.mixture, self.curvature, self.search)
    }
}

impl Objective for ScoreObjective<'_> {
    fn evaluate(&mut self, pose: &Se3) -> Quadratic {
        let frame = self.frame(pose);
        let (level, surroundings, search, arch) = (self.level, &*self.surroundings, self.search, self.arch);
        let source = &mut *self.source;
        let (x, y, z) = (source.x.as_slice(), source.y.as_slice(), source.z.as_slice());
        let sums = self.par.map_reduce_chunks(
            (x, y, z, source.key.as_mut_slice(), source.block.as_mut_slice()),
            CHUNK,
            |_, (x, y, z, keys, blocks)| {
                arch.dispatch(Chunk { frame: &frame, level, surroundings, search, points: [x, y, z], keys, blocks })
            },
            |(a, unknown), (b, more)| (a.merged(b), unknown + more),
        );
        let (sums, unknown) = sums.unwrap_or_default();
        // A few points that strayed are looked around for by themselves, each time.
        if unknown * MAX_UNKNOWN > self.source.len() {
            self.look_again();
        }
        sums.quadratic(pose)
    }
}

/// Blocks are made for all if more than one point in so many has none.
const MAX_UNKNOWN: usize = 64;

/// One chunk of an evaluation.
struct Chunk<'a> {
    frame: &'a Frame,
    level: &'a Level,
    surroundings: &'a Surroundings,
    search: VoxelSearch,
    points: [&'a [f32]; 3],
    keys: &'a mut [u64],
    blocks: &'a mut [u32],
}

#[expect(clippy::inline_always, reason = "what is dispatched has to be inlined to be compiled for the instruction set")]
impl pulp::NullaryFnOnce for Chunk<'_> {
    type Output = (MotionSums, usize);

    #[inline(always)]
    fn call(self) -> (MotionSums, usize) {
        let Self { frame, level, surroundings, search, points, keys, blocks } = self;
        let (mut moved, mut sums, mut unknown) = (Moved::new(), LaneSums::new(), 0);
        let mut own = [Block::default(); MAX_BLOCKS];
        turn(frame, points, &mut moved);
        for (i, (key, block)) in keys.iter_mut().zip(blocks).enumerate() {
            let cell = [moved.cell[0][i], moved.cell[1][i], moved.cell[2][i]];
            let Some(packed) = pack(cell) else { continue };
            if packed != *key {
                (*key, *block) = (packed, surroundings.number(packed));
            }
            let y = [moved.y[0][i], moved.y[1][i], moved.y[2][i]];
            // Not seen from where the search began: made for this point alone.
            unknown += usize::from(*block == UNKNOWN);
            let blocks = surroundings.blocks_or_own(level, search, (cell, *block), &mut own);
            if blocks.first().is_none_or(Block::is_empty) {
                continue;
            }
            sums.met();
            for block in blocks {
                accumulate(frame, y, block, &mut sums);
            }
        }
        (sums.total(frame), unknown)
    }
}

#[cfg(test)]
mod tests;
