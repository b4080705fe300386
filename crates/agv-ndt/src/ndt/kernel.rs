//! The inner loop: score, gradient and Hessian of points against the distributions around them, in `f32`, eight
//! distributions at a time.
//!
//! With `d = x - mean`, `q = C⁻¹ d` and `e = exp(-½ d2 dᵀq)`, a distribution adds to the cost of a point (Magnusson 2009, Eqs. 6.9
//! to 6.13, before the chain rule; `a = -d1 > 0`, `b = d2`)
//!
//! ```text
//! f = -a e        g = a b e q        H = a b e (C⁻¹ - κ b q qᵀ)
//! ```
//!
//! with `κ = 1` for Newton's Hessian and 0 for the positive definite one of Gauss and Newton. The distributions around a voxel lie
//! side by side in a [`Block`], so that a point costs one load per coefficient and no gather. Sums are kept per lane, and lanes are
//! added in `f64` in a fixed order after each chunk: the bits are the same for every instruction set.
#![expect(
    clippy::inline_always,
    reason = "what is dispatched has to be inlined to be compiled for the instruction set"
)]
#![expect(clippy::needless_range_loop, reason = "plain loops over lanes are what vectorises")]

use super::mixture::Mixture;
use super::search::VoxelSearch;
use crate::registration::MotionSums;
use crate::registration::quadratic::SUMS;
use agv_core::geometry::Se3;
use nalgebra::Vector3;

/// Points per parallel chunk. A coarse level has few points, and a chunk of them takes microseconds.
pub(crate) const CHUNK: usize = 128;

/// Distributions side by side.
pub(crate) const LANES: usize = 8;

/// Lanes of one coefficient.
type Lane = [f32; LANES];

/// Up to eight distributions, in metres from the frame's origin; the weight of an empty lane is zero.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct Block {
    pub(crate) mean: [Lane; 3],
    pub(crate) information: [Lane; 6],
    pub(crate) weight: Lane,
}

/// A pose in `f32`, the origin of the frame in a voxel near it, and the constants of the mixture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    rotation: [[f32; 3]; 3],
    translation: [f32; 3],
    per_edge: f32,
    /// Voxels before a point's own that its cell is counted from: 0 or ½.
    shift: f32,
    /// `-½ b log2 e`, `a`, `a b`, `κ b` and `κ`.
    exponent: f32,
    amplitude: f32,
    slope: f32,
    bend: f32,
    curvature: f32,
    /// Distributions whose mean is farther, squared, do not count.
    reach_squared: f32,
}

impl Block {
    /// Whether there is no distribution in it: lanes are taken in order.
    #[inline(always)]
    pub(crate) fn is_empty(&self) -> bool {
        self.weight[0] == 0.0
    }
}

impl Frame {
    pub(crate) fn new(
        pose: &Se3,
        origin: &Vector3<f64>,
        edge: f64,
        mixture: &Mixture,
        curvature: f64,
        search: VoxelSearch,
    ) -> Self {
        let reach = search.reach() * edge;
        let (r, t) = (pose.rotation().matrix(), pose.translation() - origin);
        let row = |i: usize| [r[(i, 0)] as f32, r[(i, 1)] as f32, r[(i, 2)] as f32];
        Self {
            rotation: [row(0), row(1), row(2)],
            translation: [t.x as f32, t.y as f32, t.z as f32],
            per_edge: (1.0 / edge) as f32,
            shift: search.shift(),
            exponent: (-0.5 * mixture.d2 * std::f64::consts::LOG2_E) as f32,
            amplitude: -mixture.d1 as f32,
            slope: (-mixture.d1 * mixture.d2) as f32,
            bend: (curvature * mixture.d2) as f32,
            curvature: curvature as f32,
            reach_squared: (reach * reach) as f32,
        }
    }

    /// The likelihood, from 0 to 1, of a squared Mahalanobis distance.
    pub(crate) fn likelihood(&self, distance: f32) -> f32 {
        exp2(self.exponent * distance)
    }

    /// Squared Mahalanobis distances of a turned point to the distributions of a block; infinite where one does not count.
    #[inline(always)]
    pub(crate) fn distances(&self, [yx, yy, yz]: [f32; 3], block: &Block) -> Lane {
        let [px, py, pz] = [yx + self.translation[0], yy + self.translation[1], yz + self.translation[2]];
        let [xx, xy, xz, yy, yz, zz] = &block.information;
        let mut out = [0.0; LANES];
        for l in 0..LANES {
            let (dx, dy, dz) = (px - block.mean[0][l], py - block.mean[1][l], pz - block.mean[2][l]);
            let (qx, qy) = (xx[l] * dx + xy[l] * dy + xz[l] * dz, xy[l] * dx + yy[l] * dy + yz[l] * dz);
            let qz = xz[l] * dx + yz[l] * dy + zz[l] * dz;
            let counts = block.weight[l] > 0.0 && dx * dx + dy * dy + dz * dz <= self.reach_squared;
            out[l] = if counts { dx * qx + dy * qy + dz * qz } else { f32::INFINITY };
        }
        out
    }
}

/// A chunk of points turned into the target's axes, and their voxels from the frame's origin.
pub(crate) struct Moved {
    pub(crate) y: [[f32; CHUNK]; 3],
    pub(crate) cell: [[i32; CHUNK]; 3],
}

impl Moved {
    pub(crate) const fn new() -> Self {
        Self { y: [[0.0; CHUNK]; 3], cell: [[0; CHUNK]; 3] }
    }
}

