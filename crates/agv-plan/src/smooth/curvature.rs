//! Smoothing to a bounded curvature, checked against the map with the vehicle's outline.
//!
//! The path is sampled at even steps `h`, and its points `p` move to the least of
//!
//! ```text
//! Σ  ½ w_smooth |k_i|²  +  ½ w_curvature max(0, |k_i| - 0.95 κ_max)²        k_i = (p_(i-1) - 2 p_i + p_(i+1)) / h²
//!  + ½ w_obstacle max(0, d_wanted - d(p_i))²                                d: distance to the nearest obstacle
//!  + ½ w_path |p_i - p_i⁰|²
//! ```
//!
//! with both ends held (the terms of Nav2's constrained smoother). `k` is the curvature vector plus the unevenness of the
//! steps, so that one term keeps both small. The sums have a band of five, and Levenberg–Marquardt solves them in time linear
//! in the points. What comes out is measured, not believed: where it touches an obstacle, the given path is taken again.

mod fall_back;
mod problem;

use super::straight::{piece_end, write_piece};
use crate::Error;
use agv_core::{
    check,
    grid::{Footprint, ObstacleMap},
    path::{Path, PathPoint},
    solve::{BandedNormalEquations, LeastSquaresWorkspace, LevenbergMarquardt, LevenbergMarquardtParams},
};
use nalgebra::Vector2;
use problem::Problem;

/// Parameters of a [`CurvatureSmoother`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CurvatureSmootherParams {
    /// Greatest curvature, per metre: the inverse of the turning radius.
    pub max_curvature: f64,
    /// Distance of the samples, in metres.
    pub spacing: f64,
    /// Distance that the outline's inscribed circle wants to keep from obstacles, in metres; held where there is room.
    pub clearance: f64,
    /// Weight of curvature everywhere: how far bends are drawn out.
    pub smooth_weight: f64,
    /// Weight of curvature beyond the greatest.
    pub curvature_weight: f64,
    /// Weight of too little clearance, per square metre.
    pub obstacle_weight: f64,
    /// Weight of the distance from the given path, per square metre.
    pub path_weight: f64,
    /// Most steps of the solver.
    pub max_iterations: usize,
}

impl Default for CurvatureSmootherParams {
    /// For a vehicle that turns within a metre; Nav2's constrained smoother too has curvature and obstacles weigh far more than
    /// smoothness, and the given path next to nothing.
    fn default() -> Self {
        Self {
            max_curvature: 1.0,
            spacing: 0.1,
            clearance: 0.1,
            smooth_weight: 0.05,
            curvature_weight: 20.0,
            obstacle_weight: 200.0,
            path_weight: 0.01,
            max_iterations: 100,
        }
    }
}

/// What came of smoothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothOutcome {
    /// Greatest curvature between the samples of a piece, per metre, as the turn from one step to the next over their mean
    /// length; corners between samples that stayed are among these.
    pub max_curvature: f64,
    /// Samples that had to stay on the given path, since the smooth one touched an obstacle there.
    pub kept: usize,
    /// Samples in all.
    pub samples: usize,
}

