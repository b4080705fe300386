//! Casting rays into a map: where does a beam end?

mod ray;
mod skip;

use super::{Cell, CellState, Grid, GridLayout};
use crate::{
    Error,
    compute::{CHUNK, Par},
    geometry::{LieGroup, Se2},
};
use nalgebra::Vector2;
use ray::Ray;
use skip::Wedges;

/// What stops a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RayCastParams {
    /// Whether cells that were not observed stop rays as obstacles do; by default they are looked through.
    pub unknown_is_obstacle: bool,
}

/// Where a ray ends.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RayHit {
    /// The obstacle.
    pub cell: Cell,
    /// Distance along the ray to where it enters the cell, in metres; zero if it starts there.
    pub range: f64,
}

/// The map with a border of one cell, one byte per cell, and its transpose: rays along y read memory in order too.
///
/// A byte is the [`STATE`] of its cell, with [`BAND`] set unless the cell and the [`TOGETHER`] rows above it are free: eight
/// bytes of a row tell whether a ray may pass eight columns.
#[derive(Debug, Clone)]
struct Raster {
    width: usize,
    height: usize,
    cells: Vec<u8>,
    transposed: Vec<u8>,
}

/// The bits of a cell's own state: free, an obstacle, or the border.
const STATE: u8 = 3;

/// The raster's border: the ray leaves the map.
const BORDER: u8 = 2;

/// Whether the cell, or one of those in the next [`TOGETHER`] rows, is not free.
const BAND: u8 = 4;

/// Columns that are looked at together.
const TOGETHER: usize = 8;

impl Raster {
    /// Sets [`BAND`]: the rows above are looked at by doubling.
    fn look_above(cells: &mut [u8], width: usize) {
        let mut above: Vec<u8> = cells.iter().map(|&state| if state == 0 { 0 } else { BAND }).collect();
        // Up to the border all rows are known; beyond the last there is nothing to look at.
        for rows in [1, 2, 4, 1] {
            for index in 0..above.len().saturating_sub(rows * width) {
                above[index] |= above[index + rows * width];
            }
        }
        for (cell, above) in cells.iter_mut().zip(above) {
            *cell |= above;
        }
    }
}

/// Casts rays into a map.
///
/// A ray is a line quantised to 2^-32 cells, and visits every cell that it crosses, in order; where it passes exactly
/// through a corner it may visit one of the two cells beside it. It ends in the first obstacle whose entry point lies
/// within the ray's length. Outside the map there are no obstacles: a ray may start there, and ends where it leaves the
/// map for good.
///
/// [`cast`](Self::cast) skips free space by tables of [`BYTES_PER_CELL`](Self::BYTES_PER_CELL);
/// [`cast_exact`](Self::cast_exact) visits the cells one by one. Both have the same answer, to the bit, on every ray.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, RayCastParams, RayCaster};
/// use agv_core::nalgebra::Vector2;
///
/// let mut map = Grid::filled(GridLayout::new(100, 100, 0.05, Se2::default())?, CellState::Free);
/// map.set(Cell::new(60, 20), CellState::Occupied);
/// let caster = RayCaster::new(&map, RayCastParams::default())?;
/// let hit = caster.cast(&Vector2::new(1.0, 1.01), 0.0, 10.0).ok_or("no obstacle ahead")?;
/// assert_eq!(hit.cell, Cell::new(60, 20));
/// assert!((hit.range - 2.0).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct RayCaster {
    layout: GridLayout,
    grid_yaw: f64,
    raster: Raster,
    wedges: Wedges,
}

impl RayCaster {
    /// Memory of the tables, in bytes per cell of the map.
    pub const BYTES_PER_CELL: usize = ((8 * skip::SECTORS) >> (2 * skip::BLOCK)) + 2;

