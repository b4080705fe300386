//! Where the cells of a grid lie.

use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
};
use nalgebra::Vector2;

/// A cell by column and row; `(0, 0)` is the cell at the grid's origin, rows grow upwards.
///
/// Signed, so that neighbours and rays may leave the grid before they are checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Cell {
    /// Column.
    pub x: i32,
    /// Row.
    pub y: i32,
}

impl Cell {
    /// The cell in column `x` and row `y`.
    pub const fn new(x: i32, y: i32) -> Self {
        Self { x, y }
    }
}

/// Size, resolution and pose of a grid.
///
/// `map_from_grid` is the pose of the lower-left corner of cell (0, 0), as the `origin` of ROS's map_server; it may be
/// rotated. Cell `(i, j)` covers `[i, i+1) x [j, j+1)` resolutions in the grid frame, and cells are stored row by row.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, GridLayout};
/// use agv_core::nalgebra::Vector2;
///
/// let layout = GridLayout::new(100, 80, 0.05, Se2::new(-1.0, -2.0, 0.0))?;
/// assert_eq!(layout.cell_at(&Vector2::new(-0.97, -1.99)), Some(Cell::new(0, 0)));
/// assert_eq!(layout.cell_at(&Vector2::new(4.01, 0.0)), None);
/// assert!((layout.center(Cell::new(0, 0)) - Vector2::new(-0.975, -1.975)).norm() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawLayout"))]
pub struct GridLayout {
    width: usize,
    height: usize,
    resolution: f64,
    map_from_grid: Se2,
    /// Derived, for every beam and footprint asks for its cell.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    grid_from_map: Se2,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    cells_per_metre: f64,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawLayout {
    width: usize,
    height: usize,
    resolution: f64,
    map_from_grid: Se2,
}

#[cfg(feature = "serde")]
impl TryFrom<RawLayout> for GridLayout {
    type Error = Error;

    fn try_from(raw: RawLayout) -> Result<Self, Error> {
        Self::new(raw.width, raw.height, raw.resolution, raw.map_from_grid)
    }
}

impl GridLayout {
    /// Most cells that a grid may have; an index then fits an `i32` and a look-up table an ordinary machine.
    pub const MAX_CELLS: usize = 1 << 30;

    /// A grid of `width` by `height` cells of `resolution` metres, its lower-left corner at `map_from_grid`.
    ///
    /// # Errors
    /// Zero or more than [`MAX_CELLS`](Self::MAX_CELLS) cells, a resolution that is not finite and positive or so small
    /// that its inverse is not finite, or a pose that is not finite.
    pub fn new(width: usize, height: usize, resolution: f64, map_from_grid: Se2) -> Result<Self, Error> {
        check::positive("resolution", resolution)?;
        check::finite("1 / resolution", 1.0 / resolution)?;
        check::all_finite("map_from_grid", &[map_from_grid.x(), map_from_grid.y(), map_from_grid.yaw()])?;
        if width == 0 || height == 0 {
            return Err(Error::Empty { name: "grid" });
        }
        let cells = width.saturating_mul(height);
        if cells > Self::MAX_CELLS {
            return Err(Error::TooMany { name: "grid", len: cells, max: Self::MAX_CELLS });
        }
        Ok(Self::new_unchecked(width, height, resolution, map_from_grid))
    }

    /// As [`new`](Self::new), for values that are known to be in order.
    pub(crate) fn new_unchecked(width: usize, height: usize, resolution: f64, map_from_grid: Se2) -> Self {
        let (grid_from_map, cells_per_metre) = (map_from_grid.inverse(), 1.0 / resolution);
        Self { width, height, resolution, map_from_grid, grid_from_map, cells_per_metre }
    }

    /// Cells along x.
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Cells along y.
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Number of cells, at least one.
    #[expect(clippy::len_without_is_empty, reason = "a layout has at least one cell")]
    pub const fn len(&self) -> usize {
        self.width * self.height
    }

    /// Edge of a cell, in metres.
    pub const fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Pose of the lower-left corner of cell (0, 0) in the map frame.
    pub const fn map_from_grid(&self) -> Se2 {
        self.map_from_grid
    }

    /// Whether the cell belongs to the grid.
    #[inline]
    pub const fn contains(&self, cell: Cell) -> bool {
        // One unsigned comparison each refuses negative values too.
        (cell.x as u32 as usize) < self.width && (cell.y as u32 as usize) < self.height
    }

    /// Place of the cell in row-by-row storage, if it belongs to the grid.
    #[inline]
    pub fn index(&self, cell: Cell) -> Option<usize> {
        self.contains(cell).then(|| cell.y as usize * self.width + cell.x as usize)
    }

    /// The cell stored at `index`, which is below [`len`](Self::len).
    #[inline]
    pub const fn cell(&self, index: usize) -> Cell {
        Cell::new((index % self.width) as i32, (index / self.width) as i32)
    }