/// Smooths paths for vehicles that cannot turn on the spot; owns the memory that it needs for it.
///
/// Cusps and turns on the spot part the path into pieces, whose end poses stay as they are. The result, driven straight from
/// point to point with turns on the spot between, touches nothing that the given path does not touch: where it would, it follows
/// the given path, corners included. Whether the curvature was reached everywhere is said, not promised: bends that are tighter
/// than the room around them allows may stand against it, and so may the given headings at the ends of pieces, from and to which
/// the vehicle may have to turn.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, CollisionParams, Footprint, Grid, GridLayout, ObstacleMap};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_plan::smooth::{CurvatureSmoother, CurvatureSmootherParams};
///
/// let map = Grid::filled(GridLayout::new(100, 100, 0.1, Se2::default())?, CellState::Free);
/// let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(1.0))?;
/// let corner = Path::from_positions(&[(2.0, 2.0), (8.0, 2.0), (8.0, 8.0)].map(|(x, y)| Vector2::new(x, y)))?;
/// let mut smoother = CurvatureSmoother::new(CurvatureSmootherParams::default())?;
/// let mut smooth = Path::new();
/// let outcome = smoother.smooth_into(&obstacles, &Footprint::circle(0.3)?, &corner, &mut smooth)?;
/// assert!(outcome.max_curvature <= 1.0 && outcome.kept == 0);
/// # Ok::<(), agv_plan::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CurvatureSmoother {
    params: CurvatureSmootherParams,
    solver: LevenbergMarquardt,
    workspace: LeastSquaresWorkspace<BandedNormalEquations, Vec<Vector2<f64>>>,
    /// The given path, sampled; and the points that move.
    given: Vec<Vector2<f64>>,
    moved: Vec<Vector2<f64>>,
    /// Where points would stay.
    anchors: Vec<Vector2<f64>>,
    /// Points before they are sampled.
    uneven: Vec<Vector2<f64>>,
    /// Line of the given path on which each sample lies, by the index of the point that it starts from.
    lines: Vec<usize>,
    keep: Vec<bool>,
}

/// How often a path that is still too tight is sampled anew and moved again.
const ROUNDS: usize = 4;

impl CurvatureSmoother {
    /// Most samples of a path.
    pub const MAX_SAMPLES: usize = 1_000_000;

