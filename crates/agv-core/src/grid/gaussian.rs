//! Points summed up per cell as normal distributions: the map of the 2D normal distributions transform.
//!
//! Biber and Straßer, *The normal distributions transform* (IROS 2003): the points `p_i` of a cell give
//!
//! ```text
//! mean = Σ p_i / n          covariance = Σ (p_i - mean) (p_i - mean)ᵀ / (n - 1)
//! ```
//!
//! Cells with nearly collinear points are singular, so the smaller eigenvalue is raised to a share of the greater one
//! (paper 003: 0.01), and to a least variance.
//!
//! Sums are kept in whole multiples of 2^-16 cells from the cell's corner, and of their squares: integers add in any
//! order to the same bits, so that grids of many vehicles' logs may be merged in any order.

use super::{Cell, CellState, Grid, GridLayout};
use crate::{Error, check};
use nalgebra::{Matrix2, Vector2};

/// Steps per cell along a side.
const STEPS: f64 = 65_536.0;

/// Sums over the points of one cell; adding two is exact, and so associative to the bit.
///
/// Offsets from the cell's corner are counted in 2^-16 cells: squares are below 2^32, so 2^32 points fit. That is days
/// of a scanner that sees nothing else; the sums stop there, all together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PointSums {
    count: u32,
    x: u64,
    y: u64,
    xx: u64,
    xy: u64,
    yy: u64,
}

impl PointSums {
    /// Points in the cell.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Adds all points of another; nothing if both together are more than 2^32 - 1.
    pub fn merge(&mut self, other: &Self) {
        if let Some(count) = self.count.checked_add(other.count) {
            self.count = count;
            self.x = self.x.saturating_add(other.x);
            self.y = self.y.saturating_add(other.y);
            self.xx = self.xx.saturating_add(other.xx);
            self.xy = self.xy.saturating_add(other.xy);
            self.yy = self.yy.saturating_add(other.yy);
        }
    }

    /// The sums of one point, given as offset from the cell's corner in cells, each in [0, 1].
    fn of(offset: Vector2<f64>) -> Self {
        let step = |v: f64| (v * STEPS).clamp(0.0, STEPS - 1.0) as u64;
        let (x, y) = (step(offset.x), step(offset.y));
        Self { count: 1, x, y, xx: x * x, xy: x * y, yy: y * y }
    }

    /// Mean and scatter `Σ (p - mean)(p - mean)ᵀ`, in cells from the corner; none without points.
    fn moments(&self) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let n = i128::from(self.count);
        if n == 0 {
            return None;
        }
        // n Σ xy - Σ x Σ y is exact in 128 bits, where the difference of rounded sums would cancel.
        let scatter = |sum: u64, a: u64, b: u64| {
            (n * i128::from(sum) - i128::from(a) * i128::from(b)) as f64 / (n as f64 * STEPS * STEPS)
        };
        let (xx, xy, yy) =
            (scatter(self.xx, self.x, self.x), scatter(self.xy, self.x, self.y), scatter(self.yy, self.y, self.y));
        // A point lies somewhere in its step: half a step on average.
        let mean = Vector2::new(self.x as f64, self.y as f64) / (n as f64 * STEPS) + Vector2::repeat(0.5 / STEPS);
        Some((mean, Matrix2::new(xx, xy, xy, yy)))
    }
}

/// How the distribution of a cell is made from its points.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GaussianParams {
    /// Cells with fewer points have no distribution; at least 2.
    pub min_points: u32,
    /// Least ratio of the smaller to the greater eigenvalue, in (0, 1].
    pub min_eigenvalue_ratio: f64,
    /// Least standard deviation along any direction, in metres.
    pub min_sigma: f64,
}

impl Default for GaussianParams {
    /// Three points as Biber and Straßer, the eigenvalue ratio of paper 003, and 5 mm, the noise of a good scanner.
    fn default() -> Self {
        Self { min_points: 3, min_eigenvalue_ratio: 0.01, min_sigma: 0.005 }
    }
}

impl GaussianParams {
    fn validate(&self) -> Result<(), Error> {
        check::at_least("min_points", self.min_points as usize, 2)?;
        check::positive("min_eigenvalue_ratio", self.min_eigenvalue_ratio)?;
        check::in_range("min_eigenvalue_ratio", self.min_eigenvalue_ratio, 0.0, 1.0)?;
        check::positive("min_sigma", self.min_sigma)?;
        Ok(())
    }
}

