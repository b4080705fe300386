//! Registration of points with points.

use super::objective::{PairFit, PairObjective};
use super::params::{PointMetric, PointParams};
use super::surface::{Surface, SurfaceVoxels};
use crate::Error;
use crate::checks::finite_pose;
use crate::registration::{Descent, Optimizer, verdict};
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3, observed_information},
    roles::{Alignment, AlignmentError, Registration, Termination},
    sensors::PointSource,
};
use nalgebra::Matrix6;

/// Fewest points of a target.
const FEWEST: usize = 4;

/// Edge of the voxels as on whose level the descent by squares stops, in metres: it is at rest within a centimetre and 2 mrad.
const NEAR: f64 = 2.0;

/// Aligns clouds with a cloud by iterated closest points: to planes, between planes, or voxel by voxel.
///
/// Thin both clouds out to a point per 0.25 m or so. The score is the negative mean cost of a pair; the information takes the unit
/// variance of the metric for 1 m², and so 10⁻³ m² along a normal: a standard deviation of 3 cm to a plane, and of 4.5 cm between two.
///
/// ```
/// use agv_core::{geometry::{LieGroup, Se3}, nalgebra::Vector3, roles::Registration, sensors::PointCloud};
/// use agv_ndt::gicp::{PointParams, PointRegistration};
///
/// // Floor and two walls, seen from 20 cm beside.
/// let (step, size) = (0.2_f32, 30);
/// let sheet = |f: fn(f32, f32) -> [f32; 3]| (0..size * size).map(move |i| Vector3::from(f((i % size) as f32 * step, (i / size) as f32 * step)));
/// let scene: Vec<_> = sheet(|a, b| [a, b, 0.0]).chain(sheet(|a, b| [a, 0.0, b])).chain(sheet(|a, b| [0.0, a, b])).collect();
/// let moved = scene.iter().map(|p| p - Vector3::new(0.2, 0.1, 0.0));
///
/// let mut icp = PointRegistration::new(PointParams::default())?;
/// icp.set_target(&PointCloud::from_points(scene.iter().copied()))?;
/// let found = icp.align(&PointCloud::from_points(moved), &Se3::identity())?;
/// assert!(found.converged());
/// assert!((found.target_from_source.translation() - Vector3::new(0.2, 0.1, 0.0)).norm() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct PointRegistration {
    params: PointParams,
    target: Surface,
    /// Where the next target is built, so that a refused one changes nothing.
    spare: Surface,
    voxels: SurfaceVoxels,
    source: Surface,
    par: Par,
}

impl PointRegistration {
    /// A registration without a target.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(params: PointParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            params,
            target: Surface::default(),
            spare: Surface::default(),
            voxels: SurfaceVoxels::default(),
            source: Surface::default(),
            par: Par::Seq,
        })
    }

    /// The same, with its loops spread over threads.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// The parameters.
    pub const fn params(&self) -> &PointParams {
        &self.params
    }

    /// By squares, which see far, and from where that comes to rest by the kernel.
    fn descend(&self, objective: &mut PairObjective<'_>, guess: &Se3, free: &Matrix6<f64>) -> Descent {
        let descent = &self.params.descent;
        let Some(kernel) = self.params.kernel_square() else {
            return Optimizer::GaussNewton.minimize(objective, descent, guess, free);
        };
        let far = Optimizer::GaussNewton.minimize(objective, &descent.coarse(NEAR), guess, free);
        if far.termination != Termination::Converged || !far.pose.is_finite() {
            return far;
        }
        objective.kernel = kernel;
        let near = Optimizer::GaussNewton.minimize(objective, descent, &far.pose, free);
        Descent { iterations: far.iterations + near.iterations, ..near }
    }

    fn search(&self, guess: &Se3) -> Alignment<Se3> {
        let (params, free) = (&self.params, self.params.freedom.projector(guess));
        let Self { target, voxels, source, par, .. } = self;
        let mut objective = PairObjective { target, voxels, source, params, kernel: f64::INFINITY, par: *par };
        let found = self.descend(&mut objective, guess, &free);
        let mut result = Alignment::unknown(found.pose, found.termination);
        result.iterations = found.iterations;
        let matches = found.quadratic.matches;
        if matches == 0 || !found.quadratic.cost.is_finite() || !found.pose.is_finite() {
            let mut lost = Alignment::unknown(*guess, Termination::TooFewPoints);
            lost.iterations = found.iterations;
            return lost;
        }
        let PairFit { inlier_ratio, unobserved } = objective.fit(&found.pose, &free);
        result.termination = verdict(found.termination, inlier_ratio >= params.min_inlier_ratio, unobserved.trace());
        result.unobserved = unobserved + (Matrix6::identity() - free);
        let information = found.quadratic.hessian * matches as f64;
        result.information = observed_information::<Se3>(&information, &result.unobserved);
        (result.score, result.inlier_ratio) = (-found.quadratic.cost, inlier_ratio);
        result
    }
}

impl Registration for PointRegistration {
    fn set_target(&mut self, target: &dyn PointSource) -> Result<(), AlignmentError> {
        self.spare.rebuild(target, &self.params.normals, self.par)?;
        check::at_least("finite points of the target", self.spare.points.len(), FEWEST)?;
        std::mem::swap(&mut self.target, &mut self.spare);
        if self.params.metric == PointMetric::Voxelized {
            self.voxels.rebuild(&self.target, self.params.resolution);
        }
        Ok(())
    }

    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        if self.target.points.is_empty() {
            return Err(AlignmentError::NoTarget);
        }
        finite_pose("guess", guess)?;
        match self.params.metric {
            // The target's planes are all that it needs.
            PointMetric::PointToPlane => self.source.rebuild_points(source),
            PointMetric::Generalized | PointMetric::Voxelized => {
                self.source.rebuild(source, &self.params.normals, self.par)?;
            }
        }
        if self.source.points.len() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        Ok(self.search(guess))
    }
}

#[cfg(test)]
mod tests;
