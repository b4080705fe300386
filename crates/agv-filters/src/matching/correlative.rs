//! The matcher: a search of a window, then the refinement.

use super::{
    params::{CorrelativeParams, SearchWindow},
    refine::refine,
    search::{Scratch, search},
    squares::{Squares, room_of, thin_into},
    target::{Target, end_points},
    verdict::held,
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, unobserved_directions},
    grid::{Cell, CellState, Grid},
    roles::{Alignment, AlignmentError, ScanMatcher, TargetScan, Termination},
    sensors::LaserScan,
};
use nalgebra::Vector2;

/// Matches scans by an exhaustive search of a window of poses and a refinement; see the [module](super).
///
/// The score of a result is the mean over the scan's end points of `exp(-d² / 2 σ²)`, with the distance `d` from the surface that
/// each meets, or from its nearest point where that is on no line. The information takes the beams for independent, and the target
/// for the truth.
///
/// ```
/// use agv_core::{geometry::Se2, roles::{ScanMatcher, TargetScan}, sensors::{LaserScan, ScanGeometry}, time::Stamp};
/// use agv_filters::matching::{CorrelativeMatcher, CorrelativeParams};
///
/// // The corner of a room, from (0, 0) and from 0.2 m to the left.
/// let geometry = ScanGeometry { angle_min: -0.5, angle_increment: 0.01, ..Default::default() };
/// let seen_from = |y: f64| {
///     let ranges = (0..200).map(|i| geometry.angle(i)).map(|a| (4.0 / a.cos().max(1e-9)).min((3.0 - y) / a.sin().max(1e-9)) as f32);
///     LaserScan::new(Stamp::default(), geometry, ranges.collect())
/// };
/// let (first, second) = (seen_from(0.0)?, seen_from(0.2)?);
/// let mut matcher = CorrelativeMatcher::new(CorrelativeParams::default())?;
/// matcher.set_target(&[TargetScan { target_from_base: Se2::default(), scan: &first }])?;
/// let found = matcher.match_scan(&second, &Se2::default())?;
/// assert!(found.converged() && (found.target_from_source.y() - 0.2).abs() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct CorrelativeMatcher {
    params: CorrelativeParams,
    target: Option<Target>,
    scratch: Scratch,
    squares: Squares,
    points: Vec<Vector2<f64>>,
}

impl CorrelativeMatcher {
    /// A matcher without a target.
    ///
    /// # Errors
    /// As [`CorrelativeParams::validate`].
    pub fn new(params: CorrelativeParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, target: None, scratch: Scratch::default(), squares: Vec::new(), points: Vec::new() })
    }

    /// Its parameters.
    pub const fn params(&self) -> &CorrelativeParams {
        &self.params
    }

    /// Takes the surfaces of a map as target: occupied cells with a neighbour that is not. O(cells of the map).
    ///
    /// # Errors
    /// [`Error::TooFew`] for a map with less of them than `min_points`, or [`Error::TooMany`] for a map that is too wide; the last
    /// target is then still there.
    pub fn set_map(&mut self, map: &Grid<CellState>) -> Result<(), Error> {
        let layout = map.layout();
        let occupied = |cell: Cell| map.get(cell) == Some(&CellState::Occupied);
        let surfaces = (0..layout.len()).map(|i| layout.cell(i)).filter(|cell| {
            let around = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(x, y)| Cell::new(cell.x + x, cell.y + y));
            occupied(*cell) && !around.into_iter().all(occupied)
        });
        let points: Vec<_> = surfaces.map(|cell| layout.center(cell)).collect();
        self.set_points(&points)
    }

    /// As [`match_scan`](ScanMatcher::match_scan), in another window than that of the parameters: a wide one to close a loop. Without a
    /// search where the window's distance and angle are zero.
    ///
    /// Time grows with the poses of the window only as far as many fit about as well as the best. Allocates nothing once a scan of
    /// as many beams was matched in as wide a window with this target.
    ///
    /// # Errors
    /// As [`match_scan`](ScanMatcher::match_scan), and for a window that [`SearchWindow::checked`] refuses.
    pub fn match_within(
        &mut self,
        scan: &LaserScan,
        guess: &Se2,
        window: SearchWindow,
    ) -> Result<Alignment<Se2>, AlignmentError> {
        thin_into(scan.points_in_base(), self.params.resolution, &mut self.squares, &mut self.points);
        let points = std::mem::take(&mut self.points);
        let result = self.match_points(&points, guess, window, 0.0);
        self.points = points;
        result
    }

    /// As [`match_within`](Self::match_within), for end points in the base frame, thinned to the resolution. Where the search finds
    /// nothing that scores more than `floor` cell by cell, nothing is matched.
    pub(crate) fn match_points(
        &mut self,
        points: &[Vector2<f64>],
        guess: &Se2,
        window: SearchWindow,
        floor: f64,
    ) -> Result<Alignment<Se2>, AlignmentError> {
        window.checked(self.params.resolution)?;
        check::all_finite("guess", &[guess.x(), guess.y(), guess.yaw()])?;
        let Some(target) = &mut self.target else { return Err(AlignmentError::NoTarget) };
        let mut result = Alignment::unknown(*guess, Termination::TooFewPoints);
        if points.len() < self.params.min_points {
            return Ok(result);
        }
        let mut start = *guess;
        if window.distance > 0.0 || window.angle > 0.0 {
            let Some(found) = search(target, points, guess, &window, floor, &mut self.scratch) else {
                return Ok(result);
            };
            (start, result.iterations) = (found.pose, found.evaluated);
        }
        let refined = refine(target, points, &start, &self.params);
        result.iterations += refined.iterations;
        result.inlier_ratio = refined.inliers as f64 / points.len() as f64;
        result.score = refined.score;
        result.termination = refined.termination;
        if refined.pose.is_finite() && refined.termination != Termination::TooFewPoints {
            result.information = refined.information;
            result.unobserved = unobserved_directions::<Se2>(&refined.information, self.params.observable)?;
            result.target_from_source = held(&refined.pose, guess, &result.unobserved);
        }
        Ok(result)
    }

    /// Bytes of the target and of the memory of searches.
    pub(crate) fn memory(&self) -> usize {
        self.target.as_ref().map_or(0, Target::memory)
            + self.scratch.memory()
            + room_of(&self.squares)
            + room_of(&self.points)
    }

    /// Takes points in the target frame as target, which are finite.
    pub(crate) fn set_points(&mut self, points: &[Vector2<f64>]) -> Result<(), Error> {
        self.target = Some(Target::after(&mut self.target, points, &self.params)?);
        Ok(())
    }
}

impl ScanMatcher for CorrelativeMatcher {
    fn set_target(&mut self, scans: &[TargetScan<'_>]) -> Result<(), AlignmentError> {
        Ok(self.set_points(&end_points(scans)?)?)
    }

    fn match_scan(&mut self, scan: &LaserScan, guess: &Se2) -> Result<Alignment<Se2>, AlignmentError> {
        self.match_within(scan, guess, self.params.window)
    }
}
