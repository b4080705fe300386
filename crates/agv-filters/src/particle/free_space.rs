//! Where the vehicle can stand: what global initialisation draws from.

use agv_core::{
    Error,
    geometry::Se2,
    grid::{Cell, CellState, Components, Connectivity, CornerRule, Grid, GridLayout},
};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use std::f64::consts::PI;
use std::sync::Arc;

/// The free cells of a map, to draw poses from.
///
/// Cheap to clone: the cells are shared. Maps often show ground as free that no vehicle can reach (outside the walls,
/// inside a pillar): [`connected_to`](Self::connected_to) keeps to what is connected with a place, [`largest`](Self::largest) to the
/// largest connected area.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout};
/// use agv_filters::particle::FreeSpace;
///
/// let mut map = Grid::filled(GridLayout::new(20, 10, 0.1, Se2::default())?, CellState::Unknown);
/// map.set(Cell::new(3, 4), CellState::Free);
/// let pose = FreeSpace::new(&map)?.sample(&mut Seed(1).stream(0, 0));
/// assert_eq!(map.layout().cell_at(&pose.translation()), Some(Cell::new(3, 4)));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FreeSpace {
    layout: GridLayout,
    /// Indices of the free cells, in increasing order; not empty.
    cells: Arc<[u32]>,
}

impl FreeSpace {
    /// All free cells of the map.
    ///
    /// # Errors
    /// [`Error::Empty`] if there are none.
    pub fn new(map: &Grid<CellState>) -> Result<Self, Error> {
        Self::keep(map, |index| map.values().get(index) == Some(&CellState::Free))
    }

    /// The free cells that are connected, over edges, with the one at a map point.
    ///
    /// # Errors
    /// [`Error::OutsideGrid`] if the point is not in a free cell of the map.
    pub fn connected_to(map: &Grid<CellState>, point: &Vector2<f64>) -> Result<Self, Error> {
        let outside = Error::OutsideGrid { x: point.x, y: point.y };
        let cell = map.layout().cell_at(point).ok_or(outside)?;
        let components = components(map);
        let label = components.label(cell).ok_or(outside)?;
        Self::keep(map, |index| components.label_at(index) == Some(label))
    }

    /// The largest connected area of free cells.
    ///
    /// # Errors
    /// [`Error::Empty`] if no cell is free.
    pub fn largest(map: &Grid<CellState>) -> Result<Self, Error> {
        let components = components(map);
        let largest = components.largest();
        Self::keep(map, |index| largest.is_some() && components.label_at(index) == largest)
    }

    fn keep(map: &Grid<CellState>, is_kept: impl Fn(usize) -> bool) -> Result<Self, Error> {
        let cells: Arc<[u32]> =
            (0..map.layout().len()).filter(|&index| is_kept(index)).map(|index| index as u32).collect();
        if cells.is_empty() {
            Err(Error::Empty { name: "free space" })
        } else {
            Ok(Self { layout: *map.layout(), cells })
        }
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Number of free cells, at least one.
    #[expect(clippy::len_without_is_empty, reason = "there is at least one free cell")]
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// A pose in free space, uniform over area and heading.
    pub fn sample(&self, stream: &mut impl Rng) -> Se2 {
        let index = self.cells[stream.random_range(0..self.cells.len())];
        let Cell { x, y } = self.layout.cell(index as usize);
        let within = Vector2::new(f64::from(x) + stream.random::<f64>(), f64::from(y) + stream.random::<f64>());
        let point = self.layout.to_map(&within);
        Se2::new(point.x, point.y, PI * (2.0 * stream.random::<f64>() - 1.0))
    }
}

/// The free cells by what is connected over edges.
fn components(map: &Grid<CellState>) -> Components {
    let mut components = Components::default();
    let free = |index: usize| map.values().get(index) == Some(&CellState::Free);
    components.compute(map.layout(), (Connectivity::Four, CornerRule::Never), free);
    components
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;

    /// A small room of 2 x 2 cells beside a large one of 5 x 4, with a wall between.
    fn two_rooms() -> Grid<CellState> {
        let mut map = Grid::filled(GridLayout::new(10, 6, 0.5, Se2::new(1.0, 2.0, 0.4)).unwrap(), CellState::Occupied);
        for (x0, y0, w, h) in [(1, 1, 2, 2), (4, 1, 5, 4)] {
            for x in x0..x0 + w {
                for y in y0..y0 + h {
                    map.set(Cell::new(x, y), CellState::Free);
                }
            }
        }
        map
    }

    #[test]
    fn areas_are_told_apart() {
        let map = two_rooms();
        assert_eq!(FreeSpace::new(&map).unwrap().len(), 24);
        assert_eq!(FreeSpace::largest(&map).unwrap().len(), 20);
        let small = FreeSpace::connected_to(&map, &map.layout().center(Cell::new(2, 2))).unwrap();
        assert_eq!(small.len(), 4);
        assert!(FreeSpace::connected_to(&map, &map.layout().center(Cell::new(3, 3))).is_err());
        assert!(FreeSpace::connected_to(&map, &Vector2::new(f64::NAN, 0.0)).is_err());
        assert!(FreeSpace::new(&map.map(|_| CellState::Unknown)).is_err());
        assert!(FreeSpace::largest(&map.map(|_| CellState::Unknown)).is_err());
    }

    #[test]
    fn draws_are_uniform_over_the_cells() {
        let map = two_rooms();
        let space = FreeSpace::new(&map).unwrap();
        let mut counts = vec![0.0; map.layout().len()];
        let mut stream = Seed(3).stream(0, 0);
        let draws = 24_000;
        for _ in 0..draws {
            let cell = map.layout().cell_at(&space.sample(&mut stream).translation()).unwrap();
            assert_eq!(map.get(cell), Some(&CellState::Free));
            counts[map.layout().index(cell).unwrap()] += 1.0;
        }
        let expected = f64::from(draws) / 24.0;
        let statistic: f64 = counts.iter().filter(|&&n| n > 0.0).map(|n| (n - expected).powi(2) / expected).sum();
        // 99.9 % quantile of chi-square with 23 degrees of freedom.
        assert!(statistic < 49.7, "{statistic}");
    }
}
