//! Registration.

use super::gaussian::VoxelParams;
use super::level::Level;
use super::map::NdtMap;
use super::mixture::Mixture;
use super::objective::{ScoreObjective, SourcePoints};
use super::search::{Surroundings, VoxelSearch};
use crate::Error;
use crate::registration::{Descent, DescentParams, LevenbergMarquardt, Objective};
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3},
    roles::{Alignment, AlignmentError, Registration, Termination},
    sensors::PointSource,
};
use nalgebra::Matrix6;
use pulp::Arch;

/// Parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NdtParams {
    /// Voxels.
    pub voxels: VoxelParams,
    /// Share of outliers.
    pub outlier_ratio: f64,
    /// Neighbours.
    pub search: VoxelSearch,
    /// Coarser levels.
    pub coarse_levels: u32,
    /// Descent.
    pub descent: DescentParams,
}

impl Default for NdtParams {
    fn default() -> Self {
        Self {
            voxels: VoxelParams::default(),
            outlier_ratio: 0.55,
            search: VoxelSearch::Direct7,
            coarse_levels: 2,
            descent: DescentParams::default(),
        }
    }
}

/// NDT.
#[derive(Debug, Clone)]
pub struct NdtRegistration {
    params: NdtParams,
    map: NdtMap,
    levels: Vec<Level>,
    mixtures: Vec<Mixture>,
    source: SourcePoints,
    thinned: SourcePoints,
    surroundings: Surroundings,
    optimizer: LevenbergMarquardt,
    par: Par,
    arch: Arch,
}

fn env(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

impl NdtRegistration {
    /// New.
    ///
    /// # Errors
    /// Bad params.
    pub fn new(params: NdtParams) -> Result<Self, Error> {
        check::in_range("coarse_levels", f64::from(params.coarse_levels), 0.0, 6.0)?;
        let levels = vec![Level::default(); params.coarse_levels as usize + 1];
        let edges = (0..=params.coarse_levels).map(|d| params.voxels.resolution * f64::from(1_u32 << d));
        Ok(Self {
            map: NdtMap::new(params.voxels)?,
            levels,
            mixtures: edges.map(|edge| Mixture::new(params.outlier_ratio, edge)).collect::<Result<_, _>>()?,
            source: SourcePoints::default(),
            thinned: SourcePoints::default(),
            surroundings: Surroundings::default(),
            optimizer: LevenbergMarquardt::new(params.descent)?,
            par: Par::Seq,
            arch: Arch::new(),
            params,
        })
    }

    /// Par.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }
}

impl Registration for NdtRegistration {
    fn set_target(&mut self, target: &dyn PointSource) -> Result<(), AlignmentError> {
        self.map.clear();
        self.map.insert(target, &Se3::default());
        for (doublings, level) in self.levels.iter_mut().enumerate() {
            level.rebuild(&self.map, doublings as u32);
        }
        Ok(())
    }

    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError> {
        self.source.refill(source);
        let mut pose = *guess;
        let mut result = Alignment::unknown(pose, Termination::TooFewPoints);
        let verbose = env("NDT_VERBOSE", 0.0) > 0.0;
        for doublings in (0..self.levels.len()).rev() {
            let full = doublings == 0;
            if !full {
                self.thinned.thin(&self.source, (env("NDT_STRIDE", 2.0) as usize) << doublings);
            }
            let mut objective = ScoreObjective {
                level: &self.levels[doublings],
                source: if full { &mut self.source } else { &mut self.thinned },
                surroundings: &mut self.surroundings,
                mixture: self.mixtures[doublings],
                search: self.params.search,
                curvature: env("NDT_CURVATURE", 1.0),
                par: self.par,
                arch: self.arch,
            };
            let t0 = std::time::Instant::now();
            objective.prepare(&pose);
            let t1 = t0.elapsed();
            let optimizer = if full { self.optimizer } else {
                LevenbergMarquardt::new(DescentParams { translation_tolerance: 0.02, rotation_tolerance: 0.004, ..self.params.descent })?
            };
            let found: Descent = optimizer.minimize(&mut objective, &pose, &Matrix6::identity());
            let t2 = t0.elapsed();
            if verbose {
                eprintln!("level {doublings}: n {} prepare {:?} descent {:?} iterations {} {:?} cost {} step {:?}", objective.source.len(), t1, t2 - t1, found.iterations, found.termination, found.quadratic.cost, found.pose.minus(&pose).as_slice());
            }
            pose = found.pose;
            result.iterations += found.iterations;
            result.termination = found.termination;
            result.target_from_source = pose;
            result.score = -found.quadratic.cost / objective.source.len() as f64;
            result.inlier_ratio = found.quadratic.matches as f64 / objective.source.len() as f64;
        }
        Ok(result)
    }
}
