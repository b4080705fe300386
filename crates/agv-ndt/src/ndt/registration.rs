//! Registration by the normal distributions transform: point to distribution, coarse to fine.

mod glance;
mod growth;

use super::fit::Fit;
use super::gaussian::VoxelParams;
use super::level::Level;
use super::map::NdtMap;
use super::mixture::Mixture;
use super::objective::{ScoreObjective, SourcePoints};
use super::params::NdtParams;
use super::search::Surroundings;
use crate::Error;
use crate::checks::finite_pose;
use crate::registration::{Descent, DescentParams, Objective, Optimizer, verdict};
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3, observed_information},
    roles::{Alignment, AlignmentError, Registration, Termination},
    sensors::PointSource,
};
use nalgebra::Matrix6;
use pulp::Arch;

/// Share of the score's own curvature in the Hessian of the finest level, between Gauss and Newton's matrix, which is slow, and
/// Newton's, which is indefinite a few centimetres from the optimum.
const CURVATURE: f64 = 0.5;

/// Fewest points that a coarse level is thinned out to.
const COARSE_POINTS: usize = 500;

/// What is known of the last alignment beyond its [`Alignment`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NdtReport {
    /// Score per point of the source: PCL's transformation probability.
    pub transformation_probability: f64,
    /// Mean likelihood that a point's nearest distribution gives it, from 0 to 1, over the points that have one.
    pub nearest_likelihood: f64,
    /// Share of the points that have a distribution around them.
    pub matched_ratio: f64,
    /// Directions that the source does not fix, out of those that may change.
    pub unobserved_count: usize,
}

/// Aligns clouds with a map of normal distributions (Magnusson 2009).
///
/// Thin the source out to a point per quarter of a voxel's edge or so, and give the target more: [`VoxelGrid`] does both. The
/// result has the same bits for any number of threads. An alignment allocates nothing once the buffers have met as many
/// points, around as many voxels, as they meet this time.
///
/// The [`Alignment`]'s score is that per point; its information is the Hessian of Gauss and Newton along the directions that are
/// observed. It knows nothing of errors that neighbouring points share: on recorded pairs poses differ from references by some
/// millimetres where it says one.
///
/// [`VoxelGrid`]: agv_core::sensors::VoxelGrid
///
/// ```
/// use agv_core::{geometry::{LieGroup, Se3}, nalgebra::Vector3, roles::Registration, sensors::PointCloud};
/// use agv_ndt::ndt::{NdtParams, NdtRegistration};
///
/// // Floor and two walls, seen from 20 cm beside.
/// let (step, size) = (0.1_f32, 80);
/// let sheet = |f: fn(f32, f32) -> [f32; 3]| (0..size * size).map(move |i| Vector3::from(f((i % size) as f32 * step, (i / size) as f32 * step)));
/// let scene: Vec<_> = sheet(|a, b| [a, b, 0.3]).chain(sheet(|a, b| [a, 0.4, b])).chain(sheet(|a, b| [0.7, a, b])).collect();
/// let moved = scene.iter().step_by(3).map(|p| p - Vector3::new(0.2, 0.1, 0.0));
///
/// let mut ndt = NdtRegistration::new(NdtParams::default())?;
/// ndt.set_target(&PointCloud::from_points(scene.iter().copied()))?;
/// let found = ndt.align(&PointCloud::from_points(moved), &Se3::identity())?;
/// assert!(found.converged());
/// assert!((found.target_from_source.translation() - Vector3::new(0.2, 0.1, 0.0)).norm() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct NdtRegistration {
    params: NdtParams,
    map: NdtMap,
    /// Where the next target is built, so that a refused one changes nothing.
    spare: NdtMap,
    /// From the finest to the coarsest; no voxels before there is a target.
    levels: Vec<Level>,
    mixtures: Vec<Mixture>,
    source: SourcePoints,
    thinned: SourcePoints,
    surroundings: Surroundings,
    report: NdtReport,
    par: Par,
    arch: Arch,
}