/// A normal distribution in the map frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Gaussian2 {
    /// Mean, in metres.
    pub mean: Vector2<f64>,
    /// Covariance, in square metres.
    pub covariance: Matrix2<f64>,
    /// Inverse of the covariance.
    pub information: Matrix2<f64>,
}

impl Gaussian2 {
    /// Squared Mahalanobis distance of a map point.
    #[inline]
    pub fn mahalanobis_squared(&self, point: &Vector2<f64>) -> f64 {
        let d = point - self.mean;
        d.dot(&(self.information * d))
    }
}

/// Point sums per cell, and the distributions that they give.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, GaussianGrid, GaussianParams, GridLayout};
/// use agv_core::nalgebra::Vector2;
///
/// let layout = GridLayout::new(10, 10, 1.0, Se2::default())?;
/// let mut grid = GaussianGrid::new(layout, GaussianParams::default())?;
/// grid.extend((0..10).map(|i| Vector2::new(2.05 + 0.1 * f64::from(i), 3.5)));
/// let wall = grid.gaussian(Cell::new(2, 3)).ok_or("no points there")?;
/// assert!((wall.mean - Vector2::new(2.5, 3.5)).norm() < 1e-4);
/// assert!((wall.covariance[(1, 1)] / wall.covariance[(0, 0)] - 0.01).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawGaussianGrid"))]
pub struct GaussianGrid {
    params: GaussianParams,
    sums: Grid<PointSums>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawGaussianGrid {
    params: GaussianParams,
    sums: Grid<PointSums>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawGaussianGrid> for GaussianGrid {
    type Error = Error;

    fn try_from(raw: RawGaussianGrid) -> Result<Self, Error> {
        raw.params.validate()?;
        Ok(Self { params: raw.params, sums: raw.sums })
    }
}

impl GaussianGrid {
    /// A grid without points.
    ///
    /// # Errors
    /// `min_points` below 2, a ratio outside (0, 1], or a `min_sigma` that is not positive.
    pub fn new(layout: GridLayout, params: GaussianParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, sums: Grid::filled(layout, PointSums::default()) })
    }

    /// The centres of a map's occupied cells, summed up in cells of `resolution` metres over the same area.
    ///
    /// # Errors
    /// As [`new`](Self::new), or a resolution that gives no grid.
    pub fn from_map(map: &Grid<CellState>, resolution: f64, params: GaussianParams) -> Result<Self, Error> {
        let fine = map.layout();
        let ratio = fine.resolution() / check::positive("resolution", resolution)?;
        // Rounding may not open a row that holds nothing.
        let cells = |n: usize| (n as f64 * ratio - 1e-9).ceil() as usize;
        let layout = GridLayout::new(cells(fine.width()), cells(fine.height()), resolution, fine.map_from_grid())?;
        let mut grid = Self::new(layout, params)?;
        let occupied = map.values().iter().enumerate().filter(|(_, state)| **state == CellState::Occupied);
        grid.extend(occupied.map(|(index, _)| fine.center(fine.cell(index))));
        Ok(grid)
    }

    /// Size, resolution and pose.
    pub const fn layout(&self) -> &GridLayout {
        self.sums.layout()
    }

    /// Sums per cell, row by row from the lower-left.
    pub fn sums(&self) -> &[PointSums] {
        self.sums.values()
    }

    /// Adds a point of the map frame, in metres; says whether it lies in the grid. A point that is not finite does not.
    pub fn insert(&mut self, point: &Vector2<f64>) -> bool {
        let layout = *self.sums.layout();
        let slot = layout.cell_at(point).and_then(|cell| Some((cell, layout.index(cell)?)));
        if let Some((cell, index)) = slot {
            let offset = layout.to_grid(point) - Vector2::new(f64::from(cell.x), f64::from(cell.y));
            self.sums.values_mut()[index].merge(&PointSums::of(offset));
        }
        slot.is_some()
    }

    /// Adds points; those outside the grid, or not finite, are skipped.
    pub fn extend(&mut self, points: impl IntoIterator<Item = Vector2<f64>>) {
        for point in points {
            self.insert(&point);
        }
    }

