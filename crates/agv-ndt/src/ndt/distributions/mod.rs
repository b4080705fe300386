//! Distribution to distribution: both clouds as normal distributions, so that an alignment costs hundreds of pairs and not thousands
//! of points.

mod cells;

use super::gaussian::VoxelParams;
use super::mixture::Mixture;
use super::params::NdtParams;
use crate::Error;
use crate::checks::finite_pose;
use crate::registration::verdict;
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3, observed_information},
    roles::{Alignment, AlignmentError, Registration, Termination},
    sensors::PointSource,
};
use cells::{Cells, Overlap};
use nalgebra::Matrix6;

/// Aligns clouds by the overlap of their normal distributions (Stoyanov et al. 2012), coarse to fine.
///
/// Of [`NdtParams`] the search, the restarts and `hold_unobserved` are not used: eight cells are looked at, and directions that are not
/// observed end as [`Termination::Degenerate`]. Give both clouds in full: what a cell of the source says of its surface comes of its
/// points. A step is cheaper than one of [`NdtRegistration`](super::NdtRegistration), but each alignment makes the source's distributions
/// first, so that in all it takes longer than that does with a thinned source, and is mostly less accurate: points see the target's
/// surface between the means. The result has the same bits for any number of threads.
///
/// ```
/// use agv_core::{geometry::Se3, nalgebra::Vector3, roles::Registration, sensors::PointCloud};
/// use agv_ndt::ndt::{DistributionRegistration, NdtParams};
///
/// // Floor and two walls, seen from 20 cm beside.
/// let sheet = |f: fn(f32, f32) -> [f32; 3]| (0..6400).map(move |i| Vector3::from(f((i % 80) as f32 * 0.1, (i / 80) as f32 * 0.1)));
/// let scene: Vec<_> = sheet(|a, b| [a, b, 0.3]).chain(sheet(|a, b| [a, 0.4, b])).chain(sheet(|a, b| [0.7, a, b])).collect();
/// let moved = scene.iter().map(|p| p - Vector3::new(0.2, 0.1, 0.0));
///
/// let mut ndt = DistributionRegistration::new(NdtParams::default())?;
/// ndt.set_target(&PointCloud::from_points(scene.iter().copied()))?;
/// let found = ndt.align(&PointCloud::from_points(moved), &Se3::default())?;
/// assert!((found.target_from_source.translation() - Vector3::new(0.2, 0.1, 0.0)).norm() < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct DistributionRegistration {
    params: NdtParams,
    /// From the finest to the coarsest.
    target: Vec<Cells>,
    source: Vec<Cells>,
    /// Where the next target is built, so that a refused one changes nothing.
    spare: Vec<Cells>,
    mixtures: Vec<Mixture>,
    par: Par,
}

impl DistributionRegistration {
    /// A registration without a target.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(params: NdtParams) -> Result<Self, Error> {
        params.validate()?;
        let edge = |doublings: u32| params.voxels.resolution * f64::from(1_u32 << doublings);
        let level = |doublings| Cells::new(VoxelParams { resolution: edge(doublings), ..params.voxels });
        let levels = (0..=params.coarse_levels).map(level).collect::<Result<Vec<_>, _>>()?;
        let mixtures = (0..=params.coarse_levels).map(|doublings| Mixture::new(params.outlier_ratio, edge(doublings)));
        Ok(Self {
            target: levels.clone(),
            source: levels.clone(),
            spare: levels,
            mixtures: mixtures.collect::<Result<_, _>>()?,
            par: Par::Seq,
            params,
        })
    }

    /// The same, with its loops spread over threads.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// The parameters.
    pub const fn params(&self) -> &NdtParams {
        &self.params
    }

    fn search(&self, guess: &Se3) -> Alignment<Se3> {
        let (params, free) = (&self.params, self.params.freedom.projector(guess));
        let (mut pose, mut iterations) = (*guess, 0);
        for (doublings, (target, source)) in self.target.iter().zip(&self.source).enumerate().rev() {
            let mixture = self.mixtures[doublings];
            let mut overlap = Overlap { target, source, mixture, par: self.par };
            let descent = if doublings == 0 { params.descent } else { params.descent.coarse(target.edge()) };
            let found = params.optimizer.minimize(&mut overlap, &descent, &pose, &free);
            iterations += found.iterations;
            if !found.pose.is_finite() {
                break;
            }
            pose = found.pose;
            if doublings > 0 {
                continue;
            }
            let mut result = Alignment::unknown(pose, found.termination);
            result.iterations = iterations;
            if found.quadratic.matches == 0 {
                return result;
            }
            let (inlier_ratio, unobserved) = overlap.fit(&pose, params.min_facing_share, &free);
            result.termination =
                verdict(found.termination, inlier_ratio >= params.min_inlier_ratio, unobserved.trace());
            result.unobserved = unobserved + (Matrix6::identity() - free);
            result.information = observed_information::<Se3>(&found.quadratic.hessian, &result.unobserved);
            result.score = -found.quadratic.cost / source.gaussians.len().max(1) as f64;
            result.inlier_ratio = inlier_ratio;
            return result;
        }
        let mut lost = Alignment::unknown(*guess, Termination::Stalled);
        lost.iterations = iterations;
        lost
    }
}