    /// Prepares a map: O(cells).
    ///
    /// # Errors
    /// A map of more than 2^27 cells along a side.
    pub fn new(map: &Grid<CellState>, params: RayCastParams) -> Result<Self, Error> {
        const MAX_SIDE: usize = 1 << 27;
        let layout = *map.layout();
        for (name, side) in [("width", layout.width()), ("height", layout.height())] {
            if side > MAX_SIDE {
                return Err(Error::TooMany { name, len: side, max: MAX_SIDE });
            }
        }
        let (width, height) = (layout.width() + 2, layout.height() + 2);
        let mut cells = vec![BORDER; width * height];
        let inner = cells.chunks_exact_mut(width).skip(1);
        for (row, states) in inner.zip(map.values().chunks_exact(layout.width())) {
            for (cell, &state) in row[1..].iter_mut().zip(states) {
                let unknown = state == CellState::Unknown && params.unknown_is_obstacle;
                *cell = u8::from(state == CellState::Occupied || unknown);
            }
        }
        let transposed = (0..width * height).map(|i| cells[(i % height) * width + i / height]).collect();
        let mut raster = Raster { width, height, cells, transposed };
        let wedges = Wedges::new(&raster);
        Raster::look_above(&mut raster.cells, width);
        Raster::look_above(&mut raster.transposed, height);
        Ok(Self { layout, grid_yaw: layout.map_from_grid().yaw(), raster, wedges })
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// First obstacle on the ray from `origin` in direction `angle`, both in the map frame, within `max_range` metres.
    ///
    /// None if there is none, for an argument that is not a number or a negative range, and for an origin 2^28 cells
    /// away. No ray is longer than 2^28 cells.
    #[inline]
    pub fn cast(&self, origin: &Vector2<f64>, angle: f64, max_range: f64) -> Option<RayHit> {
        let ray = self.ray(origin, angle, max_range)?;
        self.run(&ray, Some(self.wedges.of(&ray)))
    }

    /// As [`cast`](Self::cast), along the cells, eight columns at a look.
    #[inline]
    pub fn cast_exact(&self, origin: &Vector2<f64>, angle: f64, max_range: f64) -> Option<RayHit> {
        let ray = self.ray(origin, angle, max_range)?;
        self.run(&ray, None)
    }

    #[inline]
    fn ray(&self, origin: &Vector2<f64>, angle: f64, max_range: f64) -> Option<Ray> {
        let (sin, cos) = (angle - self.grid_yaw).sin_cos();
        Ray::new(self.layout.to_grid(origin), Vector2::new(cos, sin), max_range / self.layout.resolution())
    }

    /// Ranges of a scan's beams, in metres: `ranges[i]` is that of the ray from `map_from_sensor` in the direction
    /// `directions[i]`, a unit vector of the sensor frame; `+∞` where nothing is hit.
    ///
    /// Fills as many ranges as there are directions for. Same values for any `par`.
    pub fn cast_into(
        &self,
        map_from_sensor: &Se2,
        directions: &[Vector2<f64>],
        max_range: f64,
        ranges: &mut [f32],
        par: Par,
    ) {
        let cast = self.from_pose(map_from_sensor, max_range);
        let len = ranges.len().min(directions.len());
        par.for_each_chunk((&mut ranges[..len], &directions[..len]), CHUNK, |_, (ranges, directions)| {
            for (range, direction) in ranges.iter_mut().zip(directions) {
                *range = cast(direction).map_or(f32::INFINITY, |hit| hit.range as f32);
            }
        });
    }

    /// First obstacles within `max_range` metres of a sensor at `map_from_sensor`, by unit vectors of the sensor frame: what
    /// the beams of one scan have in common is done once.
    ///
    /// ```
    /// use agv_core::geometry::Se2;
    /// use agv_core::grid::{Cell, CellState, Grid, GridLayout, RayCastParams, RayCaster};
    /// use agv_core::nalgebra::Vector2;
    ///
    /// let mut map = Grid::filled(GridLayout::new(100, 100, 0.05, Se2::default())?, CellState::Free);
    /// map.set(Cell::new(60, 20), CellState::Occupied);
    /// let caster = RayCaster::new(&map, RayCastParams::default())?;
    /// let cast = caster.from_pose(&Se2::new(1.0, 1.01, 0.0), 10.0);
    /// assert_eq!(cast(&Vector2::x()).map(|hit| hit.cell), Some(Cell::new(60, 20)));
    /// assert_eq!(cast(&Vector2::y()), None);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn from_pose(
        &self,
        map_from_sensor: &Se2,
        max_range: f64,
    ) -> impl Fn(&Vector2<f64>) -> Option<RayHit> + Sync + '_ {
        let grid_from_sensor = self.layout.map_from_grid().between(map_from_sensor);
        let resolution = self.layout.resolution();
        let (origin, length) = (grid_from_sensor.translation() / resolution, max_range / resolution);
        move |direction| {
            let ray = Ray::new(origin, grid_from_sensor.rotation().act(direction), length)?;
            self.run(&ray, Some(self.wedges.of(&ray)))
        }
    }

    /// Follows a ray, skipping what the table says is free.
    #[expect(clippy::inline_always, reason = "casting cell by cell must not carry the table's branches")]
    #[inline(always)]
    fn run(&self, ray: &Ray, table: Option<(&[u8], i64)>) -> Option<RayHit> {
        let (cells, pitch) = if ray.along_x {
            (self.raster.cells.as_slice(), self.raster.width as i64)
        } else {
            (self.raster.transposed.as_slice(), self.raster.height as i64)
        };
        let (mut k, mut y) = (0, ray.start);
        let mut next = ray.first;
        if !self.holds(ray, 0, Ray::row(y)) {
            (k, y) = match self.enter(ray) {
                Entry::Never => return None,
                Entry::Hit(hit) => return Some(hit),
                Entry::At(k) => (k, ray.entry(k)),
            };
            next = ray.entry(k + 1);
        }
        // Where the eight columns and nine rows ahead begin: a ray that falls, or runs backwards, is in the last.
        let together = TOGETHER as i64;
        let lowest = if ray.slope < 0 { pitch - together * pitch } else { pitch };
        let corner = if ray.step < 0 { lowest - (together - 1) } else { lowest };
        // The border keeps indices inside: a column's second cell is at most one row off its first, and a first cell
        // in the border ends the ray.
        let mut column = ray.column + k * ray.step + 1;
        let mut recheck = k + 1;
        while k <= ray.columns {
            let (row, next_row) = (Ray::row(y), Ray::row(next));
            let at = |row: i64| cells[(row * pitch + column + pitch) as usize];
            let (a, b) = (at(row), at(next_row));
            if (a | b) & STATE != 0 {
                let (state, row, second) = if a & STATE != 0 { (a, row, false) } else { (b, next_row, true) };
                return if state & STATE == BORDER { None } else { self.hit(ray, k, row, second) };
            }
            (k, column, y) = (k + 1, column + ray.step, next);
            if k >= recheck {
                if let Some((table, stride)) = table {
                    // Free columns ahead: as many single steps at once.
                    loop {
                        let block = ((Ray::row(y) + 1) >> skip::BLOCK) * stride + (column >> skip::BLOCK);
                        let free = i64::from(table[block as usize]);
                        (k, column, y) = (k + free, column + free * ray.step, y + free * ray.slope);
                        if free == 0 || k > ray.columns {
                            break;
                        }
                    }
                    recheck = k + (1 << skip::BLOCK);
                } else {
                    while Self::are_free(cells, Ray::row(y) * pitch + column + corner) && k <= ray.columns {
                        (k, column, y) = (k + together, column + together * ray.step, y + together * ray.slope);
                    }
                    recheck = k + together / 2;
                }
            }
            next = y + ray.slope;
        }
        None
    }

    /// Whether the cells from `first` on in a row, and those above them, are free; not if some are off the raster.
    #[inline]
    fn are_free(cells: &[u8], first: i64) -> bool {
        let Some((band, _)) = cells.get(first as usize..).and_then(<[u8]>::split_first_chunk::<TOGETHER>) else {
            return false;
        };
        u64::from_ne_bytes(*band) & u64::from_ne_bytes([BAND; TOGETHER]) == 0
    }

    #[inline]
    fn hit(&self, ray: &Ray, k: i64, row: i64, second: bool) -> Option<RayHit> {
        let range = ray.range(k, row, second)? * self.layout.resolution();
        Some(RayHit { cell: ray.cell(k, row), range })
    }

    /// Whether the cell lies in the map.
    #[inline]
    fn holds(&self, ray: &Ray, k: i64, row: i64) -> bool {
        self.layout.contains(ray.cell(k, row))
    }

    /// Where a ray from outside comes in: the first column whose first cell lies in the map.
    #[cold]
    fn enter(&self, ray: &Ray) -> Entry {
        let (columns, rows) = (self.layout.width() as i64, self.layout.height() as i64);
        let (columns, rows) = if ray.along_x { (columns, rows) } else { (rows, columns) };
        // Columns to go before the ray can be inside along the major, and along the minor axis.
        let ahead = if ray.step > 0 { -ray.column } else { ray.column - (columns - 1) };
        let (low, high) = (-ray.first, ray.first - (rows << 32));
        let across = match (low > 0, high >= 0) {
            (true, _) if ray.slope > 0 => low / ray.slope,
            (_, true) if ray.slope < 0 => high / -ray.slope,
            (false, false) => 0,
            _ => return Entry::Never,
        };
        let mut k = ahead.max(across).max(0);
        // At most a few columns: the quotient is exact up to one, and a corner may be cut.
        while k <= ray.columns {
            let y = if k == 0 { ray.start } else { ray.entry(k) };
            for (row, second) in [(Ray::row(y), false), (Ray::row(ray.entry(k + 1)), true)] {
                if self.holds(ray, k, row) {
                    if !second {
                        return Entry::At(k);
                    }
                    let Cell { x, y } = ray.cell(k, row);
                    if self.raster.cells[(y as usize + 1) * self.raster.width + x as usize + 1] & STATE != 0 {
                        return self.hit(ray, k, row, second).map_or(Entry::Never, Entry::Hit);
                    }
                }
            }
            k += 1;
            let (column, row) = (ray.column + k * ray.step, Ray::row(ray.entry(k)));
            let gone = |v: i64, n: i64, rising: bool| if rising { v >= n } else { v < 0 };
            if gone(column, columns, ray.step > 0) || gone(row, rows, ray.slope > 0) {
                return Entry::Never;
            }
        }
        Entry::Never
    }
}

/// How a ray from outside comes in.
enum Entry {
    Never,
    Hit(RayHit),
    At(i64),
}

#[cfg(test)]
mod tests;
