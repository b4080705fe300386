//! A cloud as normal distributions in cells of one size, and how two such clouds overlap.
//!
//! Stoyanov, Magnusson, Andreasson and Lilienthal, *Fast and accurate scan registration through minimization of the distance between
//! compact 3D NDT representations* (IJRR 2012): with `d = R μ_i + t - μ_j` a pair of distributions costs
//!
//! ```text
//! f = -a exp(-½ b dᵀ B d)        B = (R C_i Rᵀ + C_j)⁻¹
//! ```
//!
//! and as for pairs of points `B` counts as constant in the derivatives: `g = a b e B d`, `H = a b e B`.

use super::super::gaussian::{Gaussian3, VoxelParams};
use super::super::map::NdtMap;
use super::super::mixture::Mixture;
use crate::Error;
use crate::cells::{CellTable, floor, pack, pack_within};
use crate::registration::{Facing, INLIER, Objective, PointDerivatives, Quadratic, quadratic::MotionSums};
use agv_core::{
    compute::{CHUNK, Par},
    geometry::Se3,
    sensors::PointSource,
};
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Distributions of a cloud, for look-ups.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    map: NdtMap,
    table: CellTable,
    pub(super) gaussians: Vec<Gaussian3>,
}

impl Cells {
    pub(super) fn new(params: VoxelParams) -> Result<Self, Error> {
        Ok(Self { map: NdtMap::new(params)?, table: CellTable::default(), gaussians: Vec::new() })
    }

    /// Takes the points of a cloud; the memory is used again.
    pub(super) fn rebuild(&mut self, points: &dyn PointSource) {
        self.map.clear();
        self.table.clear();
        self.gaussians.clear();
        self.map.insert(points, &Se3::default());
        for (cell, _) in self.map.voxels() {
            if let Some(gaussian) = self.map.gaussian(cell) {
                self.table.get_or_insert(pack_within(cell), self.gaussians.len() as u32);
                self.gaussians.push(gaussian);
            }
        }
    }

    pub(super) const fn edge(&self) -> f64 {
        self.map.params().resolution
    }

    /// Those of the eight cells around the corner that is nearest to a point.
    fn around(&self, point: Vector3<f64>) -> impl Iterator<Item = &Gaussian3> + '_ {
        let corner = (point / self.edge()).map(|along| floor(along - 0.5));
        (0..8).filter_map(move |i| {
            let next = |index: i32, bit: i32| index.saturating_add(i >> bit & 1);
            let key = pack([next(corner.x, 0), next(corner.y, 1), next(corner.z, 2)])?;
            self.gaussians.get(self.table.get(key)? as usize)
        })
    }
}

/// A source against a target of the same cells.
pub(super) struct Overlap<'a> {
    pub(super) target: &'a Cells,
    pub(super) source: &'a Cells,
    pub(super) mixture: Mixture,
    pub(super) par: Par,
}

/// A pair at a pose: the source's mean from the pose's origin, the offset, and the information.
struct Pair {
    y: Vector3<f64>,
    offset: Vector3<f64>,
    information: Matrix3<f64>,
}

impl Pair {
    fn mahalanobis(&self) -> f64 {
        self.offset.dot(&(self.information * self.offset))
    }
}

impl Overlap<'_> {
    /// All pairs of a distribution of the source.
    fn pairs(&self, pose: &Se3, rotation: &Matrix3<f64>, own: &Gaussian3) -> impl Iterator<Item = Pair> + '_ {
        let y = rotation * own.mean;
        let (x, turned) = (y + pose.translation(), rotation * own.covariance * rotation.transpose());
        self.target.around(x).filter_map(move |other| {
            let information = (turned + other.covariance).try_inverse()?;
            let information = (information + information.transpose()) * 0.5;
            Some(Pair { y, offset: x - other.mean, information })
        })
    }

    /// Share of the source's distributions whose nearest partner is one, and the directions that the pairs leave free.
    pub(super) fn fit(&self, pose: &Se3, min_share: f64, free: &Matrix6<f64>) -> (f64, Matrix6<f64>) {
        let rotation = pose.rotation().matrix();
        let (mut facing, mut inliers) = (Facing::default(), 0_usize);
        for own in &self.source.gaussians {
            let nearest = self.pairs(pose, &rotation, own).min_by(|a, b| a.mahalanobis().total_cmp(&b.mahalanobis()));
            let Some(pair) = nearest else { continue };
            let relative = pair.information / pair.information.trace();
            // What does not fit says nothing of the direction that it faces.
            if pair.mahalanobis() <= INLIER {
                facing.add(&pair.y, &(relative * relative));
                inliers += 1;
            }
        }
        let share = inliers as f64 / self.source.gaussians.len().max(1) as f64;
        (share, facing.unobserved(pose, min_share, free))
    }
}

impl Objective for Overlap<'_> {
    fn evaluate(&mut self, pose: &Se3) -> Quadratic {
        let (rotation, count) = (pose.rotation().matrix(), self.source.gaussians.len());
        let (amplitude, b) = (-self.mixture.d1, self.mixture.d2);
        let overlap = &*self;
        let chunk = |chunk: usize| {
            let mut sums = MotionSums::default();
            for own in &overlap.source.gaussians[chunk * CHUNK..count.min((chunk + 1) * CHUNK)] {
                for pair in overlap.pairs(pose, &rotation, own) {
                    let e = amplitude * (-0.5 * b * pair.mahalanobis()).exp();
                    let gradient = pair.information * pair.offset * (b * e);
                    let hessian = pair.information * (b * e);
                    sums.add(&pair.y, &PointDerivatives { cost: -e, gradient, hessian, curvature: 0.0 });
                }
            }
            sums
        };
        let sums = self.par.map_reduce(count.div_ceil(CHUNK), chunk, MotionSums::merged).unwrap_or_default();
        sums.quadratic(pose)
    }
}
