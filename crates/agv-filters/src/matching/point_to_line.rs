//! Iterated closest points with the metric of points and lines.
//!
//! Each end point `p` is held against the line through the point `t` of the target that is nearest to it (Censi, *An ICP variant using a
//! point-to-line metric*, 2008, Eq. 3), or against that point where it is on no line:
//!
//! ```text
//! Σ (nᵀ (T p - t))²        H = Σ JᵀJ        J = nᵀ R [ I | (-p_y, p_x)ᵀ ]
//! ```
//!
//! A step of Gauss and Newton, then the nearest points anew. Censi solves each round exactly, in closed form; a step comes to rest at the
//! same poses, as near to them as quickly.
//!
//! Which pairs count: at first all up to `max_distance`, then those within three standard deviations of the residuals of the last round
//! (Zhang, *Iterative point matching for registration of free-form curves and surfaces*, 1994, section 3.3). Far off, everything pulls; near
//! the end, what the target does not show does not. Censi keeps a fixed share of the pairs, which in a corridor that is longer than wide
//! throws out just the ends, the only ones that say how far along it the vehicle is.

use super::{
    CorrelativeParams,
    refine::{NEARLY_AT_REST, sum_up},
    squares::ThinnedScan,
    target::{REACH, Surface, Target, end_points},
    verdict::{End, verdict},
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, PoseSigma, Se2},
    roles::{Alignment, AlignmentError, ScanMatcher, TargetScan, Termination},
    sensors::LaserScan,
};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Parameters of a [`PointToLineMatcher`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PointToLineParams {
    /// Edge of a cell of the look-up of the nearest point, in metres.
    pub resolution: f64,
    /// Farthest that an end point may be from what it is held against, in metres: from how far off it is led home.
    pub max_distance: f64,
    /// Standard deviations of the residuals beyond which a pair does not count.
    pub cut: f64,
    /// Standard deviation of an end point around the surfaces of the target, in metres: of the result's score.
    pub sigma: f64,
    /// Standard deviation of a range, in metres: what the information of a result is built on, where the scan does not fit worse.
    pub range_sigma: f64,
    /// Radius around an end point of the target whose neighbours make its line, in metres.
    pub normal_radius: f64,
    /// Most rounds.
    pub max_iterations: usize,
    /// Fewest usable end points, of the target and of a scan.
    pub min_points: usize,
    /// Least share of end points that must meet the target for the result to be one.
    pub min_inlier_ratio: f64,
    /// Standard deviations beyond which a direction counts as not observed.
    pub observable: PoseSigma,
}

impl Default for PointToLineParams {
    /// Pairs up to 0.9 m, three standard deviations as Zhang's, and surfaces as the other matchers find them.
    fn default() -> Self {
        let CorrelativeParams {
            resolution,
            sigma,
            range_sigma,
            normal_radius,
            min_points,
            min_inlier_ratio,
            observable,
            ..
        } = CorrelativeParams::default();
        Self {
            resolution,
            max_distance: 0.9,
            cut: 3.0,
            sigma,
            range_sigma,
            normal_radius,
            max_iterations: 40,
            min_points,
            min_inlier_ratio,
            observable,
        }
    }
}

impl PointToLineParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range; `max_distance` must be between three `sigma` and sixty cells.
    pub fn validate(&self) -> Result<(), Error> {
        self.lines().validate()?;
        let (least, most) = (REACH * self.sigma, REACH * 20.0 * self.resolution);
        check::in_range("max_distance", self.max_distance, least, most)?;
        check::in_range("cut", self.cut, 1.0, 100.0)?;
        check::at_least("max_iterations", self.max_iterations, 1)?;
        Ok(())
    }

    /// How surfaces are found, and what is near at the end.
    fn lines(&self) -> CorrelativeParams {
        let Self { resolution, sigma, range_sigma, normal_radius, min_points, min_inlier_ratio, observable, .. } =
            *self;
        CorrelativeParams {
            resolution,
            sigma,
            range_sigma,
            min_points,
            min_inlier_ratio,
            normal_radius,
            observable,
            ..Default::default()
        }
    }
}

/// Matches scans by iterated closest points with the metric of points and lines (Censi 2008).
///
/// The score of a result is the mean over the scan's end points of `exp(-d² / 2 σ²)`, with the distance `d` from the surface that
/// each meets; the information is that of points on lines at the pose that was found. O(beams) a round.
///
/// ```
/// use agv_core::{geometry::Se2, roles::{ScanMatcher, TargetScan}, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_filters::matching::{PointToLineMatcher, PointToLineParams};
///
/// // The corner of a room, from (0, 0) and from 0.5 m to the left.
/// let geometry = ScanGeometry { angle_min: -0.5, angle_increment: 0.01, ..Default::default() };
/// let seen_from = |y: f64| {
///     let ranges = (0..200).map(|i| geometry.angle(i)).map(|a| (4.0 / a.cos().max(1e-9)).min((3.0 - y) / a.sin().max(1e-9)) as f32);
///     LaserScan::new(Stamp::default(), geometry, ranges.collect())
/// };
/// let (first, second) = (seen_from(0.0)?, seen_from(0.5)?);
/// let mut matcher = PointToLineMatcher::new(PointToLineParams::default())?;
/// matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &first }])?;
/// let found = matcher.match_scan(&second, &Se2::default())?;
/// assert!(found.converged() && (found.target_from_source.y() - 0.5).abs() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct PointToLineMatcher {
    params: PointToLineParams,
    lines: CorrelativeParams,
    target: Option<Target>,
    scan: ThinnedScan,
}