impl NdtRegistration {
    /// A registration without a target.
    ///
    /// # Errors
    /// A parameter out of its range, by name.
    pub fn new(params: NdtParams) -> Result<Self, Error> {
        params.validate()?;
        let map = NdtMap::new(params.voxels)?;
        let edge = |doublings: u32| params.voxels.resolution * f64::from(1_u32 << doublings);
        let mixtures = (0..=params.coarse_levels).map(|doublings| Mixture::new(params.outlier_ratio, edge(doublings)));
        Ok(Self {
            spare: map.clone(),
            map,
            levels: vec![Level::default(); params.coarse_levels as usize + 1],
            mixtures: mixtures.collect::<Result<_, _>>()?,
            source: SourcePoints::default(),
            thinned: SourcePoints::default(),
            surroundings: Surroundings::default(),
            report: NdtReport::default(),
            par: Par::Seq,
            arch: Arch::new(),
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

    /// The target.
    pub const fn map(&self) -> &NdtMap {
        &self.map
    }

    /// What is known of the last alignment beyond its result.
    pub const fn report(&self) -> &NdtReport {
        &self.report
    }

    /// Replaces the target by a map of the same voxels, as many clouds or vehicles made it.
    ///
    /// # Errors
    /// [`Error::MapMismatch`], or a map without a voxel of enough points; the last target is then still there.
    pub fn set_map(&mut self, map: &NdtMap) -> Result<(), Error> {
        self.spare.clear();
        self.spare.merge(map)?;
        self.take_spare()
    }

    fn take_spare(&mut self) -> Result<(), Error> {
        let VoxelParams { min_points, .. } = self.params.voxels;
        let most = self.spare.voxels().map(|(_, sums)| sums.count()).max().unwrap_or(0);
        check::at_least("points of the target in a voxel", most as usize, min_points as usize)?;
        std::mem::swap(&mut self.map, &mut self.spare);
        for (doublings, level) in self.levels.iter_mut().enumerate() {
            level.rebuild(&self.map, doublings as u32);
        }
        Ok(())
    }

    /// How far from the optimum a level may stop: the next one walks on. The finest has the caller's word.
    fn descent(&self, doublings: usize) -> DescentParams {
        let descent = self.params.descent;
        if doublings == 0 { descent } else { descent.coarse(self.levels[doublings].edge) }
    }

    /// The cost on a level, looked around for from `pose`.
    fn objective(&mut self, doublings: usize, pose: &Se3) -> ScoreObjective<'_> {
        let finest = doublings == 0;
        if !finest {
            let most = self.source.len() / COARSE_POINTS;
            self.thinned.thin(&self.source, (2 << doublings).min(most));
        }
        let mut objective = ScoreObjective {
            level: &self.levels[doublings],
            source: if finest { &mut self.source } else { &mut self.thinned },
            surroundings: &mut self.surroundings,
            mixture: self.mixtures[doublings],
            search: self.params.search,
            curvature: match self.params.optimizer {
                Optimizer::LineSearch => 1.0,
                Optimizer::TrustRegion if finest => CURVATURE,
                Optimizer::TrustRegion | Optimizer::GaussNewton => 0.0,
            },
            par: self.par,
            arch: self.arch,
        };
        objective.prepare(pose);
        objective
    }

    /// From the coarsest level to the finest; again from where that ended, if it ended badly; and once more with the directions held
    /// that turned out to be free, if that is asked for.
    fn search(&mut self, guess: &Se3) -> (Alignment<Se3>, NdtReport) {
        let (all, nothing) = (self.levels.len(), Matrix6::zeros());
        let Outcome { mut result, mut report, mut still_free } = self.descend(guess, all, &nothing);
        for _ in 0..self.params.restarts {
            if !matches!(result.termination, Termination::IterationLimit | Termination::Stalled | Termination::PoorFit)
            {
                break;
            }
            let again = self.descend(&result.target_from_source, all, &nothing);
            let iterations = result.iterations + again.result.iterations;
            if again.result.inlier_ratio > result.inlier_ratio || again.result.converged() {
                Outcome { result, report, still_free } = again;
            }
            result.iterations = iterations;
        }
        if self.params.hold_unobserved && report.unobserved_count > 0 {
            // What is known of the pose is kept, and the guess's place along the rest (Zhang, Kaess and Singh 2016).
            let (pose, free) = (result.target_from_source, self.params.freedom.projector(guess));
            let held = free * result.unobserved * free;
            let iterations = result.iterations;
            Outcome { result, report, still_free } = self.descend(&pose.plus(&(held * guess.minus(&pose))), 1, &held);
            result.iterations += iterations;
        }
        // Nothing may improve where nothing holds the pose.
        if result.termination == Termination::Stalled && still_free {
            result.termination = Termination::Degenerate;
        }
        (result, report)
    }

    /// Through the finest `levels` levels, from the coarsest of them, without a step along the directions of the projector `held`.
    fn descend(&mut self, guess: &Se3, levels: usize, held: &Matrix6<f64>) -> Outcome {
        let params = self.params;
        let free = params.freedom.projector(guess);
        let keep = (Matrix6::identity() - held) * free * (Matrix6::identity() - held);
        let (mut pose, mut iterations) = (*guess, 0);
        for doublings in (0..levels).rev() {
            let descent = self.descent(doublings);
            let mut objective = self.objective(doublings, &pose);
            let found = params.optimizer.minimize(&mut objective, &descent, &pose, &keep);
            (pose, iterations) = (found.pose, iterations + found.iterations);
            if doublings == 0 {
                return conclude(&mut objective, &params, &found, iterations, [&free, held]);
            }
        }
        // There is a finest level, so that this is not reached.
        Outcome::lost(guess, iterations)
    }
}

/// What a descent on the finest level comes to.
struct Outcome {
    result: Alignment<Se3>,
    report: NdtReport,
    /// Whether a good fit leaves directions free that were not held.
    still_free: bool,
}

impl Outcome {
    /// Nothing was there to be met.
    fn lost(pose: &Se3, iterations: usize) -> Self {
        let mut result = Alignment::unknown(*pose, Termination::TooFewPoints);
        result.iterations = iterations;
        Self { result, report: NdtReport::default(), still_free: false }
    }
}

/// The outcome of a descent on the finest level.
fn conclude(
    objective: &mut ScoreObjective<'_>,
    params: &NdtParams,
    found: &Descent,
    iterations: usize,
    [free, held]: [&Matrix6<f64>; 2],
) -> Outcome {
    let pose = found.pose;
    // The last step may not have been evaluated; and Gauss and Newton's matrix is what an information may be: positive
    // semi-definite.
    objective.curvature = 0.0;
    let last = objective.evaluate(&pose);
    let points = objective.source.len().max(1) as f64;
    if last.matches == 0 || found.termination == Termination::TooFewPoints {
        return Outcome::lost(&pose, iterations);
    }
    // What was held is not asked for again: it is the guess's, whatever the points say where they lie now.
    let left = Matrix6::identity() - held;
    let asked = left * free * left;
    let Fit { inlier_ratio, nearest_likelihood, unobserved } = objective.fit(&pose, params.min_facing_share, &asked);
    let free_directions = unobserved.trace();
    let unobserved = held + unobserved;
    let report = NdtReport {
        transformation_probability: -last.cost / points,
        nearest_likelihood,
        matched_ratio: last.matches as f64 / points,
        unobserved_count: unobserved.trace().round() as usize,
    };
    let is_good = inlier_ratio >= params.min_inlier_ratio;
    let termination = verdict(found.termination, is_good, free_directions);
    let still_free = is_good && free_directions > 0.5;
    let mut result = Alignment::unknown(pose, termination);
    result.iterations = iterations;
    result.unobserved = unobserved + (Matrix6::identity() - free);
    result.information = observed_information::<Se3>(&last.hessian, &result.unobserved);
    (result.score, result.inlier_ratio) = (report.transformation_probability, inlier_ratio);
    Outcome { result, report, still_free }
}

impl Registration for NdtRegistration {
    fn set_target(&mut self, target: &dyn PointSource) -> Result<(), AlignmentError> {
        self.spare.clear();
        self.spare.insert(target, &Se3::identity());
        Ok(self.take_spare()?)
    }

    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        self.report = NdtReport::default();
        if self.map.is_empty() {
            return Err(AlignmentError::NoTarget);
        }
        finite_pose("guess", guess)?;
        self.source.refill(source);
        if self.source.len() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        let (result, report) = self.search(guess);
        if !result.target_from_source.is_finite() {
            return Ok(Alignment::unknown(*guess, Termination::Stalled));
        }
        self.report = report;
        Ok(result)
    }
}

#[cfg(test)]
mod tests;
