//! The normal distributions transform in the plane, for laser scans.
//!
//! Biber and Straßer, *The normal distributions transform: a new approach to laser scan matching* (IROS 2003), over the cells of
//! [`agv_core::grid::GaussianGrid`], coarse to fine, with the mixture of Magnusson 2009 and damped steps of Gauss and Newton.

mod level;
mod params;

pub use params::NdtScanMatcherParams;

use crate::Error;
use crate::registration::verdict;
use agv_core::{
    check,
    geometry::{LieGroup, PoseSigma, Se2, observed_information, unobserved_directions},
    roles::{Alignment, AlignmentError, ScanMatcher, TargetScan, Termination},
    sensors::LaserScan,
};
use level::{Fit, Level, Quadratic};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Damping beyond which no step improves anything.
const MAX_DAMPING: f64 = 1e8;

/// Longest arm at which rotations are compared with translations, in metres.
const ARM: f64 = 2.0;

/// Matches laser scans by normal distributions.
///
/// The [`Alignment`]'s score is that per reading; its information is the Hessian of Gauss and Newton along the directions that are
/// observed. Linear in the readings; a match allocates nothing once its buffer has met scans of that size.
///
/// ```
/// use agv_core::{geometry::Se2, roles::{ScanMatcher, TargetScan}, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_ndt::ndt::{NdtScanMatcher, NdtScanMatcherParams};
///
/// // A room of 8 x 6 m, seen from two places.
/// let scan = |x: f64, y: f64| {
///     let geometry = ScanGeometry::default();
///     let ranges = (0..1081).map(|i| {
///         let (sin, cos) = geometry.angle(i).sin_cos();
///         let along = |o: f64, d: f64, low: f64, high: f64| if d > 0.0 { (high - o) / d } else { (low - o) / d };
///         along(x, cos, -3.0, 5.0).min(along(y, sin, -2.0, 4.0)) as f32
///     });
///     LaserScan::new(Stamp::default(), geometry, ranges.collect())
/// };
/// let mut matcher = NdtScanMatcher::new(NdtScanMatcherParams::default())?;
/// matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &scan(0.0, 0.0)? }])?;
/// let found = matcher.match_scan(&scan(0.3, -0.2)?, &Se2::default())?;
/// assert!(found.converged() && (found.target_from_source.x() - 0.3).abs() < 0.03);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct NdtScanMatcher {
    params: NdtScanMatcherParams,
    /// From the finest to the coarsest; none before there is a target.
    levels: Vec<Level>,
    points: Vec<Vector2<f64>>,
}

/// Where a level's descent ended.
struct Descent {
    pose: Se2,
    quadratic: Quadratic,
    termination: Termination,
    iterations: usize,
}

impl NdtScanMatcher {
    /// A matcher without a target.
    ///
    /// # Errors
    /// The first parameter that is out of its range, by name.
    pub fn new(params: NdtScanMatcherParams) -> Result<Self, Error> {
        params.validate()?;
        // The cells' parameters are checked where they are used.
        Level::new(&[Vector2::zeros()], params.resolution, params.cells, params.outlier_ratio)?;
        Ok(Self { params, levels: Vec::new(), points: Vec::new() })
    }

    /// The parameters.
    pub const fn params(&self) -> &NdtScanMatcherParams {
        &self.params
    }

    /// Damped steps of Gauss and Newton from `start` (Levenberg and Marquardt).
    fn descend(&self, level: &Level, start: &Se2, slack: f64) -> Descent {
        let quadratic = level.evaluate(&self.points, start);
        let mut best = Descent { pose: *start, quadratic, termination: Termination::IterationLimit, iterations: 1 };
        let (mut damping, mut growth) = (1e-4, 2.0);
        loop {
            if best.quadratic.matches == 0 {
                best.termination = Termination::TooFewPoints;
                return best;
            }
            let hessian = best.quadratic.hessian;
            let damped = hessian + Matrix3::from_diagonal(&hessian.diagonal()) * damping + Matrix3::identity() * 1e-9;
            let Some(factor) = damped.cholesky() else {
                best.termination = Termination::Degenerate;
                return best;
            };
            let step: Vector3<f64> = factor.solve(&-best.quadratic.gradient);
            let (moved, turned) = (step.xy().norm(), step.z.abs());
            if moved < slack * self.params.translation_tolerance && turned < slack * self.params.rotation_tolerance {
                best.pose = best.pose.plus(&step);
                best.termination = Termination::Converged;
                return best;
            }
            if best.iterations >= self.params.max_iterations {
                return best;
            }
            let shorter = (0.5 * level.edge / moved.max(1e-12)).min(0.3 / turned.max(1e-12)).min(1.0);
            let trial = best.pose.plus(&(step * shorter));
            let quadratic = level.evaluate(&self.points, &trial);
            best.iterations += 1;
            if quadratic.cost < best.quadratic.cost {
                (best.pose, best.quadratic, growth) = (trial, quadratic, 2.0);
                damping = (damping / 5.0).max(1e-9);
            } else {
                damping = damping.max(1e-4) * growth;
                growth *= 2.0;
                if damping > MAX_DAMPING {
                    best.termination = Termination::Stalled;
                    return best;
                }
            }
        }
    }

