//! Distance to the nearest obstacle: the exact Euclidean distance transform.
//!
//! The squared distance of a cell separates into columns and rows,
//!
//! ```text
//! d²(x, y) = min_i ( (x - i)² + g²(i, y) )        g(i, y) = min_j |y - j|, (i, j) an obstacle
//! ```
//!
//! The column part `g` is two running scans; the row part is the lower envelope of parabolas of Felzenszwalb and
//! Huttenlocher, *Distance transforms of sampled functions* (2012, section 2). Both are done in whole numbers of cells,
//! so the squared distances are exact; the metres are their roots, rounded once to `f32` and scaled.

mod columns;
mod rows;

use super::{CellState, Grid, GridLayout};
use crate::{Error, check, compute::Par};
use columns::Columns;
use rows::{Band, Bands, Scratch};

/// Rows that are processed together. Fixed, so that the work is cut the same for any number of threads; small enough
/// for a band of a wide map to stay in the second-level cache.
const BAND: usize = 32;

/// Column distance of a cell whose column holds no obstacle.
const NONE: i16 = i16::MAX;

/// What counts as an obstacle, and how far to look.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DistanceParams {
    /// Whether cells that were not observed count as obstacles.
    pub unknown_is_obstacle: bool,
    /// Greatest distance of interest, in metres: greater ones are reported as this one. None for no limit.
    pub max_distance: Option<f64>,
}

impl DistanceParams {
    /// States in order of [`CellState`] from this one on are obstacles.
    const fn least_obstacle(self) -> CellState {
        if self.unknown_is_obstacle { CellState::Unknown } else { CellState::Occupied }
    }
}

/// Computes distance fields, and keeps its working memory for the next one.
///
/// Distances run between cell centres: an obstacle cell has distance 0, its four neighbours one resolution. O(cells)
/// but for a factor of at most ten, log2(width / 32), of a part of the work; and the same bits for any [`Par`]. Allocates only when a map is larger than those before.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, DistanceParams, DistanceTransform, Grid, GridLayout};
///
/// let mut map = Grid::filled(GridLayout::new(20, 10, 0.5, Se2::default())?, CellState::Free);
/// map.set(Cell::new(3, 4), CellState::Occupied);
/// let field = DistanceTransform::new(DistanceParams::default())?.compute(&map)?;
/// assert_eq!(field.get(Cell::new(6, 8)), Some(&2.5));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct DistanceTransform {
    params: DistanceParams,
    par: Par,
    columns: Columns,
    bands: Vec<Scratch>,
}

impl DistanceTransform {
    /// Most cells along a side: squared distances then fit an `i32`.
    pub const MAX_SIDE: usize = 32_767;

    /// Squared distance, in cells, where a map has no obstacle at all.
    pub const NO_OBSTACLE: i32 = i32::MAX;

    /// A transform with these parameters.
    ///
    /// # Errors
    /// A `max_distance` that is not finite and positive.
    pub fn new(params: DistanceParams) -> Result<Self, Error> {
        if let Some(max_distance) = params.max_distance {
            check::positive("max_distance", max_distance)?;
        }
        Ok(Self { params, ..Self::default() })
    }

    /// The same transform on several threads.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// What counts as an obstacle, and how far to look.
    pub const fn params(&self) -> &DistanceParams {
        &self.params
    }

    /// Distance field of the map, in metres; `+∞` everywhere if there is no obstacle and no `max_distance`.
    ///
    /// # Errors
    /// A map longer than [`MAX_SIDE`](Self::MAX_SIDE) along a side.
    pub fn compute(&mut self, map: &Grid<CellState>) -> Result<Grid<f32>, Error> {
        let mut field = Grid::filled(*map.layout(), 0.0);
        self.compute_into(map, &mut field)?;
        Ok(field)
    }

    /// As [`compute`](Self::compute), into a grid that takes the map's layout; its memory is used again if it fits.
    ///
    /// # Errors
    /// As [`compute`](Self::compute); the field is then as it was.
    pub fn compute_into(&mut self, map: &Grid<CellState>, field: &mut Grid<f32>) -> Result<(), Error> {
        let resolution = map.layout().resolution() as f32;
        let max = self.params.max_distance.map_or(f32::INFINITY, |d| d as f32);
        self.transform(map, field, max, move |squared| ((squared as f32).sqrt() * resolution).min(max))
    }

