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
//! in the points. What comes out is measured, not believed: steps that touch an obstacle take the given path again.

mod problem;

use super::straight::{heading, piece_end, write_piece};
use crate::Error;
use agv_core::{
    check,
    geometry::Se2,
    grid::{Footprint, ObstacleMap},
    path::{Gear, Path, PathPoint},
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
    /// length.
    pub max_curvature: f64,
    /// Samples that had to stay on the given path, since the smooth one touched an obstacle there.
    pub kept: usize,
    /// Samples in all.
    pub samples: usize,
}

/// Smooths paths for vehicles that cannot turn on the spot; owns the memory that it needs for it.
///
/// Cusps and turns on the spot part the path into pieces, whose ends stay where they are. The result touches nothing that
/// the given path does not touch. Whether the curvature was reached everywhere is said, not promised: bends that are tighter
/// than the room around them allows, and the headings at the ends of pieces, which are those of the first and last step, may
/// stand against it.
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
        let (given, moved, anchors, uneven, keep) = Default::default();
        Ok(Self { params, solver, workspace, given, moved, anchors, uneven, keep })
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
                Ok(write_piece(piece, &self.moved, smooth)?)
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
        let step = resample(&self.uneven, steps as usize, &mut self.given);
        self.moved.clone_from(&self.given);
        self.anchors.clone_from(&self.given);
        if self.given.len() < 3 {
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
            step = resample(&self.uneven, self.given.len() - 1, &mut self.moved);
            self.anchors.clone_from(&self.moved);
            params.curvature_weight *= 10.0;
        }
        let kept = self.fall_back(obstacles, footprint, piece)?;
        Ok((kept, greatest_curvature(&self.moved)))
    }

    /// Puts points back to where they were given until no step touches an obstacle that the given path does not touch.
    fn fall_back(
        &mut self,
        obstacles: &ObstacleMap,
        footprint: &Footprint,
        piece: &[PathPoint],
    ) -> Result<usize, Error> {
        let gear = piece.last().map_or(Gear::Forward, |point| point.gear);
        let last = self.moved.len() - 1;
        self.keep.clear();
        self.keep.resize(self.moved.len(), false);
        // Each round puts at least one point back.
        let mut reach = 1;
        loop {
            let mut changed = false;
            for index in 0..last {
                if self.keep[index] && self.keep[index + 1] {
                    continue;
                }
                let ends = [self.moved[index], self.moved[index + 1]];
                if !collides(obstacles, footprint, ends, gear)? {
                    continue;
                }
                let around = index.saturating_sub(reach - 1)..=(index + reach).min(last);
                for i in around {
                    changed |= !self.keep[i];
                    (self.keep[i], self.moved[i]) = (true, self.given[i]);
                }
            }
            if !changed {
                return Ok(self.keep.iter().filter(|&&keep| keep).count());
            }
            reach *= 2;
        }
    }
}

/// Whether the vehicle, looking along it, touches anything on a straight step.
fn collides(
    obstacles: &ObstacleMap,
    footprint: &Footprint,
    [from, to]: [Vector2<f64>; 2],
    gear: Gear,
) -> Result<bool, Error> {
    let heading = heading(from, to, gear).unwrap_or_default();
    let [from, to] = [from, to].map(|position| Se2::from_parts(position, heading));
    Ok(obstacles.collides_between(footprint, &from, &to)?)
}

