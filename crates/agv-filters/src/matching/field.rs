//! Matching by the slope of a field: Gauss and Newton on the interpolated likelihood of the target's surfaces.
//!
//! With `L(p) = exp(-d(p)² / 2 σ²)` of the distance `d` to the nearest surface, stored per cell and interpolated between their centres,
//! the pose `T` of a scan with end points `p` minimises (Kohlbrecher et al., *A flexible and scalable SLAM system with full 3D motion
//! estimation*, 2011, Eqs. 7 to 12; Hess et al. 2016, Eq. CS)
//!
//! ```text
//! Σ (1 - L(T p))²        H = Σ JᵀJ        J = ∇L(T p)ᵀ R [ I | (-p_y, p_x)ᵀ ]
//! ```
//!
//! The Hessian of that vanishes where scan and target fit best, and says nothing of certainty: the information of a result is that of
//! points on lines at the pose that was found.
//!
//! Coarse fields come first, whose surfaces reach far, fine ones last. The target may be any set of surfaces, walls or not: unlike
//! [`CorrelativeMatcher`](super::CorrelativeMatcher) nothing needs to be a line, but a guess is needed that is within reach.

use super::{
    CorrelativeParams,
    nearest::Nearest,
    refine::sum_up,
    squares::ThinnedScan,
    target::{REACH, Target, end_points, layout_around},
    verdict::{End, verdict},
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, PoseSigma, Se2},
    grid::{CellState, Grid},
    roles::{Alignment, AlignmentError, ScanMatcher, TargetScan, Termination},
    sensors::LaserScan,
};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Parameters of a [`FieldMatcher`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FieldMatcherParams {
    /// Edge of a cell of the finest field, in metres.
    pub resolution: f64,
    /// Standard deviation of an end point around the surfaces in the finest field, in metres.
    pub sigma: f64,
    /// Fields, each of twice the `sigma` and the `resolution` of the one after it.
    pub levels: usize,
    /// Standard deviation of a range, in metres: what the information of a result is built on.
    pub range_sigma: f64,
    /// Most steps on each field.
    pub max_iterations: usize,
    /// Fewest usable end points, of the target and of a scan.
    pub min_points: usize,
    /// Least share of end points that must be near the target for the result to be one.
    pub min_inlier_ratio: f64,
    /// Standard deviations beyond which a direction counts as not observed.
    pub observable: PoseSigma,
}

impl Default for FieldMatcherParams {
    /// Three levels as Hector SLAM's, on cells of 0.05 m.
    fn default() -> Self {
        Self {
            resolution: 0.05,
            sigma: 0.1,
            levels: 3,
            range_sigma: 0.02,
            max_iterations: 15,
            min_points: 20,
            min_inlier_ratio: 0.4,
            observable: PoseSigma::default(),
        }
    }
}

impl FieldMatcherParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range; `sigma` must be between one cell and twenty.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("resolution", self.resolution)?;
        check::positive("sigma", self.sigma)?;
        check::in_range("sigma / resolution", self.sigma / self.resolution, 1.0, 20.0)?;
        check::in_range("levels", self.levels as f64, 1.0, 6.0)?;
        check::positive("range_sigma", self.range_sigma)?;
        check::at_least("min_points", self.min_points, 3)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        self.observable.checked()?;
        Ok(())
    }
}