    /// Squared distances in cells, exactly; [`NO_OBSTACLE`](Self::NO_OBSTACLE) where none lies within `max_distance`,
    /// rounded up to whole cells.
    ///
    /// # Errors
    /// As [`compute`](Self::compute); the field is then as it was.
    pub fn squared_into(&mut self, map: &Grid<CellState>, field: &mut Grid<i32>) -> Result<(), Error> {
        let reach = i32::from(self.reach(map.layout()));
        let limit = if self.params.max_distance.is_some() { reach * reach } else { i32::MAX };
        let cut = move |squared: i32| if squared > limit { Self::NO_OBSTACLE } else { squared };
        self.transform(map, field, Self::NO_OBSTACLE, cut)
    }

    /// `max_distance` in cells, rounded up.
    pub(super) fn reach(&self, layout: &GridLayout) -> i16 {
        let cells = self.params.max_distance.map_or(f64::INFINITY, |d| (d / layout.resolution()).ceil());
        cells.min(f64::from(NONE - 1)) as i16
    }

    /// Writes `finish` of the squared distance of every cell; `nothing` where there is no obstacle within reach.
    pub(super) fn transform<T: Copy + Send + Sync>(
        &mut self,
        map: &Grid<CellState>,
        field: &mut Grid<T>,
        nothing: T,
        finish: impl Fn(i32) -> T + Sync,
    ) -> Result<(), Error> {
        let layout = *map.layout();
        let (width, height) = (layout.width(), layout.height());
        for (name, side) in [("width", width), ("height", height)] {
            if side > Self::MAX_SIDE {
                return Err(Error::TooMany { name, len: side, max: Self::MAX_SIDE });
            }
        }
        field.reshape(layout, nothing);
        self.columns.scan(map, self.par, self.params.least_obstacle());
        self.bands.resize_with(height.div_ceil(BAND), Scratch::default);
        let reach = self.reach(&layout);
        let bands = Bands::new(width, field.values_mut(), &mut self.bands);
        let (columns, finish) = (&self.columns, &finish);
        self.par.for_each_chunk(bands, BAND, |number, rows| {
            Band { rows, number, columns, reach, nothing, finish }.run();
        });
        Ok(())
    }
}