impl Registration for DistributionRegistration {
    fn set_target(&mut self, target: &dyn PointSource) -> Result<(), AlignmentError> {
        for level in &mut self.spare {
            level.rebuild(target);
        }
        // There is a finest level.
        let cells = self.spare.first().map_or(0, |finest| finest.gaussians.len());
        check::at_least("cells of the target", cells, 1)?;
        std::mem::swap(&mut self.target, &mut self.spare);
        Ok(())
    }

    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        if self.target.first().is_none_or(|finest| finest.gaussians.is_empty()) {
            return Err(AlignmentError::NoTarget);
        }
        finite_pose("guess", guess)?;
        let is_finite = |index: &usize| source.point(*index).iter().all(|v| v.is_finite());
        if (0..source.len()).filter(is_finite).take(self.params.min_points).count() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        for level in &mut self.source {
            level.rebuild(source);
        }
        if self.source.first().is_none_or(|finest| finest.gaussians.is_empty()) {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        Ok(self.search(guess))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::Objective as _;
    use crate::scenes::{CORRIDOR, ROOM, cloud, sheets};
    use agv_core::{geometry::So3, roles::laws};
    use nalgebra::{Vector3, Vector6};

    fn pose(x: f64, y: f64, yaw: f64) -> Se3 {
        Se3::from_parts(Vector3::new(x, y, 0.05), So3::from_roll_pitch_yaw(0.01, -0.02, yaw))
    }

    #[test]
    fn it_plays_its_role() {
        let truth = pose(0.3, -0.2, 0.1);
        let (target, source) =
            (cloud(&sheets(&ROOM, 100.0, 1), &Se3::default()), cloud(&sheets(&ROOM, 60.0, 2), &truth));
        let mut ndt = DistributionRegistration::new(NdtParams::default()).unwrap();
        laws::registration(&mut ndt, &target, &source, &Se3::default()).unwrap();
    }

    /// Within 2 cm and a quarter of a degree from a metre and 10° off, with the same bits for any number of threads.
    #[test]
    fn rooms_are_aligned_from_a_metre_off() {
        let target = cloud(&sheets(&ROOM, 100.0, 1), &Se3::default());
        for (k, truth) in [pose(0.8, 0.6, 0.17), pose(-0.7, 0.7, -0.17), pose(0.2, -0.9, 0.1)].iter().enumerate() {
            let source = cloud(&sheets(&ROOM, 60.0, 5 + k as u32), truth);
            let [one, two] = [Par::Seq, Par::threads(2)].map(|par| {
                let mut ndt = DistributionRegistration::new(NdtParams::default()).unwrap().with_parallelism(par);
                ndt.set_target(&target).unwrap();
                ndt.align(&source, &Se3::default()).unwrap()
            });
            assert_eq!(one, two);
            let error = one.target_from_source.minus(truth);
            assert!(one.converged(), "{one:?}");
            let (moved, turned) = (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm());
            assert!(moved < 0.02 && turned < 0.25_f64.to_radians(), "{error}");
        }
    }

    /// Gradient against differences of the cost at one pose, where only the turned covariance is left out: small beside it.
    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let params = VoxelParams::default();
        let (mut target, mut source) = (Cells::new(params).unwrap(), Cells::new(params).unwrap());
        target.rebuild(&cloud(&sheets(&ROOM, 100.0, 1), &Se3::default()));
        source.rebuild(&cloud(&sheets(&ROOM, 60.0, 2), &pose(0.1, 0.1, 0.02)));
        let mixture = Mixture::new(0.3, 1.0).unwrap();
        let mut overlap = Overlap { target: &target, source: &source, mixture, par: Par::Seq };
        let (at, h) = (pose(0.08, 0.13, 0.015), 1e-6);
        let here = overlap.evaluate(&at);
        for axis in 0..6 {
            let step = Vector6::ith(axis, h);
            let [more, less] = [step, -step].map(|step| overlap.evaluate(&at.plus(&step)).cost);
            let slope = (more - less) / (2.0 * h);
            assert!(
                (slope - here.gradient[axis]).abs() < if axis < 3 { 1e-3 } else { 0.02 } * here.gradient.norm(),
                "{axis}: {slope} {}",
                here.gradient
            );
        }
    }

    /// A handful fits anywhere.
    #[test]
    fn a_handful_of_points_is_too_few() {
        let mut ndt = DistributionRegistration::new(NdtParams::default()).unwrap();
        ndt.set_target(&cloud(&sheets(&ROOM, 100.0, 1), &Se3::default())).unwrap();
        // All of them in one place, so that there is a distribution.
        let heap = sheets(&[[[0.1, 0.1, -1.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]]], 200.0, 2);
        for count in [1, 5, 20, 40] {
            let found = ndt.align(&cloud(&heap[..count], &Se3::default()), &Se3::default()).unwrap();
            assert_eq!(found, Alignment::unknown(Se3::default(), Termination::TooFewPoints), "{count}");
        }
        let found = ndt.align(&cloud(&heap[..50], &Se3::default()), &Se3::default()).unwrap();
        assert!(found.termination != Termination::TooFewPoints && !found.converged(), "{found:?}");
    }

    #[test]
    fn a_corridor_is_degenerate() {
        let mut ndt = DistributionRegistration::new(NdtParams::default()).unwrap();
        ndt.set_target(&cloud(&sheets(&CORRIDOR, 60.0, 1), &Se3::default())).unwrap();
        let source = cloud(&sheets(&CORRIDOR, 30.0, 2), &Se3::from_parts(Vector3::new(0.2, 0.05, 0.0), So3::default()));
        let found = ndt.align(&source, &Se3::default()).unwrap();
        assert_eq!(found.termination, Termination::Degenerate);
        assert!(found.unobserved[(0, 0)] > 0.9 && found.target_from_source.is_finite(), "{}", found.unobserved);
    }
}