    /// The result of a descent on the finest level that began with `guess`.
    fn conclude(&self, level: &Level, found: &Descent, guess: &Se2, iterations: usize) -> Alignment<Se2> {
        let is_finite = found.pose.is_finite() && found.quadratic.cost.is_finite();
        let termination = if is_finite { found.termination } else { Termination::Stalled };
        let mut result = Alignment::unknown(if is_finite { found.pose } else { *guess }, termination);
        result.iterations = iterations;
        if found.termination == Termination::TooFewPoints || !is_finite {
            return result;
        }
        let Fit { inliers, facing, matches } = level.fit(&self.points, &found.pose);
        let counted = matches.max(1) as f64;
        let mean_square = self.points.iter().map(Vector2::norm_squared).sum::<f64>() / self.points.len().max(1) as f64;
        let sigma = PoseSigma { translation: 1.0, rotation: 1.0 / mean_square.sqrt().clamp(1e-3, ARM) };
        let shares = facing / (counted * self.params.min_facing_share);
        let shares = (shares + shares.transpose()) * 0.5;
        result.unobserved = unobserved_directions::<Se2>(&shares, sigma).unwrap_or_else(|_| Matrix3::identity());
        result.information = observed_information::<Se2>(&found.quadratic.hessian, &result.unobserved);
        result.score = -found.quadratic.cost / self.points.len().max(1) as f64;
        result.inlier_ratio = inliers as f64 / self.points.len().max(1) as f64;
        let is_good = result.inlier_ratio >= self.params.min_inlier_ratio;
        result.termination = verdict(found.termination, is_good, result.unobserved.trace());
        result
    }
}

impl ScanMatcher for NdtScanMatcher {
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError> {
        let mut points = Vec::new();
        for TargetScan { target_from_base, scan } in scans {
            check_pose("target_from_base", target_from_base)?;
            points.extend(scan.points_in_base().map(|point| target_from_base.act(&point)));
        }
        check::at_least("readings of the target", points.len(), self.params.min_points)?;
        let level = |doublings: u32| {
            let edge = self.params.resolution * f64::from(1_u32 << doublings);
            Level::new(&points, edge, self.params.cells, self.params.outlier_ratio)
        };
        let levels = (0..=self.params.coarse_levels).map(level).collect::<Result<Vec<_>, _>>()?;
        if levels.iter().any(Level::is_empty) {
            return Err(agv_core::Error::Empty { name: "cells of the target" }.into());
        }
        self.levels = levels;
        Ok(())
    }

    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        check_pose("guess", guess)?;
        let Some(finest) = self.levels.first() else { return Err(AlignmentError::NoTarget) };
        self.points.clear();
        self.points.extend(scan.points_in_base());
        if self.points.len() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        let (mut pose, mut iterations) = (*guess, 0);
        for level in self.levels.iter().skip(1).rev() {
            let found = self.descend(level, &pose, 10.0);
            (pose, iterations) = (found.pose, iterations + found.iterations);
        }
        let found = self.descend(finest, &pose, 1.0);
        Ok(self.conclude(finest, &found, guess, iterations + found.iterations))
    }
}

fn check_pose(name: &'static str, pose: &Se2) -> Result<(), agv_core::Error> {
    check::all_finite(name, &[pose.x(), pose.y(), pose.yaw()])
}

#[cfg(test)]
mod tests;