    /// Adds all points of another grid of the same layout. The order in which grids are merged changes no bit.
    ///
    /// # Errors
    /// [`Error::LayoutMismatch`]; the grid is then as it was.
    pub fn merge(&mut self, other: &Self) -> Result<(), Error> {
        self.layout().ensure_same(other.layout())?;
        for (own, theirs) in self.sums.values_mut().iter_mut().zip(other.sums()) {
            own.merge(theirs);
        }
        Ok(())
    }

    /// The distribution of a cell; none outside the grid or with too few points.
    pub fn gaussian(&self, cell: Cell) -> Option<Gaussian2> {
        let layout = self.layout();
        let sums = self.sums.get(cell).filter(|sums| sums.count >= self.params.min_points)?;
        let (mean, scatter) = sums.moments()?;
        let rotation = layout.map_from_grid().rotation();
        let (c, s) = (rotation.cos(), rotation.sin());
        let rotate = Matrix2::new(c, -s, s, c);
        let scale = layout.resolution() * layout.resolution() / (f64::from(sums.count) - 1.0);
        let raw = rotate * scatter * rotate.transpose() * scale;
        let covariance = regularize(&raw, self.params.min_eigenvalue_ratio, self.params.min_sigma.powi(2));
        let corner = Vector2::new(f64::from(cell.x), f64::from(cell.y));
        let information = invert(&covariance);
        Some(Gaussian2 { mean: layout.to_map(&(corner + mean)), covariance, information })
    }

    /// The distribution of every cell, for a matcher that looks them up often; row by row from the lower-left.
    pub fn gaussians(&self) -> Grid<Option<Gaussian2>> {
        let layout = *self.layout();
        let mut all = Grid::filled(layout, None);
        for (index, slot) in all.values_mut().iter_mut().enumerate() {
            *slot = self.gaussian(layout.cell(index));
        }
        all
    }
}

/// Raises the eigenvalues of a symmetric matrix to `ratio` of the greater one and to `least`.
fn regularize(m: &Matrix2<f64>, ratio: f64, least: f64) -> Matrix2<f64> {
    let (half_trace, half_gap) = (0.5 * (m.m11 + m.m22), 0.5 * (m.m11 - m.m22));
    let radius = half_gap.hypot(m.m12);
    let greater = (half_trace + radius).max(least);
    let smaller = (half_trace - radius).max(ratio * greater).max(least);
    // m = half_trace I + radius [cos 2a, sin 2a; sin 2a, -cos 2a]: the direction stays, the two eigenvalues are set.
    let (cos, sin) = if radius > 0.0 { (half_gap / radius, m.m12 / radius) } else { (1.0, 0.0) };
    let (mean, spread) = (0.5 * (greater + smaller), 0.5 * (greater - smaller));
    Matrix2::new(mean + spread * cos, spread * sin, spread * sin, mean - spread * cos)
}