fn polyline_length(line: &[Vector2<f64>]) -> f64 {
    line.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

/// Points on a line at so many even steps, both ends included; the step.
fn resample(line: &[Vector2<f64>], steps: usize, points: &mut Vec<Vector2<f64>>) -> f64 {
    points.clear();
    let step = polyline_length(line) / steps as f64;
    let (mut travelled, mut next) = (0.0, 0.0);
    for pair in line.windows(2) {
        let length = (pair[1] - pair[0]).norm();
        while next <= travelled + length && points.len() < steps {
            let part = if length > 0.0 { (next - travelled) / length } else { 0.0 };
            points.push(pair[0] + (pair[1] - pair[0]) * part);
            next = step * points.len() as f64;
        }
        travelled += length;
    }
    points.extend(line.last());
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
mod tests {
    use super::*;
    use crate::grid::{AStar, AStarParams};
    use crate::smooth::{KeyNodes, KeyNodesParams, Straightened};
    use agv_core::geometry::So2;
    use agv_core::grid::{Cell, CellState, CollisionParams, Grid, GridLayout, Inflation, InflationParams};
    use agv_core::roles::{GlobalPlanner, PlanOutcome};
    use proptest::prelude::*;

    fn smoother() -> CurvatureSmoother {
        CurvatureSmoother::new(CurvatureSmootherParams::default()).unwrap()
    }

    fn touches(obstacles: &ObstacleMap, footprint: &Footprint, path: &Path) -> bool {
        path.points().windows(2).any(|pair| {
            let ends = [pair[0].pose.translation(), pair[1].pose.translation()];
            collides(obstacles, footprint, ends, pair[1].gear).unwrap()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        /// Among pillars, with the outline of a circle: free where the planned path is free.
        #[test]
        fn smooth_paths_touch_nothing(pillars in proptest::collection::vec((8_i32..72, 8_i32..72), 0..25)) {
            let layout = GridLayout::new(80, 80, 0.1, Se2::new(1.0, -2.0, 0.3)).unwrap();
            let mut map = Grid::filled(layout, CellState::Free);
            for (x, y) in pillars {
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    map.set(Cell::new(x + dx, y + dy), CellState::Occupied);
                }
            }
            let footprint = Footprint::circle(0.25).unwrap();
            let params = InflationParams { inscribed_radius: 0.45, inflation_radius: 0.45, ..Default::default() };
            let costmap = Inflation::new(params).unwrap().inflate(&map).unwrap();
            let pose = |x, y| Se2::from_parts(layout.center(Cell::new(x, y)), So2::default());
            let mut planner = Straightened::new(
                AStar::new(AStarParams::default()).unwrap(),
                KeyNodes::new(KeyNodesParams::default()).unwrap(),
            );
            let (mut path, mut smooth) = (Path::new(), Path::new());
            let outcome = planner.plan_into(&costmap, &pose(4, 4), &pose(75, 75), &mut path).unwrap();
            let found = matches!(outcome, PlanOutcome::Found { .. });
            prop_assume!(found);
            let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(2.0)).unwrap();
            prop_assume!(!touches(&obstacles, &footprint, &path));
            let outcome = smoother().smooth_into(&obstacles, &footprint, &path, &mut smooth).unwrap();
            prop_assert!(!touches(&obstacles, &footprint, &smooth));
            prop_assert_eq!(smooth.points()[0].pose, pose(4, 4));
            prop_assert_eq!(smooth.points()[smooth.len() - 1].pose, pose(75, 75));
            let mut sampled = Vec::new();
            let line: Vec<_> = path.points().iter().map(|p| p.pose.translation()).collect();
            resample(&line, outcome.samples - 1, &mut sampled);
            let before = greatest_curvature(&sampled);
            prop_assert!(outcome.kept > 0 || outcome.max_curvature <= before.max(1.0), "{:?} {}", outcome, before);
        }
    }

    #[test]
    fn corners_are_rounded_to_the_radius() {
        let map = Grid::filled(GridLayout::new(200, 200, 0.1, Se2::default()).unwrap(), CellState::Free);
        let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(1.0)).unwrap();
        let zigzag = [(2.0, 2.0), (10.0, 2.0), (10.0, 10.0), (4.0, 16.0)].map(|(x, y)| Vector2::new(x, y));
        for max_curvature in [0.5, 1.0, 2.0] {
            let params = CurvatureSmootherParams { max_curvature, ..Default::default() };
            let mut smooth = Path::new();
            let outcome = CurvatureSmoother::new(params).unwrap().smooth_into(
                &obstacles,
                &Footprint::rectangle(-0.5, 0.5, 0.6).unwrap(),
                &Path::from_positions(&zigzag).unwrap(),
                &mut smooth,
            );
            let outcome = outcome.unwrap();
            assert!(outcome.max_curvature <= max_curvature && outcome.kept == 0, "{max_curvature}: {outcome:?}");
            assert!(smooth.length() < Path::from_positions(&zigzag).unwrap().length());
        }
    }

    #[test]
    fn samples_are_even_and_ends_exact() {
        let line = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.55)].map(|(x, y)| Vector2::new(x, y));
        let mut points = Vec::new();
        let step = resample(&line, 16, &mut points);
        assert_eq!(points.len(), 17);
        assert!((step - 1.55 / 16.0).abs() < 1e-12);
        assert_eq!((points[0], points[16]), (Vector2::zeros(), Vector2::new(1.0, 0.55)));
    }

    #[test]
    fn bad_input_is_named() {
        let default = CurvatureSmootherParams::default();
        for params in [
            CurvatureSmootherParams { max_curvature: 0.0, ..default },
            CurvatureSmootherParams { spacing: f64::NAN, ..default },
            CurvatureSmootherParams { clearance: -0.1, ..default },
            CurvatureSmootherParams { path_weight: f64::INFINITY, ..default },
        ] {
            assert!(CurvatureSmoother::new(params).is_err(), "{params:?}");
        }
        let map = Grid::filled(GridLayout::new(20, 20, 0.1, Se2::default()).unwrap(), CellState::Free);
        let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(1.0)).unwrap();
        let footprint = Footprint::circle(0.2).unwrap();
        let far = Path::from_positions(&[Vector2::zeros(), Vector2::new(1e9, 0.0)]).unwrap();
        let mut smooth = far.clone();
        assert!(smoother().smooth_into(&obstacles, &footprint, &far, &mut smooth).is_err() && smooth.is_empty());
        for few in [&[][..], &[Vector2::new(1.0, 1.0)], &[Vector2::new(1.0, 1.0), Vector2::new(1.02, 1.0)]] {
            let path = Path::from_positions(few).unwrap();
            let outcome = smoother().smooth_into(&obstacles, &footprint, &path, &mut smooth).unwrap();
            assert!(smooth == path && outcome.max_curvature == 0.0);
        }
    }
}