    /// The map point in the grid frame, counted in cells: cell (0, 0) spans 0 to 1.
    #[inline]
    pub fn to_grid(&self, point: &Vector2<f64>) -> Vector2<f64> {
        self.grid_from_map.act(point) * self.cells_per_metre
    }

    /// The map point of a position counted in cells; undoes [`to_grid`](Self::to_grid).
    #[inline]
    pub fn to_map(&self, in_cells: &Vector2<f64>) -> Vector2<f64> {
        self.map_from_grid.act(&(in_cells * self.resolution))
    }

    /// The cell that holds the map point, if it lies in the grid; none for a point that is not finite.
    #[inline]
    pub fn cell_at(&self, point: &Vector2<f64>) -> Option<Cell> {
        let p = self.to_grid(point);
        // NaN fails both comparisons; the upper bound keeps the conversion exact.
        let inside = p.x >= 0.0 && p.y >= 0.0 && p.x < self.width as f64 && p.y < self.height as f64;
        inside.then(|| Cell::new(p.x as i32, p.y as i32))
    }

    /// The cell that holds the map point, or would if the grid had no end; none for a point that is not finite or
    /// farther than an `i32` counts.
    #[inline]
    pub fn cell_unbounded(&self, point: &Vector2<f64>) -> Option<Cell> {
        let p = self.to_grid(point);
        let limit = f64::from(i32::MAX / 2);
        (p.x.abs() < limit && p.y.abs() < limit).then(|| Cell::new(p.x.floor() as i32, p.y.floor() as i32))
    }

    /// Centre of a cell in the map frame, in metres; the cell need not belong to the grid.
    #[inline]
    pub fn center(&self, cell: Cell) -> Vector2<f64> {
        self.to_map(&Vector2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5))
    }

    /// Checks that two grids have the same cells.
    ///
    /// # Errors
    /// [`Error::LayoutMismatch`] names the first difference.
    pub fn ensure_same(&self, other: &Self) -> Result<(), Error> {
        ensure_equal([
            ("width", self.width as f64, other.width as f64),
            ("height", self.height as f64, other.height as f64),
        ])?;
        ensure_same_lattice((self.resolution, other.resolution), (&self.map_from_grid, &other.map_from_grid))
    }
}

/// Checks that the cells of two grids lie on one lattice, wherever each of the two begins and ends.
pub(super) fn ensure_same_lattice(resolutions: (f64, f64), origins: (&Se2, &Se2)) -> Result<(), Error> {
    let (a, b) = origins;
    ensure_equal([
        ("resolution", resolutions.0, resolutions.1),
        ("origin x", a.x(), b.x()),
        ("origin y", a.y(), b.y()),
        ("origin yaw", a.yaw(), b.yaw()),
    ])
}

fn ensure_equal<const N: usize>(pairs: [(&'static str, f64, f64); N]) -> Result<(), Error> {
    for (name, left, right) in pairs {
        if left != right {
            return Err(Error::LayoutMismatch { name, left, right });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn centres_lie_in_their_cells(x in 0_i32..40, y in 0_i32..30, yaw in -3.0..3.0_f64, res in 0.01..2.0_f64) {
            let layout = GridLayout::new(40, 30, res, Se2::new(3.0, -7.0, yaw)).unwrap();
            let cell = Cell::new(x, y);
            prop_assert_eq!(layout.cell_at(&layout.center(cell)), Some(cell));
            prop_assert_eq!(layout.cell_unbounded(&layout.center(cell)), Some(cell));
            prop_assert_eq!(layout.index(cell).map(|i| layout.cell(i)), Some(cell));
        }
    }

    #[test]
    fn points_outside_or_not_finite_have_no_cell() {
        let layout = GridLayout::new(4, 4, 1.0, Se2::default()).unwrap();
        for (x, y) in [(-0.1, 1.0), (1.0, 4.0), (f64::NAN, 1.0), (f64::INFINITY, 1.0), (1.0, -1e300)] {
            assert_eq!(layout.cell_at(&Vector2::new(x, y)), None, "({x}, {y})");
        }
        assert_eq!(layout.index(Cell::new(-1, 0)), None);
        assert_eq!(layout.index(Cell::new(0, 4)), None);
    }

    #[test]
    fn bad_layouts_are_named() {
        let origin = Se2::default();
        assert_eq!(GridLayout::new(0, 4, 1.0, origin), Err(Error::Empty { name: "grid" }));
        assert!(matches!(GridLayout::new(usize::MAX, 4, 1.0, origin), Err(Error::TooMany { .. })));
        for resolution in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(GridLayout::new(4, 4, resolution, origin), Err(Error::NotPositive { .. })));
        }
        assert!(GridLayout::new(4, 4, 1e-310, origin).is_err());
        assert!(GridLayout::new(4, 4, 1.0, Se2::new(f64::NAN, 0.0, 0.0)).is_err());
    }
}