/// Distance field of a map, in metres, unknown cells being free and no limit set.
///
/// Call a [`DistanceTransform`] for other rules, or to reuse its memory.
///
/// # Errors
/// A map longer than [`DistanceTransform::MAX_SIDE`] along a side.
pub fn distance_field(map: &Grid<CellState>) -> Result<Grid<f32>, Error> {
    DistanceTransform::default().compute(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{geometry::Se2, grid::Cell};
    use proptest::prelude::*;

    fn map_of(width: usize, height: usize, states: &[CellState]) -> Grid<CellState> {
        let layout = GridLayout::new(width, height, 0.05, Se2::default()).unwrap();
        Grid::new(layout, states.iter().copied().cycle().take(width * height).collect()).unwrap()
    }

    fn brute_force(map: &Grid<CellState>, params: DistanceParams) -> Vec<i32> {
        let layout = map.layout();
        let obstacles: Vec<Cell> = (0..layout.len())
            .filter(|&i| map.values()[i] as u8 >= params.least_obstacle() as u8)
            .map(|i| layout.cell(i))
            .collect();
        let nearest = |c: Cell| obstacles.iter().map(|o| (o.x - c.x).pow(2) + (o.y - c.y).pow(2)).min();
        (0..layout.len()).map(|i| nearest(layout.cell(i)).unwrap_or(i32::MAX)).collect()
    }

    /// From nearly empty to nearly full, with rows beyond one band, and rows of many blocks.
    fn any_map() -> impl Strategy<Value = Grid<CellState>> {
        let size = prop_oneof![(1_usize..40, 1_usize..80), (300_usize..700, 1_usize..6)];
        (size, 0.0..1.0_f64).prop_flat_map(|((width, height), fill)| {
            let cell = (0.0..1.0_f64, any::<bool>()).prop_map(move |(u, unknown)| match (u < fill.powi(4), unknown) {
                (true, _) => CellState::Occupied,
                (false, true) if u > 0.98 => CellState::Unknown,
                _ => CellState::Free,
            });
            prop::collection::vec(cell, width * height).prop_map(move |states| map_of(width, height, &states))
        })
    }

    proptest! {
        #[test]
        fn is_exact(map in any_map(), unknown_is_obstacle: bool) {
            let params = DistanceParams { unknown_is_obstacle, max_distance: None };
            let mut transform = DistanceTransform::new(params).unwrap();
            let mut squared = Grid::filled(*map.layout(), 0);
            transform.squared_into(&map, &mut squared).unwrap();
            prop_assert_eq!(squared.values(), brute_force(&map, params));
            let metres = transform.compute(&map).unwrap();
            for (&m, &s) in metres.values().iter().zip(squared.values()) {
                let expected = if s == i32::MAX { f64::INFINITY } else { f64::from(s).sqrt() * 0.05 };
                prop_assert!(f64::from(m) == expected || (f64::from(m) - expected).abs() < 1e-5);
            }
        }

        #[test]
        fn a_limit_cuts_and_changes_nothing_below(map in any_map(), max in 0.01..2.0_f64) {
            let mut limited = DistanceTransform::new(DistanceParams { max_distance: Some(max), ..Default::default() }).unwrap();
            let field = limited.compute(&map).unwrap();
            for (&cut, &full) in field.values().iter().zip(distance_field(&map).unwrap().values()) {
                prop_assert_eq!(cut, full.min(max as f32));
            }
        }

        /// Stretches without an obstacle in reach between clusters: what is nearest there is arbitrary, but must not mislead the
        /// cells beside.
        #[test]
        fn a_limit_holds_in_long_sparse_rows(
            clusters in prop::collection::vec((0_usize..500, 0_usize..60, 1_usize..60, 1_usize..7), 1..12),
            max in 0.05..1.0_f64,
        ) {
            let mut map = map_of(500, 60, &[CellState::Free]);
            for (start, row, count, step) in clusters {
                for i in 0..count {
                    map.set(Cell::new((start + i * step) as i32, ((row + 5 * i) % 60) as i32), CellState::Occupied);
                }
            }
            let mut limited = DistanceTransform::new(DistanceParams { max_distance: Some(max), ..Default::default() }).unwrap();
            let field = limited.compute(&map).unwrap();
            for (&cut, &full) in field.values().iter().zip(distance_field(&map).unwrap().values()) {
                prop_assert_eq!(cut, full.min(max as f32));
            }
        }

        #[test]
        fn threads_and_used_memory_change_nothing(map in any_map(), earlier in any_map()) {
            let mut used = DistanceTransform::default().with_parallelism(Par::threads(3));
            let mut field = used.compute(&earlier).unwrap();
            used.compute_into(&map, &mut field).unwrap();
            prop_assert_eq!(field, distance_field(&map).unwrap());
        }
    }

    #[test]
    fn full_and_empty_maps_are_served() {
        let full = distance_field(&map_of(7, 40, &[CellState::Occupied])).unwrap();
        assert!(full.values().iter().all(|&d| d == 0.0));
        let empty = map_of(7, 40, &[CellState::Free]);
        assert!(distance_field(&empty).unwrap().values().iter().all(|&d| d == f32::INFINITY));
        let params = DistanceParams { max_distance: Some(2.0), ..Default::default() };
        let limited = DistanceTransform::new(params).unwrap().compute(&empty).unwrap();
        assert!(limited.values().iter().all(|&d| d == 2.0));
    }

    #[test]
    fn the_longest_sides_do_not_overflow() {
        let mut map = map_of(DistanceTransform::MAX_SIDE, 3, &[CellState::Free]);
        map.set(Cell::new(0, 0), CellState::Occupied);
        let mut squared = Grid::filled(*map.layout(), 0);
        DistanceTransform::default().squared_into(&map, &mut squared).unwrap();
        assert_eq!(squared.get(Cell::new(32_766, 2)), Some(&(32_766 * 32_766 + 4)));
    }

    #[test]
    fn bad_input_is_named() {
        for max in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let params = DistanceParams { max_distance: Some(max), ..Default::default() };
            assert!(matches!(DistanceTransform::new(params), Err(Error::NotPositive { name: "max_distance", .. })));
        }
        let long = map_of(1, DistanceTransform::MAX_SIDE + 1, &[CellState::Free]);
        assert!(matches!(distance_field(&long), Err(Error::TooMany { name: "height", .. })));
    }
}