/// The inverse of a symmetric matrix that is positive definite.
fn invert(m: &Matrix2<f64>) -> Matrix2<f64> {
    let determinant = m.m11 * m.m22 - m.m12 * m.m12;
    Matrix2::new(m.m22, -m.m12, -m.m12, m.m11) / determinant
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Se2;
    use proptest::prelude::*;

    fn grid(points: &[(f64, f64)], yaw: f64) -> GaussianGrid {
        let layout = GridLayout::new(4, 3, 0.5, Se2::new(-0.3, 0.1, yaw)).unwrap();
        let mut grid = GaussianGrid::new(layout, GaussianParams::default()).unwrap();
        grid.extend(points.iter().map(|&(x, y)| layout.to_map(&Vector2::new(x, y))));
        grid
    }

    fn points(max: f64) -> impl Strategy<Value = Vec<(f64, f64)>> {
        prop::collection::vec((0.0..max, 0.0..max), 3..60)
    }

    proptest! {
        /// Mean and covariance are those of the points, but for the quantisation, wherever no eigenvalue is raised.
        #[test]
        fn moments_are_those_of_the_points(points in points(1.0), yaw in -3.0..3.0_f64) {
            let grid = grid(&points, yaw);
            let gaussian = grid.gaussian(Cell::new(0, 0)).unwrap();
            let in_map: Vec<_> = points.iter().map(|&(x, y)| grid.layout().to_map(&Vector2::new(x, y))).collect();
            let n = points.len() as f64;
            let mean = in_map.iter().sum::<Vector2<f64>>() / n;
            let covariance = in_map.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix2<f64>>() / (n - 1.0);
            prop_assert!((gaussian.mean - mean).norm() < 1e-5);
            let eigenvalues = covariance.symmetric_eigenvalues();
            if eigenvalues.min() > 0.011 * eigenvalues.max() && eigenvalues.min() > 3e-5 {
                prop_assert!((gaussian.covariance - covariance).norm() < 1e-5, "{} {}", gaussian.covariance, covariance);
            }
        }

        #[test]
        fn eigenvalues_are_bounded_and_the_information_is_the_inverse(points in points(0.999), squeeze in 0.0..1.0_f64) {
            let flat: Vec<_> = points.iter().map(|&(x, y)| (x, 0.5 + (y - 0.5) * squeeze * 0.1)).collect();
            let gaussian = grid(&flat, 0.4).gaussian(Cell::new(0, 0)).unwrap();
            let eigenvalues = gaussian.covariance.symmetric_eigenvalues();
            prop_assert!(eigenvalues.min() >= 0.01 * eigenvalues.max() * (1.0 - 1e-9));
            prop_assert!(eigenvalues.min() >= 0.005_f64.powi(2) * (1.0 - 1e-9));
            prop_assert!((gaussian.covariance * gaussian.information - Matrix2::identity()).norm() < 1e-9);
        }

        #[test]
        fn merging_is_associative_and_commutative_to_the_bit(a in points(3.0), b in points(3.0), c in points(3.0)) {
            let (a, b, c) = (grid(&a, 0.3), grid(&b, 0.3), grid(&c, 0.3));
            let merged = |x: &GaussianGrid, y: &GaussianGrid| {
                let mut sum = x.clone();
                sum.merge(y).unwrap();
                sum
            };
            prop_assert_eq!(merged(&merged(&a, &b), &c), merged(&a, &merged(&c, &b)));
        }
    }

    #[test]
    fn a_wall_of_a_map_becomes_a_flat_distribution() {
        let mut map = Grid::filled(GridLayout::new(40, 40, 0.05, Se2::default()).unwrap(), CellState::Free);
        (0..40).for_each(|x| assert!(map.set(Cell::new(x, 13), CellState::Occupied)));
        let grid = GaussianGrid::from_map(&map, 0.5, GaussianParams::default()).unwrap();
        assert_eq!((grid.layout().width(), grid.layout().height()), (4, 4));
        let wall = grid.gaussian(Cell::new(1, 1)).unwrap();
        assert!((wall.mean - Vector2::new(0.75, 0.675)).norm() < 1e-4);
        assert!(wall.mahalanobis_squared(&Vector2::new(0.9, 0.675)) < 2.0);
        assert!(wall.mahalanobis_squared(&Vector2::new(0.75, 0.8)) > 50.0);
        assert_eq!(grid.gaussian(Cell::new(1, 3)), None);
    }

    #[test]
    fn bad_input_is_named_or_skipped() {
        let layout = GridLayout::new(4, 4, 1.0, Se2::default()).unwrap();
        let good = GaussianParams::default();
        for bad in [
            GaussianParams { min_points: 1, ..good },
            GaussianParams { min_eigenvalue_ratio: 0.0, ..good },
            GaussianParams { min_eigenvalue_ratio: 1.5, ..good },
            GaussianParams { min_eigenvalue_ratio: f64::NAN, ..good },
            GaussianParams { min_sigma: 0.0, ..good },
        ] {
            assert!(GaussianGrid::new(layout, bad).is_err(), "{bad:?}");
        }
        let map = Grid::filled(layout, CellState::Occupied);
        for resolution in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
            assert!(GaussianGrid::from_map(&map, resolution, good).is_err(), "{resolution}");
        }
        let mut grid = GaussianGrid::new(layout, good).unwrap();
        for (x, y) in [(f64::NAN, 1.0), (f64::INFINITY, 1.0), (-0.1, 1.0), (4.0, 1.0)] {
            assert!(!grid.insert(&Vector2::new(x, y)), "({x}, {y})");
        }
        let other = GaussianGrid::new(GridLayout::new(4, 4, 2.0, Se2::default()).unwrap(), good).unwrap();
        assert!(matches!(grid.merge(&other), Err(Error::LayoutMismatch { name: "resolution", .. })));
        assert!(grid.sums().iter().all(|s| s.count() == 0));
    }
}
