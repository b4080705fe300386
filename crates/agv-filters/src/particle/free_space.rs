//! Where the vehicle can stand: what global initialisation draws from.

use super::hilbert::along_hilbert_curve;
use agv_core::{
    Error, check,
    geometry::Se2,
    grid::{Cell, CellState, Components, Connectivity, CornerRule, DistanceTransform, Grid, GridLayout},
};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use std::f64::consts::PI;
use std::sync::Arc;

/// Where the middle of a vehicle can be, to draw poses from: the free cells of a map with room around them.
///
/// Cheap to clone: the cells are shared. Maps often show ground as free that no vehicle can reach (outside the walls,
/// inside a pillar, a gap behind a shelf): [`reached_from`](Self::reached_from) keeps to what a vehicle of that size can
/// reach from a place, [`largest`](Self::largest) to the largest connected area.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout};
/// use agv_filters::particle::FreeSpace;
///
/// // A yard and a room with a door of 0.5 m between them.
/// let mut map = Grid::filled(GridLayout::new(60, 20, 0.1, Se2::default())?, CellState::Free);
/// (0..20).filter(|y| !(8..13).contains(y)).for_each(|y| { map.set(Cell::new(20, y), CellState::Occupied); });
/// let anywhere = FreeSpace::new(&map, 0.1)?.largest();
/// let in_yard = FreeSpace::new(&map, 0.4)?.largest();
/// assert!(anywhere.len() > 1000 && in_yard.len() < 800, "a vehicle of 0.8 m does not pass the door");
/// let pose = in_yard.sample(&mut Seed(1).stream(0, 0));
/// assert!(pose.x() > 2.1 + 0.3);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FreeSpace {
    layout: GridLayout,
    /// In metres.
    radius: f64,
    /// Indices of the cells, in increasing order; not empty.
    cells: Arc<[u32]>,
    /// The same along a Hilbert curve: equal parts of it are patches.
    along_curve: Arc<[u32]>,
}

impl FreeSpace {
    /// The free cells of the map that are farther than `radius` metres from every occupied one, between centres.
    ///
    /// The largest circle around the middle of the vehicle that it covers is the radius for a vehicle that may stand at any
    /// heading: [`Footprint::inscribed_radius`](agv_core::grid::Footprint::inscribed_radius). Zero asks for no room.
    ///
    /// # Errors
    /// [`Error::Empty`] if there are none; a radius that is negative or not finite; a map that is too long for the
    /// [`DistanceTransform`].
    pub fn new(map: &Grid<CellState>, radius: f64) -> Result<Self, Error> {
        check::non_negative("vehicle radius", radius)?;
        let distance = DistanceTransform::default().compute(map)?;
        let has_room =
            |index: usize| map.values()[index] == CellState::Free && f64::from(distance.values()[index]) > radius;
        let cells: Arc<[u32]> = (0..map.layout().len()).filter(|&i| has_room(i)).map(|i| i as u32).collect();
        if cells.is_empty() {
            return Err(Error::Empty { name: "free space" });
        }
        let layout = *map.layout();
        let mut along_curve = Vec::with_capacity(cells.len());
        along_hilbert_curve(layout.width(), layout.height(), |index| {
            if has_room(index) {
                along_curve.push(index as u32);
            }
        });
        Ok(Self { layout, radius, cells, along_curve: along_curve.into() })
    }

    /// The part that can be reached from a map point: the area with the cell nearest to the point. A vehicle may stand
    /// nearer to a wall than its map shows possible, so that the cell may lie off by the radius and half a metre.
    ///
    /// # Errors
    /// [`Error::OutsideGrid`] if no cell lies that near.
    pub fn reached_from(&self, point: &Vector2<f64>) -> Result<Self, Error> {
        let components = self.components();
        let area = components.nearest(point, self.radius + 0.5);
        area.map(|area| self.only(&components, area)).ok_or(Error::OutsideGrid { x: point.x, y: point.y })
    }

    /// The largest connected part.
    #[must_use]
    pub fn largest(&self) -> Self {
        let components = self.components();
        components.largest().map_or_else(|| self.clone(), |area| self.only(&components, area))
    }

    /// The cells by what is connected over edges.
    fn components(&self) -> Components {
        let mut is_kept = vec![false; self.layout.len()];
        self.cells.iter().for_each(|&index| is_kept[index as usize] = true);
        let mut components = Components::default();
        components.compute(&self.layout, (Connectivity::Four, CornerRule::Never), |index| is_kept[index]);
        components
    }