    /// Checks the parameters.
    ///
    /// # Errors
    /// A curvature, spacing or weight that is not finite and positive, a negative clearance.
    pub fn new(params: CurvatureSmootherParams) -> Result<Self, Error> {
        for (name, value) in [
            ("max_curvature", params.max_curvature),
            ("spacing", params.spacing),
            ("smooth_weight", params.smooth_weight),
            ("curvature_weight", params.curvature_weight),
            ("obstacle_weight", params.obstacle_weight),
            ("path_weight", params.path_weight),
        ] {
            check::positive(name, value)?;
        }
        check::non_negative("clearance", params.clearance)?;
        let solver = LevenbergMarquardt::new(LevenbergMarquardtParams {
            max_iterations: params.max_iterations,
            // All terms but the hinges are linear: a start without damping is a good one, and with it long bends creep.
            initial_damping: 1e-12,
            cost_tolerance: 1e-9,
            ..Default::default()
        })?;
        let workspace = LeastSquaresWorkspace::new(BandedNormalEquations::default(), Vec::new());
        let (given, moved, anchors, uneven) = Default::default();
        let (lines, keep) = Default::default();
        Ok(Self { params, solver, workspace, given, moved, anchors, uneven, lines, keep })
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &CurvatureSmootherParams {
        &self.params
    }

    /// Writes the smooth path, reusing its memory, and says how smooth it became.
    ///
    /// # Errors
    /// A path of more than [`MAX_SAMPLES`](Self::MAX_SAMPLES) samples, or one so far off the map that it cannot be checked;
    /// `smooth` is then empty.
    pub fn smooth_into(
        &mut self,
        obstacles: &ObstacleMap,
        footprint: &Footprint,
        path: &Path,
        smooth: &mut Path,
    ) -> Result<SmoothOutcome, Error> {
        smooth.clear();
        let samples = path.length() / self.params.spacing;
        check::in_range("samples of the path", samples, 0.0, Self::MAX_SAMPLES as f64)?;
        let mut outcome = SmoothOutcome { max_curvature: 0.0, kept: 0, samples: 0 };
        let mut points: &[PathPoint] = path.points();
        while let Some(end) = piece_end(points) {
            let (piece, rest) = points.split_at(end + 1);
            let done = self.smooth_piece(obstacles, footprint, piece).and_then(|(kept, curvature)| {
                outcome.samples += self.moved.len();
                outcome.kept += kept;
                outcome.max_curvature = outcome.max_curvature.max(curvature);
                if self.keep.iter().all(|&keep| keep) {
                    // As it was given, with its headings.
                    return Ok(piece.iter().skip(usize::from(!smooth.is_empty())).try_for_each(|p| smooth.push(*p))?);
                }
                self.join_corners(piece);
                Ok(write_piece(piece, &self.uneven, smooth)?)
            });
            if let Err(error) = done {
                smooth.clear();
                return Err(error);
            }
            points = if rest.is_empty() { rest } else { &points[end..] };
        }
        Ok(outcome)
    }

    /// Leaves the points of a smooth piece in `moved`; how many had to stay, and the greatest curvature.
    fn smooth_piece(
        &mut self,
        obstacles: &ObstacleMap,
        footprint: &Footprint,
        piece: &[PathPoint],
    ) -> Result<(usize, f64), Error> {
        self.uneven.clear();
        self.uneven.extend(piece.iter().map(|point| point.pose.translation()));
        let steps = (polyline_length(&self.uneven) / self.params.spacing).ceil().max(1.0);
        self.lines.clear();
        let step = resample(&self.uneven, steps as usize, &mut self.given, |line| self.lines.push(line));
        self.moved.clone_from(&self.given);
        self.anchors.clone_from(&self.given);
        if self.given.len() < 3 {
            self.keep.clear();
            self.keep.resize(self.given.len(), true);
            return Ok((0, 0.0));
        }
        // From the centre of an obstacle's cell to its corner is up to 0.71 cells.
        let resolution = obstacles.layout().resolution();
        let wanted = footprint.inscribed_radius() + self.params.clearance + 0.71 * resolution;
        let mut params = self.params;
        let mut step = step;
        for round in 1..=ROUNDS {
            let mut problem = Problem { params: &params, anchors: &self.anchors, obstacles, wanted, step };
            self.workspace.system.reset(2 * self.given.len(), 5);
            self.solver.minimize_structured(&mut problem, &mut self.moved, &mut self.workspace)?;
            if round == ROUNDS || greatest_curvature(&self.moved) <= params.max_curvature {
                break;
            }
            // The bends have become shorter, and with them the steps; what is still too tight weighs more.
            std::mem::swap(&mut self.moved, &mut self.uneven);
            step = resample(&self.uneven, self.given.len() - 1, &mut self.moved, |_| ());
            self.anchors.clone_from(&self.moved);
            params.curvature_weight *= 10.0;
        }
        let kept = self.fall_back(obstacles, footprint, piece)?;
        Ok((kept, greatest_curvature(&self.moved)))
    }
}

fn polyline_length(line: &[Vector2<f64>]) -> f64 {
    line.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// Points on a line at so many even steps, both ends included; the step. Each is told with the index of the stretch on which it
/// lies; one that rounding alone parts from a corner is the corner.
fn resample(
    line: &[Vector2<f64>],
    steps: usize,
    points: &mut Vec<Vector2<f64>>,
    mut lies_on: impl FnMut(usize),
) -> f64 {
    points.clear();
    let step = polyline_length(line) / steps as f64;
    let (mut travelled, mut next) = (0.0, 0.0);
    for (stretch, pair) in line.windows(2).enumerate() {
        let length = (pair[1] - pair[0]).norm();
        while next <= travelled + length && points.len() < steps {
            let along = next - travelled;
            points.push(if along < 1e-6 * step {
                pair[0]
            } else if length - along < 1e-6 * step {
                pair[1]
            } else {
                pair[0] + (pair[1] - pair[0]) * (along / length)
            });
            lies_on(stretch);
            next = step * points.len() as f64;
        }
        travelled += length;
    }
    points.extend(line.last());
    lies_on(line.len().saturating_sub(2));
    step
}

/// Greatest turn from one step to the next over their mean length.
fn greatest_curvature(points: &[Vector2<f64>]) -> f64 {
    let bends = points.windows(3).map(|p| {
        let (a, b) = (p[1] - p[0], p[2] - p[1]);
        let mean = 0.5 * (a.norm() + b.norm());
        if mean > 0.0 { a.perp(&b).atan2(a.dot(&b)).abs() / mean } else { 0.0 }
    });
    bends.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
