//! Matching by climbing: the best of six small moves, again and again, and smaller ones where none is better.
//!
//! The score of a pose `T` is the likelihood field's of the end points `p`,
//!
//! ```text
//! Σ exp(-d(T p)² / 2 σ²)
//! ```
//!
//! with the distance `d` from the surface that each meets. From the guess on, a step forwards, backwards, to the left, to the right, and
//! a turn to either side are tried, and the best is taken; where none is better, steps and turns are halved. So matches `GMapping`
//! (Grisetti, Stachniss and Burgard, *Improved techniques for grid mapping with Rao-Blackwellized particle filters*, 2007, and its
//! `ScanMatcher::optimize`), which asks nothing of the score but that it can be had: no slope, no lines. That costs some fifty to a
//! hundred poses, and the last moves are as fine as the result.

use super::{
    CorrelativeParams,
    refine::{score_at, sum_up},
    squares::ThinnedScan,
    target::{Target, end_points},
    verdict::{End, verdict},
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, PoseSigma, Se2},
    roles::{Alignment, AlignmentError, ScanMatcher, TargetScan, Termination},
    sensors::LaserScan,
};
use nalgebra::Vector3;

/// Parameters of a [`ClimbingMatcher`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ClimbingMatcherParams {
    /// Edge of a cell of the look-up of the nearest surface, in metres.
    pub resolution: f64,
    /// Standard deviation of an end point around the surfaces of the target, in metres. What lies beyond three of them meets nothing: the
    /// guess must be that good.
    pub sigma: f64,
    /// First step, in metres.
    pub step: f64,
    /// First turn, in radians.
    pub turn: f64,
    /// How often steps and turns are halved.
    pub halvings: usize,
    /// Most moves.
    pub max_moves: usize,
    /// Standard deviation of a range, in metres: what the information of a result is built on.
    pub range_sigma: f64,
    /// Fewest usable end points, of the target and of a scan.
    pub min_points: usize,
    /// Least share of end points that must meet the target for the result to be one.
    pub min_inlier_ratio: f64,
    /// Standard deviations beyond which a direction counts as not observed.
    pub observable: PoseSigma,
}

impl Default for ClimbingMatcherParams {
    /// First moves of `GMapping` (0.05 m and 0.05 rad), halved to a millimetre, on the field of the other matchers.
    fn default() -> Self {
        let CorrelativeParams { resolution, sigma, range_sigma, min_points, min_inlier_ratio, observable, .. } =
            CorrelativeParams::default();
        Self {
            resolution,
            sigma,
            step: 0.05,
            turn: 0.05,
            halvings: 6,
            max_moves: 100,
            range_sigma,
            min_points,
            min_inlier_ratio,
            observable,
        }
    }
}

impl ClimbingMatcherParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range; `sigma` must be between half a cell and twenty.
    pub fn validate(&self) -> Result<(), Error> {
        self.lines().validate()?;
        check::positive("step", self.step)?;
        check::positive("turn", self.turn)?;
        check::in_range("halvings", self.halvings as f64, 0.0, 30.0)?;
        check::at_least("max_moves", self.max_moves, 1)?;
        Ok(())
    }

    /// How the target's surfaces are found.
    fn lines(&self) -> CorrelativeParams {
        let Self { resolution, sigma, range_sigma, min_points, min_inlier_ratio, observable, .. } = *self;
        CorrelativeParams {
            resolution,
            sigma,
            range_sigma,
            min_points,
            min_inlier_ratio,
            observable,
            normal_radius: 5.0 * resolution,
            ..Default::default()
        }
    }
}

/// Matches scans by climbing over the score of a likelihood field, as `GMapping` does.
///
/// The score of a result is the mean over the scan's end points of `exp(-d² / 2 σ²)`, with the distance `d` from the surface that
/// each meets, or from its nearest point where that is on no line; the information is that of points on lines at the pose that was
/// found. O(beams) for each of the poses that are tried, which [`Alignment::iterations`] counts.
///
/// ```
/// use agv_core::{geometry::Se2, roles::{ScanMatcher, TargetScan}, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_filters::matching::{ClimbingMatcher, ClimbingMatcherParams};
///
/// // The corner of a room, from (0, 0) and from 0.15 m to the left.
/// let geometry = ScanGeometry { angle_min: -0.5, angle_increment: 0.01, ..Default::default() };
/// let seen_from = |y: f64| {
///     let ranges = (0..200).map(|i| geometry.angle(i)).map(|a| (4.0 / a.cos().max(1e-9)).min((3.0 - y) / a.sin().max(1e-9)) as f32);
///     LaserScan::new(Stamp::default(), geometry, ranges.collect())
/// };
/// let (first, second) = (seen_from(0.0)?, seen_from(0.15)?);
/// let mut matcher = ClimbingMatcher::new(ClimbingMatcherParams::default())?;
/// matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &first }])?;
/// let found = matcher.match_scan(&second, &Se2::default())?;
/// assert!(found.converged() && (found.target_from_source.y() - 0.15).abs() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct ClimbingMatcher {
    params: ClimbingMatcherParams,
    lines: CorrelativeParams,
    target: Option<Target>,
    scan: ThinnedScan,
}

impl ClimbingMatcher {
    /// A matcher without a target.
    ///
    /// # Errors
    /// As [`ClimbingMatcherParams::validate`].
    pub fn new(params: ClimbingMatcherParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, lines: params.lines(), target: None, scan: ThinnedScan::default() })
    }

    /// Its parameters.
    pub const fn params(&self) -> &ClimbingMatcherParams {
        &self.params
    }

    fn align(&self, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        let Some(target) = &self.target else { return Err(AlignmentError::NoTarget) };
        let points = &self.scan.points;
        if points.len() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        let score = |pose: &Se2| score_at(target, points, pose, &self.lines);
        let (pose, termination, iterations) = climb(guess, &self.params, score);
        let sums = sum_up(target, points, &pose, &self.lines);
        let end = End { pose, termination, iterations, score: sums.score, inliers: sums.inliers };
        Ok(verdict(&end, &sums, points, guess, &self.lines)?)
    }
}

/// Climbs from a pose; where it ends, how, and how many poses were scored.
fn climb(start: &Se2, params: &ClimbingMatcherParams, score: impl Fn(&Se2) -> f64) -> (Se2, Termination, usize) {
    let (mut here, mut best) = (*start, score(start));
    let (mut tried, mut moves, mut halvings) = (1, 0, 0);
    let (mut step, mut turn) = (params.step, params.turn);
    while halvings <= params.halvings {
        if moves == params.max_moves {
            return (here, Termination::IterationLimit, tried);
        }
        let from = here;
        for direction in [Vector3::x() * step, Vector3::y() * step, Vector3::z() * turn] {
            for off in [direction, -direction] {
                let there = from.plus(&off);
                let value = score(&there);
                tried += 1;
                if value > best {
                    (here, best) = (there, value);
                }
            }
        }
        if here == from {
            (step, turn, halvings) = (0.5 * step, 0.5 * turn, halvings + 1);
        } else {
            moves += 1;
        }
    }
    (here, Termination::Converged, tried)
}

impl ScanMatcher for ClimbingMatcher {
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError> {
        self.target = Some(Target::new(&end_points(scans)?, &self.lines)?);
        Ok(())
    }

    /// Allocates nothing once a scan of as many beams was matched.
    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        check::all_finite("guess", &[guess.x(), guess.y(), guess.yaw()])?;
        self.scan.refill(scan, self.params.resolution);
        self.align(guess)
    }
}
