//! The mean weighed distance of pairs, as a cost over poses.
//!
//! A pair with the offset `d = x - q` costs `½ dᵀ M d`. `M` is `n nᵀ / ε` with the target's normal for point to plane, and
//! `(C_q + R C_p Rᵀ)⁻¹` for the generalized metric, where it counts as constant: `g = M d`, `H = M`. The sum is divided by the number
//! of pairs, so that a pose is not better for having lost some.
//!
//! Squares have their least where wrong pairs (a point on what the target did not see) balance each other, which is elsewhere: in the end
//! a pair counts by the kernel of Geman and `McClure`, with `e² = dᵀ M d` and its scale `k`,
//!
//! ```text
//! ρ = ½ e² / (1 + e² / k²)        w = 1 / (1 + e² / k²)²        g = w M d        H = w M
//! ```

use super::params::{PointMetric, PointParams};
use super::surface::{FLATNESS, Surface, SurfaceVoxels, flat};
use crate::registration::{Facing, MotionSums, Objective, PointDerivatives, Quadratic};
use agv_core::{
    compute::{CHUNK, Par},
    geometry::Se3,
};
use nalgebra::{Matrix3, Matrix6, Vector3};
use std::f64::consts::FRAC_1_SQRT_2;

/// A source against a target.
pub(super) struct PairObjective<'a> {
    pub(super) target: &'a Surface,
    pub(super) voxels: &'a SurfaceVoxels,
    pub(super) source: &'a Surface,
    pub(super) params: &'a PointParams,
    /// `k²` of the kernel; infinite for squares.
    pub(super) kernel: f64,
    pub(super) par: Par,
}

/// A point of the source at a pose, and what it is paired with.
struct Paired {
    /// Place from the pose's origin, in the target's axes.
    y: Vector3<f64>,
    offset: Vector3<f64>,
    weight: Matrix3<f64>,
    /// Normal of the target, or of the source where voxels have none; zero if unknown.
    normal: Vector3<f64>,
    /// Whether both points' surfaces face one way, or that is not known of both.
    is_alike: bool,
}

/// Least cosine between the normals of one surface: 45°, which three in ten pairs of any directions keep.
const ALIKE: f64 = FRAC_1_SQRT_2;

impl Paired {
    /// Distance along the normal; that of the points where there is none.
    fn distance(&self) -> f64 {
        if self.normal == Vector3::zeros() { self.offset.norm() } else { self.normal.dot(&self.offset).abs() }
    }
}

/// What the pairs of a pose amount to.
pub(super) struct PairFit {
    pub(super) inlier_ratio: f64,
    pub(super) unobserved: Matrix6<f64>,
}

impl PairObjective<'_> {
    fn pair(&self, pose: &Se3, rotation: &Matrix3<f64>, index: usize) -> Option<Paired> {
        let y = rotation * self.source.points[index].cast::<f64>();
        let x = y + pose.translation();
        // Unknown where the metric has no use for it.
        let own = self.source.normals.get(index).map_or_else(Vector3::zeros, |normal| rotation * normal.cast::<f64>());
        if self.params.metric == PointMetric::Voxelized {
            let voxel = self.voxels.at(&x)?;
            let weight = (voxel.covariance + flat(&own)).try_inverse()?;
            return Some(Paired { y, offset: x - voxel.mean, weight, normal: own, is_alike: true });
        }
        let found = self.target.tree.nearest(&x.cast(), self.params.max_distance)?.index as usize;
        let normal = self.target.normals[found].cast::<f64>();
        let weight = match self.params.metric {
            PointMetric::PointToPlane => normal * normal.transpose() / FLATNESS,
            _ => (flat(&normal) + flat(&own)).try_inverse()?,
        };
        let is_alike = own == Vector3::zeros() || normal == Vector3::zeros() || own.dot(&normal).abs() >= ALIKE;
        Some(Paired { y, offset: x - self.target.points[found].cast::<f64>(), weight, normal, is_alike })
    }

    /// Inliers, and the directions that they leave free.
    pub(super) fn fit(&self, pose: &Se3, free: &Matrix6<f64>) -> PairFit {
        let (rotation, count) = (pose.rotation().matrix(), self.source.points.len());
        let chunk = |chunk: usize| {
            let (mut facing, mut inliers) = (Facing::default(), 0_usize);
            for index in chunk * CHUNK..count.min((chunk + 1) * CHUNK) {
                let Some(pair) = self.pair(pose, &rotation, index) else { continue };
                // What does not fit says nothing of the direction that it faces.
                if pair.is_alike && pair.distance() <= self.params.inlier_distance {
                    facing.add(&pair.y, &(pair.normal * pair.normal.transpose()));
                    inliers += 1;
                }
            }
            (facing, inliers)
        };
        let sums = self.par.map_reduce(count.div_ceil(CHUNK), chunk, |(a, n), (b, m)| (a.merged(b), n + m));
        let (facing, inliers) = sums.unwrap_or_default();
        PairFit {
            inlier_ratio: inliers as f64 / count.max(1) as f64,
            unobserved: facing.unobserved(pose, self.params.min_facing_share, free),
        }
    }
}

impl Objective for PairObjective<'_> {
    fn evaluate(&mut self, pose: &Se3) -> Quadratic {
        let (rotation, count) = (pose.rotation().matrix(), self.source.points.len());
        let chunk = |chunk: usize| {
            let mut sums = MotionSums::default();
            for index in chunk * CHUNK..count.min((chunk + 1) * CHUNK) {
                let Some(pair) = self.pair(pose, &rotation, index) else { continue };
                let gradient = pair.weight * pair.offset;
                let square = pair.offset.dot(&gradient);
                let share = 1.0 / (1.0 + square / self.kernel);
                let weight = share * share;
                let point = PointDerivatives {
                    cost: 0.5 * share * square,
                    gradient: gradient * weight,
                    hessian: pair.weight * weight,
                    curvature: 0.0,
                };
                sums.add(&pair.y, &point);
            }
            sums
        };
        let sums = self.par.map_reduce(count.div_ceil(CHUNK), chunk, MotionSums::merged).unwrap_or_default();
        let mut quadratic = sums.quadratic(pose);
        let share = 1.0 / quadratic.matches.max(1) as f64;
        quadratic.cost *= share;
        quadratic.gradient *= share;
        quadratic.hessian *= share;
        quadratic
    }
}