/// Turns at most [`CHUNK`] points.
#[inline(always)]
pub(crate) fn turn(frame: &Frame, [px, py, pz]: [&[f32]; 3], out: &mut Moved) {
    let len = px.len().min(CHUNK);
    let (px, py, pz) = (&px[..len], &py[..len], &pz[..len]);
    for axis in 0..3 {
        let [a, b, c] = frame.rotation[axis];
        let (y, cell) = (&mut out.y[axis][..len], &mut out.cell[axis][..len]);
        for i in 0..len {
            y[i] = a * px[i] + b * py[i] + c * pz[i];
            let scaled = (y[i] + frame.translation[axis]) * frame.per_edge - frame.shift;
            let whole = scaled as i32;
            cell[i] = whole.wrapping_sub(i32::from((whole as f32) > scaled));
        }
    }
}

/// Sums of a chunk, lane by lane, in the order of [`MotionSums`].
#[repr(align(64))]
pub(crate) struct LaneSums {
    lanes: [Lane; SUMS],
    matches: usize,
}

impl LaneSums {
    pub(crate) const fn new() -> Self {
        Self { lanes: [[0.0; LANES]; SUMS], matches: 0 }
    }

    /// A point counts as one that met the target.
    #[inline(always)]
    pub(crate) fn met(&mut self) {
        self.matches += 1;
    }

    /// The sum of the lanes.
    pub(crate) fn total(&self, frame: &Frame) -> MotionSums {
        let sums = self.lanes.map(|lane| lane.iter().map(|&value| f64::from(value)).sum());
        MotionSums { sums, matches: self.matches }.with_bend(f64::from(frame.curvature))
    }
}

/// `2^x` for `x <= 0`, to 2e-7 relative: whole part by the exponent's bits, the rest by its Taylor polynomial.
#[inline(always)]
fn exp2(x: f32) -> f32 {
    let x = if x > -100.0 { x } else { -100.0 };
    // Adding 1.5 · 2²³ leaves the nearest whole number in the low bits.
    let shifted = x + 12_582_912.0;
    let whole = (shifted.to_bits() as i32).wrapping_sub(0x4b40_0000);
    let r = (x - (shifted - 12_582_912.0)) * std::f32::consts::LN_2;
    let p = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0))))));
    p * f32::from_bits((whole.wrapping_add(127) as u32) << 23)
}

/// Adds what a point feels from the distributions of a block.
#[inline(always)]
pub(crate) fn accumulate(frame: &Frame, y: [f32; 3], block: &Block, sums: &mut LaneSums) {
    let [yx, yy, yz] = y;
    let [px, py, pz] = [yx + frame.translation[0], yy + frame.translation[1], yz + frame.translation[2]];
    let s = &mut sums.lanes;
    for l in 0..LANES {
        let (dx, dy, dz) = (px - block.mean[0][l], py - block.mean[1][l], pz - block.mean[2][l]);
        let [xx, xy, xz, yy_, yz_, zz] = [
            block.information[0][l],
            block.information[1][l],
            block.information[2][l],
            block.information[3][l],
            block.information[4][l],
            block.information[5][l],
        ];
        let (qx, qy, qz) = (xx * dx + xy * dy + xz * dz, xy * dx + yy_ * dy + yz_ * dz, xz * dx + yz_ * dy + zz * dz);
        let mahalanobis = dx * qx + dy * qy + dz * qz;
        let near = dx * dx + dy * dy + dz * dz <= frame.reach_squared;
        let weight = if near { block.weight[l] } else { 0.0 };
        let e = weight * exp2(frame.exponent * mahalanobis);
        let v = frame.slope * e;
        let u = frame.bend * v;
        let (gx, gy, gz) = (v * qx, v * qy, v * qz);
        let (ux, uy, uz) = (u * qx, u * qy, u * qz);
        let (hxx, hxy, hxz) = (v * xx - ux * qx, v * xy - ux * qy, v * xz - ux * qz);
        let (hyy, hyz, hzz) = (v * yy_ - uy * qy, v * yz_ - uy * qz, v * zz - uz * qz);
        // H J, with the columns of J: (0, -z, y), (z, 0, -x), (-y, x, 0).
        let (mxx, mxy, mxz) = (hxz * yy - hxy * yz, hxx * yz - hxz * yx, hxy * yx - hxx * yy);
        let (myx, myy, myz) = (hyz * yy - hyy * yz, hxy * yz - hyz * yx, hyy * yx - hxy * yy);
        let (mzx, mzy, mzz) = (hzz * yy - hyz * yz, hxz * yz - hzz * yx, hyz * yx - hxz * yy);
        let (bx, by, bz) = (yx * gx, yy * gy, yz * gz);
        let c = frame.curvature;
        let half = 0.5 * c;
        s[0][l] -= frame.amplitude * e;
        s[1][l] += gx;
        s[2][l] += gy;
        s[3][l] += gz;
        s[4][l] += yy * gz - yz * gy;
        s[5][l] += yz * gx - yx * gz;
        s[6][l] += yx * gy - yy * gx;
        s[7][l] += hxx;
        s[8][l] += hxy;
        s[9][l] += hxz;
        s[10][l] += hyy;
        s[11][l] += hyz;
        s[12][l] += hzz;
        s[13][l] += mxx;
        s[14][l] += mxy;
        s[15][l] += mxz;
        s[16][l] += myx;
        s[17][l] += myy;
        s[18][l] += myz;
        s[19][l] += mzx;
        s[20][l] += mzy;
        s[21][l] += mzz;
        s[22][l] += yy * mzx - yz * myx - c * (by + bz);
        s[23][l] += yy * mzy - yz * myy + half * (yx * gy + yy * gx);
        s[24][l] += yy * mzz - yz * myz + half * (yx * gz + yz * gx);
        s[25][l] += yz * mxy - yx * mzy - c * (bx + bz);
        s[26][l] += yz * mxz - yx * mzz + half * (yy * gz + yz * gy);
        s[27][l] += yx * myz - yy * mxz - c * (bx + by);
    }
}
