//! A cloud whose points know the surface that they lie on.

use crate::Error;
use crate::cells::{CellTable, floor, pack};
use crate::preprocess::{KdTree, NormalParams};
use agv_core::{compute::Par, sensors::PointSource};
use nalgebra::{Matrix3, Vector3};

/// Variance along a normal, where that across is 1 (Segal et al. 2009, section III).
pub(super) const FLATNESS: f64 = 1e-3;

/// The covariance of a flat distribution; a sphere without a normal.
pub(super) fn flat(normal: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() - normal * normal.transpose() * (1.0 - FLATNESS)
}

/// Finite points, their normals and their tree.
#[derive(Debug, Clone, Default)]
pub(super) struct Surface {
    pub(super) points: Vec<Vector3<f32>>,
    pub(super) normals: Vec<Vector3<f32>>,
    pub(super) tree: KdTree,
}

impl Surface {
    /// Takes the finite points of a cloud, without their normals and tree; the memory is used again.
    pub(super) fn rebuild_points(&mut self, cloud: &(impl PointSource + ?Sized)) {
        self.points.clear();
        self.normals.clear();
        let finite = |point: &Vector3<f32>| point.iter().all(|v| v.is_finite());
        self.points.extend((0..cloud.len()).map(|index| cloud.point(index)).filter(finite));
    }

    /// Takes the finite points of a cloud; the memory is used again.
    pub(super) fn rebuild(
        &mut self,
        cloud: &(impl PointSource + ?Sized),
        normals: &NormalParams,
        par: Par,
    ) -> Result<(), Error> {
        self.rebuild_points(cloud);
        self.tree.rebuild(self.points.as_slice());
        normals.estimate_into(self.points.as_slice(), &self.tree, par, &mut self.normals)
    }
}

/// Mean point and mean distribution of each voxel.
#[derive(Debug, Clone, Default)]
pub(super) struct SurfaceVoxels {
    table: CellTable,
    sums: Vec<SurfaceVoxel>,
    resolution: f64,
}

/// Sums of a voxel, then means.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfaceVoxel {
    pub(super) mean: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    count: f64,
}

impl SurfaceVoxels {
    /// Takes the points of a surface; the memory is used again.
    pub(super) fn rebuild(&mut self, surface: &Surface, resolution: f64) {
        self.table.clear();
        self.sums.clear();
        self.resolution = resolution;
        for (point, normal) in surface.points.iter().zip(&surface.normals) {
            let point = point.cast::<f64>();
            let Some(key) = self.key(&point) else { continue };
            let next = self.sums.len() as u32;
            let index = self.table.get_or_insert(key, next);
            if index == next {
                let empty = SurfaceVoxel { mean: Vector3::zeros(), covariance: Matrix3::zeros(), count: 0.0 };
                self.sums.push(empty);
            }
            let voxel = &mut self.sums[index as usize];
            voxel.mean += point;
            voxel.covariance += flat(&normal.cast());
            voxel.count += 1.0;
        }
        for voxel in &mut self.sums {
            voxel.mean /= voxel.count;
            voxel.covariance /= voxel.count;
        }
    }

    /// The voxel of a point.
    pub(super) fn at(&self, point: &Vector3<f64>) -> Option<&SurfaceVoxel> {
        self.sums.get(self.table.get(self.key(point)?)? as usize)
    }

    fn key(&self, point: &Vector3<f64>) -> Option<u64> {
        let scaled = point / self.resolution;
        pack([floor(scaled.x), floor(scaled.y), floor(scaled.z)])
    }
}