/// Matches scans by the slope of likelihood fields: Gauss and Newton from a guess, coarse fields first.
///
/// Minimises `Σ (1 - L(T p))²` over the end points `p` (Kohlbrecher et al. 2011). Any surfaces serve, but a guess is needed that is within
/// reach of the coarsest field: three times its standard deviation.
///
/// The score of a result is the mean over the scan's end points of `exp(-d² / 2 σ²)` in the finest field.
///
/// ```
/// use agv_core::{geometry::Se2, roles::{ScanMatcher, TargetScan}, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_filters::matching::{FieldMatcher, FieldMatcherParams};
///
/// // The corner of a room, from (0, 0) and from 0.2 m to the left.
/// let geometry = ScanGeometry { angle_min: -0.5, angle_increment: 0.01, ..Default::default() };
/// let seen_from = |y: f64| {
///     let ranges = (0..200).map(|i| geometry.angle(i)).map(|a| (4.0 / a.cos().max(1e-9)).min((3.0 - y) / a.sin().max(1e-9)) as f32);
///     LaserScan::new(Stamp::default(), geometry, ranges.collect())
/// };
/// let (first, second) = (seen_from(0.0)?, seen_from(0.2)?);
/// let mut matcher = FieldMatcher::new(FieldMatcherParams::default())?;
/// matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &first }])?;
/// let found = matcher.match_scan(&second, &Se2::default())?;
/// assert!(found.converged() && (found.target_from_source.y() - 0.2).abs() < 0.02);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct FieldMatcher {
    params: FieldMatcherParams,
    /// How the target's surfaces are found, of which the information is made.
    lines: CorrelativeParams,
    target: Option<Target>,
    /// Likelihoods, the coarsest field first.
    fields: Vec<Grid<f32>>,
    scan: ThinnedScan,
}

/// Steps below this share of a cell are the end.
const AT_REST: f64 = 1e-3;

/// Refused steps below this share of a cell are the end: interpolated fields bend at the centres of cells.
const AT_A_BEND: f64 = 0.25;

/// Sums over the points at a pose.
struct Sums {
    hessian: Matrix3<f64>,
    gradient: Vector3<f64>,
    likelihood: f64,
    /// `Σ (1 - L)²`, where a point off the field has no likelihood.
    cost: f64,
    inliers: usize,
}

impl FieldMatcher {
    /// A matcher without a target.
    ///
    /// # Errors
    /// As [`FieldMatcherParams::validate`].
    pub fn new(params: FieldMatcherParams) -> Result<Self, Error> {
        params.validate()?;
        let FieldMatcherParams { resolution, sigma, range_sigma, min_points, min_inlier_ratio, observable, .. } =
            params;
        let lines = CorrelativeParams {
            resolution,
            sigma,
            // Between the centres of cells a field is not what it says: all points of a wall are off alike.
            range_sigma: range_sigma.hypot(resolution),
            min_points,
            min_inlier_ratio,
            normal_radius: 5.0 * resolution,
            observable,
            ..Default::default()
        };
        Ok(Self { params, lines, target: None, fields: Vec::new(), scan: ThinnedScan::default() })
    }

    /// Its parameters.
    pub const fn params(&self) -> &FieldMatcherParams {
        &self.params
    }

    /// Takes the occupied cells of a map as target. O(cells), for each level.
    ///
    /// # Errors
    /// [`Error::TooFew`] for a map with less of them than `min_points`; the last target is then still there.
    pub fn set_map(&mut self, map: &Grid<CellState>) -> Result<(), Error> {
        let layout = map.layout();
        let occupied = (0..layout.len()).filter(|&i| map.values()[i] == CellState::Occupied);
        let points: Vec<_> = occupied.map(|i| layout.center(layout.cell(i))).collect();
        self.set_points(&points)
    }

    fn set_points(&mut self, points: &[Vector2<f64>]) -> Result<(), Error> {
        check::at_least("usable end points of the target", points.len(), self.params.min_points)?;
        let target = Target::new(points, &self.lines)?;
        let fields = (0..self.params.levels).rev().map(|level| field(points, &self.params, f64::from(1 << level)));
        self.fields = fields.collect::<Result<_, _>>()?;
        self.target = Some(target);
        Ok(())
    }