/// Steps below this are the end, in metres and radians.
const AT_REST: f64 = 1e-5;

/// What the pairs of a round sum up to.
struct Round {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Sum of the squared residuals, and how many there are.
    squares: f64,
    pairs: usize,
}

impl PointToLineMatcher {
    /// A matcher without a target.
    ///
    /// # Errors
    /// As [`PointToLineParams::validate`].
    pub fn new(params: PointToLineParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, lines: params.lines(), target: None, scan: ThinnedScan::default() })
    }

    /// Its parameters.
    pub const fn params(&self) -> &PointToLineParams {
        &self.params
    }

    fn align(&self, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        let Some(target) = &self.target else { return Err(AlignmentError::NoTarget) };
        let points = &self.scan.points;
        if points.len() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        let (pose, termination, iterations) = self.descend(target, points, guess);
        let sums = sum_up(target, points, &pose, &self.lines);
        let end = End { pose, termination, iterations, score: sums.score, inliers: sums.inliers };
        Ok(verdict(&end, &sums, points, guess, &self.lines)?)
    }

    /// Rounds from a pose on; where they end, how, and how many they were.
    fn descend(&self, target: &Target, points: &[Vector2<f64>], start: &Se2) -> (Se2, Termination, usize) {
        let PointToLineParams { max_distance, cut, range_sigma, observable, max_iterations, resolution, .. } =
            self.params;
        // As if the present pose were known as well as a direction that just counts as observed.
        let damping = [observable.translation, observable.translation, observable.rotation]
            .map(|sigma| (range_sigma / sigma).powi(2));
        let damping = Matrix3::from_diagonal(&Vector3::from(damping));
        let (mut pose, mut limit, mut length) = (*start, max_distance, f64::INFINITY);
        for round in 0..max_iterations {
            let sums = sum_pairs(target, points, &pose, limit, max_distance);
            let Some(factor) = (sums.hessian + damping).cholesky() else {
                return (pose, Termination::IterationLimit, round);
            };
            let step = factor.solve(&-sums.gradient);
            pose = pose.plus(&step);
            length = step.amax();
            if length <= AT_REST {
                return (pose, Termination::Converged, round + 1);
            }
            let spread = (sums.squares / sums.pairs.max(1) as f64).sqrt();
            limit = (cut * spread).clamp(cut * range_sigma, limit.max(cut * range_sigma));
        }
        // Two points that are equally near take turns.
        let is_near = length <= NEARLY_AT_REST * resolution;
        (pose, if is_near { Termination::Converged } else { Termination::IterationLimit }, max_iterations)
    }
}

/// The pairs at a pose whose residuals are within a limit.
fn sum_pairs(target: &Target, points: &[Vector2<f64>], pose: &Se2, limit: f64, max_distance: f64) -> Round {
    let mut round = Round { hessian: Matrix3::zeros(), gradient: Vector3::zeros(), squares: 0.0, pairs: 0 };
    let back = pose.rotation().inverse();
    for point in points {
        let place = pose.act(point);
        let Some(Surface { point: nearest, normal, .. }) = target.nearest(&place) else { continue };
        let off = place - nearest;
        let on_line = normal != Vector2::zeros();
        let squared = if on_line { normal.dot(&off).powi(2) } else { off.norm_squared() };
        if squared > limit * limit || off.norm_squared() > max_distance * max_distance {
            continue;
        }
        let mut add = |normal: Vector2<f64>| {
            let local = back.act(&normal);
            let jacobian = Vector3::new(local.x, local.y, local.y * point.x - local.x * point.y);
            round.hessian += jacobian * jacobian.transpose();
            round.gradient += jacobian * normal.dot(&off);
        };
        if on_line {
            add(normal);
        } else {
            add(Vector2::x());
            add(Vector2::y());
        }
        round.squares += squared;
        round.pairs += 1;
    }
    round
}

impl ScanMatcher for PointToLineMatcher {
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError> {
        let wide = CorrelativeParams { sigma: self.params.max_distance / REACH, ..self.lines };
        self.target = Some(Target::new(&end_points(scans)?, &wide)?);
        Ok(())
    }

    /// Allocates nothing once a scan of as many beams was matched.
    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        check::all_finite("guess", &[guess.x(), guess.y(), guess.yaw()])?;
        self.scan.refill(scan, self.params.resolution);
        self.align(guess)
    }
}