    fn only(&self, components: &Components, area: u32) -> Self {
        let is_in_area = |index: &u32| components.label_at(*index as usize) == Some(area);
        let kept = |cells: &[u32]| cells.iter().copied().filter(is_in_area).collect();
        Self {
            layout: self.layout,
            radius: self.radius,
            cells: kept(&self.cells),
            along_curve: kept(&self.along_curve),
        }
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Number of cells, at least one.
    #[expect(clippy::len_without_is_empty, reason = "there is at least one cell")]
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Area of the cells, in square metres.
    pub fn area(&self) -> f64 {
        self.len() as f64 * self.layout.resolution() * self.layout.resolution()
    }

    /// A pose in free space, uniform over area and heading.
    pub fn sample(&self, stream: &mut impl Rng) -> Se2 {
        let cell = stream.random_range(0..self.cells.len());
        self.pose_in(self.cells[cell], stream.random(), stream)
    }

    /// The pose `index` of `count` that are spread over area and heading, as an [`ImprovedSwarm`](super::ImprovedSwarm) spreads them: each lies in its own of `count`
    /// equal patches of the area, and the headings follow each other by the golden ratio of a turn, so that those of poses that
    /// are numbered close to each other differ as much as they can.
    ///
    /// Each is uniform over area and heading if its index is drawn uniformly; all together leave fewer and smaller gaps than
    /// independent ones do.
    pub fn sample_stratum(&self, index: usize, count: usize, stream: &mut impl Rng) -> Se2 {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let count = count.max(1) as f64;
        let at = (index as f64 + stream.random::<f64>()) / count * self.cells.len() as f64;
        let turn = (index as f64 * GOLDEN + stream.random::<f64>() / count.sqrt()).fract();
        self.pose_in(self.along_curve[(at as usize).min(self.cells.len() - 1)], turn, stream)
    }

    /// A pose in a cell, given its heading as a part of a turn.
    fn pose_in(&self, cell: u32, turn: f64, stream: &mut impl Rng) -> Se2 {
        let Cell { x, y } = self.layout.cell(cell as usize);
        let within = Vector2::new(f64::from(x) + stream.random::<f64>(), f64::from(y) + stream.random::<f64>());
        let point = self.layout.to_map(&within);
        Se2::new(point.x, point.y, PI * (2.0 * turn - 1.0))
    }
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
        let all = FreeSpace::new(&map, 0.0).unwrap();
        assert_eq!((all.len(), all.largest().len()), (24, 20));
        let at = |x, y| map.layout().center(Cell::new(x, y));
        assert_eq!(all.reached_from(&at(2, 2)).unwrap().len(), 4);
        assert_eq!(all.reached_from(&at(9, 3)).unwrap().len(), 20, "half a metre into the wall");
        assert!(all.reached_from(&Vector2::new(50.0, 3.0)).is_err());
        assert!(all.reached_from(&Vector2::new(f64::NAN, 0.0)).is_err());
    }

    #[test]
    fn a_vehicle_needs_room() {
        let map = two_rooms();
        // Cells of 0.5 m: a radius of half a metre takes the cells along the walls, of the small room all.
        let space = FreeSpace::new(&map, 0.5).unwrap();
        assert_eq!((space.len(), space.largest().len()), (6, 6));
        assert_eq!(FreeSpace::new(&map, 1.0), Err(Error::Empty { name: "free space" }));
        assert!(FreeSpace::new(&map.map(|_| CellState::Unknown), 0.0).is_err());
        for radius in [-0.1, f64::NAN, f64::INFINITY] {
            assert!(FreeSpace::new(&map, radius).is_err());
        }
    }

    #[test]
    fn draws_are_uniform_over_the_cells() {
        let map = two_rooms();
        let space = FreeSpace::new(&map, 0.0).unwrap();
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

    /// Every cell of a stratum's width gets a pose, and every tenth of a turn its share.
    #[test]
    fn strata_leave_no_gaps() {
        let map = two_rooms();
        let space = FreeSpace::new(&map, 0.0).unwrap();
        let mut stream = Seed(3).stream(0, 0);
        let (mut per_cell, mut per_tenth) = (vec![0; map.layout().len()], [0_i32; 10]);
        for index in 0..2400 {
            let pose = space.sample_stratum(index, 2400, &mut stream);
            per_cell[map.layout().index(map.layout().cell_at(&pose.translation()).unwrap()).unwrap()] += 1;
            per_tenth[((pose.yaw() + PI) / (2.0 * PI) * 10.0) as usize % 10] += 1;
        }
        assert!(per_cell.iter().filter(|&&n| n > 0).all(|&n| n == 100));
        // Of independent draws the squared deviations would sum up to 2160 in the mean.
        assert!(per_tenth.iter().map(|n| (n - 240).pow(2)).sum::<i32>() < 700, "{per_tenth:?}");
        assert!((space.area() - 6.0).abs() < 1e-12);
        let beyond = space.sample_stratum(7, 0, &mut stream);
        assert!(map.get(map.layout().cell_at(&beyond.translation()).unwrap()) == Some(&CellState::Free));
    }
}