    /// Steps on one field; the pose, how they ended, and how many they were.
    fn descend(&self, field: &Grid<f32>, points: &[Vector2<f64>], start: &Se2) -> (Se2, Termination, usize) {
        let resolution = field.layout().resolution();
        let sigma = self.params.observable;
        // As if the present pose were known as well as a direction that just counts as observed.
        let weight = |s: f64| (self.params.range_sigma / (s * self.params.sigma)).powi(2);
        let damping = Vector3::new(weight(sigma.translation), weight(sigma.translation), weight(sigma.rotation));
        let mut pose = *start;
        let mut here = slope(field, points, &pose);
        for iteration in 0..self.params.max_iterations {
            let Some(factor) = (here.hessian + Matrix3::from_diagonal(&damping)).cholesky() else {
                return (pose, Termination::IterationLimit, iteration);
            };
            let step = factor.solve(&here.gradient);
            // Fields bend: a step that leads uphill is halved.
            let (mut share, mut best) = (2.0, None);
            for _ in 0..4 {
                share *= 0.5;
                let next = pose.plus(&(step * share));
                let there = slope(field, points, &next);
                if there.cost <= here.cost {
                    best = Some((next, there));
                    break;
                }
            }
            let length = step.amax() * share;
            let Some((next, there)) = best else {
                let is_near = length <= AT_A_BEND * resolution;
                return (pose, if is_near { Termination::Converged } else { Termination::Stalled }, iteration + 1);
            };
            (pose, here) = (next, there);
            if length <= AT_REST * resolution {
                return (pose, Termination::Converged, iteration + 1);
            }
        }
        (pose, Termination::IterationLimit, self.params.max_iterations)
    }
}

/// The sums over some points at a pose.
fn slope(field: &Grid<f32>, points: &[Vector2<f64>], pose: &Se2) -> Sums {
    let (mut hessian, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
    let (mut likelihood, mut cost, mut inliers) = (0.0, 0.0, 0);
    let back = pose.rotation().inverse();
    // Two standard deviations off.
    let near = (-2.0_f64).exp();
    for point in points {
        let Some((value, slope)) = field.interpolate(&pose.act(point)) else {
            cost += 1.0;
            continue;
        };
        let value = f64::from(value);
        let local = back.act(&slope.cast::<f64>());
        let jacobian = Vector3::new(local.x, local.y, local.y * point.x - local.x * point.y);
        hessian += jacobian * jacobian.transpose();
        gradient += jacobian * (1.0 - value);
        likelihood += value;
        cost += (1.0 - value) * (1.0 - value);
        inliers += usize::from(value >= near);
    }
    Sums { hessian, gradient, likelihood, cost, inliers }
}

/// The likelihoods around some points, in cells and deviations `factor` times as wide as the finest.
fn field(points: &[Vector2<f64>], params: &FieldMatcherParams, factor: f64) -> Result<Grid<f32>, Error> {
    let (resolution, sigma) = (params.resolution * factor, params.sigma * factor);
    let layout = layout_around(points, REACH * sigma + 2.0 * resolution, resolution)?;
    let Nearest { squared, .. } = Nearest::default().renewed(points, &layout, REACH * sigma);
    let scale = (-0.5 / (sigma * sigma)) as f32;
    Grid::new(layout, squared.into_iter().map(|squared| (scale * squared).exp()).collect())
}

impl ScanMatcher for FieldMatcher {
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError> {
        Ok(self.set_points(&end_points(scans)?)?)
    }

    /// Allocates nothing once a scan of as many beams was matched.
    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        check::all_finite("guess", &[guess.x(), guess.y(), guess.yaw()])?;
        self.scan.refill(scan, self.params.resolution);
        self.align(guess)
    }
}

impl FieldMatcher {
    fn align(&self, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        let (Some(finest), Some(target)) = (self.fields.last(), &self.target) else {
            return Err(AlignmentError::NoTarget);
        };
        let points = &self.scan.points;
        if points.len() < self.params.min_points {
            return Ok(Alignment::unknown(*guess, Termination::TooFewPoints));
        }
        let (mut pose, mut termination, mut iterations) = (*guess, Termination::IterationLimit, 0);
        for field in &self.fields {
            let steps;
            (pose, termination, steps) = self.descend(field, points, &pose);
            iterations += steps;
        }
        let sums = slope(finest, points, &pose);
        let end = End { pose, termination, iterations, score: sums.likelihood, inliers: sums.inliers };
        Ok(verdict(&end, &sum_up(target, points, &pose, &self.lines), points, guess, &self.lines)?)
    }
}
