//! Parameters of scan matching.

use agv_core::{Error, check, geometry::PoseSigma};
use std::f64::consts::PI;

/// Poses around a guess that are searched.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SearchWindow {
    /// Farthest along each axis of the target frame, in metres; zero for no search.
    pub distance: f64,
    /// Farthest to either side, in radians; half a turn for all directions.
    pub angle: f64,
}

impl SearchWindow {
    /// Accepts a window that is finite and not negative.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a distance of more than 4096 cells of `resolution` metres, or an angle beyond half a turn.
    pub fn checked(self, resolution: f64) -> Result<Self, Error> {
        check::in_range("distance of the search window", self.distance, 0.0, 4096.0 * resolution)?;
        check::in_range("angle of the search window", self.angle, 0.0, PI)?;
        Ok(self)
    }
}

/// Parameters of a [`CorrelativeMatcher`](super::CorrelativeMatcher).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CorrelativeParams {
    /// Edge of a cell of the finest grid, in metres.
    pub resolution: f64,
    /// Standard deviation of an end point around the surfaces of the target, in metres: covers the scanner's noise and the error of
    /// the target's poses. What lies beyond three of them meets nothing.
    pub sigma: f64,
    /// Standard deviation of a range, in metres: what the information of a result is built on, where the scan does not fit worse.
    pub range_sigma: f64,
    /// Window around the guess that is searched by [`match_scan`](agv_core::roles::ScanMatcher::match_scan).
    pub window: SearchWindow,
    /// Fewest usable end points, of the target and of a scan.
    pub min_points: usize,
    /// Least share of end points that must meet the target for the result to be one.
    pub min_inlier_ratio: f64,
    /// Most steps of the refinement.
    pub max_iterations: usize,
    /// Radius around an end point of the target whose neighbours make its surface, in metres.
    pub normal_radius: f64,
    /// Standard deviations beyond which a direction counts as not observed.
    pub observable: PoseSigma,
}

impl Default for CorrelativeParams {
    /// Cells and window of Cartographer's real-time matcher (0.05 m; wider, 0.3 m and 20°, as Olson searches), an indoor scanner's
    /// noise, and four tenths of the points.
    fn default() -> Self {
        Self {
            resolution: 0.05,
            sigma: 0.1,
            range_sigma: 0.02,
            window: SearchWindow { distance: 0.3, angle: 0.35 },
            min_points: 20,
            min_inlier_ratio: 0.4,
            max_iterations: 20,
            normal_radius: 0.25,
            observable: PoseSigma::default(),
        }
    }
}

impl CorrelativeParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range; `sigma` must be between half a cell and twenty.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("resolution", self.resolution)?;
        check::positive("sigma", self.sigma)?;
        check::in_range("sigma / resolution", self.sigma / self.resolution, 0.5, 20.0)?;
        check::positive("range_sigma", self.range_sigma)?;
        self.window.checked(self.resolution)?;
        check::at_least("min_points", self.min_points, 3)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        check::positive("normal_radius", self.normal_radius)?;
        self.observable.checked()?;
        Ok(())
    }

    /// These parameters, widened for a scanner whose ranges have a standard deviation of `noise` metres: cells, surfaces and what counts as
    /// near grow together, so that a match takes no longer. Unchanged where they are wide enough.
    #[must_use]
    pub fn widened_for(self, noise: f64) -> Self {
        let factor = (1.5 * noise / self.sigma).clamp(1.0, 8.0);
        Self {
            resolution: self.resolution * factor,
            sigma: self.sigma * factor,
            range_sigma: self.range_sigma.max(if factor > 1.0 { noise } else { 0.0 }),
            // Neighbours are a line if they spread farther along it than across.
            normal_radius: self.normal_radius.max(if factor > 1.0 { 6.0 * noise } else { 0.0 }),
            ..self
        }
    }
}
