//! How likely a beam is to end in a cell: the likelihood field of a map.
//!
//! A range finder's hits scatter around obstacles; some beams end anywhere (people, dust, glass). The density of an end
//! point at distance `d` from the nearest obstacle is the mixture
//!
//! ```text
//! p(d) = z_hit N(d; 0, σ_hit²) + z_rand / range_max        d cut at max_distance
//! ```
//!
//! (Thrun, Burgard and Fox, *Probabilistic Robotics*, 2005, section 6.4, Eqs. 6.33–6.36). It depends on the end point alone,
//! so it is computed once per map, on the exact distance transform, and a beam costs one look-up.

use super::{Cell, CellState, DistanceParams, DistanceTransform, Grid, GridLayout, surfaces::surfaces};
use crate::{Error, check, compute::Par};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// What a beam that ends in space that was never observed says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum UnknownSpace {
    /// What it says anywhere: the distance to the nearest obstacle counts, as in `nav2_amcl`.
    #[default]
    Free,
    /// Nothing: anything could stand there, so that the end point has the uniform density `1 / range_max`.
    Uniform,
    /// A hit: the unknown is taken for solid.
    Obstacle,
}

/// The mixture of a [`LikelihoodField`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LikelihoodFieldParams {
    /// Standard deviation of hits around obstacles, in metres; covers the map's error as well as the scanner's.
    pub sigma_hit: f64,
    /// Share of beams that hit what the map shows.
    pub z_hit: f64,
    /// Share of beams that end anywhere.
    pub z_rand: f64,
    /// Range over which the latter spread, in metres.
    pub range_max: f64,
    /// Distance beyond which all end points are alike, in metres.
    pub max_distance: f64,
    /// What a beam that ends in unobserved space says.
    pub unknown: UnknownSpace,
    /// Whether occupied cells count as obstacles only where a beam can end on them: where one of their four neighbours is free,
    /// or is unobserved and the cell is not the back of a wall (no surface lies straight through it within half a metre, nor
    /// close by).
    ///
    /// No beam ends inside a wall. If its inside counts all the same, a pose that puts the end points there is as likely
    /// as one that puts them on the face: walls of several cells spread the belief (Beluga, issue 265) and pull a
    /// scanner that looks ahead forward. A map none of whose occupied cells has a free neighbour (one that does not
    /// tell free from unknown) is taken as it is.
    pub only_surfaces: bool,
}

impl Default for LikelihoodFieldParams {
    /// The defaults of `nav2_amcl` and Beluga: 0.2 m, one half each over 100 m, 2 m; of walls only the surfaces.
    fn default() -> Self {
        Self {
            sigma_hit: 0.2,
            z_hit: 0.5,
            z_rand: 0.5,
            range_max: 100.0,
            max_distance: 2.0,
            unknown: UnknownSpace::Free,
            only_surfaces: true,
        }
    }
}

impl LikelihoodFieldParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A `sigma_hit`, `range_max`, `max_distance` or `z_rand` that is not finite and positive (without random beams one
    /// unmapped obstacle would make every pose impossible), or a negative `z_hit`.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("sigma_hit", self.sigma_hit)?;
        check::non_negative("z_hit", self.z_hit)?;
        check::positive("z_rand", self.z_rand)?;
        check::positive("range_max", self.range_max)?;
        check::positive("max_distance", self.max_distance)?;
        // What is stored is f32: the floor must not vanish there, nor the peak overflow.
        check::in_range("z_rand / range_max", self.floor(), 1e-30, 1e30)?;
        check::in_range("z_hit / sigma_hit", self.peak(), 0.0, 1e30)?;
        Ok(())
    }

    /// Density of an end point at `distance` metres from the nearest obstacle, in 1/m.
    pub fn density(&self, distance: f64) -> f64 {
        let scaled = distance.min(self.max_distance) / self.sigma_hit;
        self.peak() * (-0.5 * scaled * scaled).exp() + self.floor()
    }

    fn peak(&self) -> f64 {
        self.z_hit / (self.sigma_hit * TAU.sqrt())
    }

    fn floor(&self) -> f64 {
        self.z_rand / self.range_max
    }
}

/// Density of a beam's end point, per cell.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
///
/// let mut map = Grid::filled(GridLayout::new(100, 100, 0.05, Se2::default())?, CellState::Free);
/// map.set(Cell::new(50, 50), CellState::Occupied);
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// assert!(field.likelihood(Cell::new(50, 50)) > field.likelihood(Cell::new(54, 50)));
/// assert_eq!(field.likelihood(Cell::new(-1, 0)), field.off_map());
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct LikelihoodField {
    params: LikelihoodFieldParams,
    densities: Grid<f32>,
}

/// Most squared distances that are tabulated: up to a thousand cells of reach. Beyond, each cell is computed.
const MOST_ENTRIES: usize = 1 << 20;

impl LikelihoodField {
    /// The field of a map, on the calling thread. O(cells).
    ///
    /// # Errors
    /// Parameters that [`validate`](LikelihoodFieldParams::validate) refuses, or a map that is too long for the
    /// [`DistanceTransform`].
    pub fn new(map: &Grid<CellState>, params: LikelihoodFieldParams) -> Result<Self, Error> {
        Self::build(map, params, Par::Seq)
    }

    /// As [`new`](Self::new), on several threads.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn build(map: &Grid<CellState>, params: LikelihoodFieldParams, par: Par) -> Result<Self, Error> {
        params.validate()?;
        let layout = *map.layout();
        let distance = DistanceParams {
            unknown_is_obstacle: params.unknown == UnknownSpace::Obstacle,
            max_distance: Some(params.max_distance),
        };
        let surfaces = if params.only_surfaces { surfaces(map) } else { None };
        let obstacles = surfaces.as_ref().unwrap_or(map);

        // Squared distances are whole numbers of cells, few of them within reach: a table spares the exponentials.
        let density = |squared: usize| params.density((squared as f64).sqrt() * layout.resolution()) as f32;
        let far = params.density(params.max_distance) as f32;
        let reach = (params.max_distance / layout.resolution()).ceil();
        let entries = (reach * reach) as usize;
        let table: Vec<f32> = if entries < MOST_ENTRIES { (0..=entries).map(density).collect() } else { Vec::new() };
        let lookup = |squared: i32| match table.get(squared as usize) {
            Some(&value) => value,
            None if table.is_empty() => density(squared as usize),
            None => far,
        };
        let mut densities = Grid::filled(layout, 0.0);
        DistanceTransform::new(distance)?.with_parallelism(par).transform(obstacles, &mut densities, far, lookup)?;
        if params.unknown == UnknownSpace::Uniform {
            let uniform = params.range_max.recip() as f32;
            for (density, state) in densities.values_mut().iter_mut().zip(map.values()) {
                if *state == CellState::Unknown {
                    *density = uniform;
                }
            }
        }
        Ok(Self { params, densities })
    }

    /// The mixture that the field was built from.
    pub const fn params(&self) -> &LikelihoodFieldParams {
        &self.params
    }

    /// Size, resolution and pose.
    pub const fn layout(&self) -> &GridLayout {
        self.densities.layout()
    }

    /// Density per cell in 1/m, row by row from the lower-left.
    pub fn values(&self) -> &[f32] {
        self.densities.values()
    }

    /// Density of an end point that lies off the map, in 1/m: nothing is known there.
    pub fn off_map(&self) -> f32 {
        match self.params.unknown {
            UnknownSpace::Uniform => self.params.range_max.recip() as f32,
            _ => self.params.density(self.params.max_distance) as f32,
        }
    }

    /// Density of an end point in a cell, in 1/m.
    #[inline]
    pub fn likelihood(&self, cell: Cell) -> f32 {
        self.densities.get(cell).copied().unwrap_or_else(|| self.off_map())
    }

    /// Density of an end point at a map point, in 1/m.
    #[inline]
    pub fn likelihood_at(&self, point: &Vector2<f64>) -> f32 {
        self.layout().cell_at(point).map_or_else(|| self.off_map(), |cell| self.likelihood(cell))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Se2;
    use proptest::prelude::*;

    fn map(width: usize, height: usize, states: impl Fn(Cell) -> CellState) -> Grid<CellState> {
        let layout = GridLayout::new(width, height, 0.1, Se2::default()).unwrap();
        Grid::new(layout, (0..layout.len()).map(|i| states(layout.cell(i))).collect()).unwrap()
    }

    fn brute_force(map: &Grid<CellState>, cell: Cell, is_obstacle: impl Fn(usize) -> bool) -> f64 {
        let layout = map.layout();
        (0..layout.len())
            .filter(|&i| is_obstacle(i))
            .map(|i| (layout.center(layout.cell(i)) - layout.center(cell)).norm())
            .fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #[test]
        fn densities_follow_the_nearest_obstacle(
            cells in prop::collection::vec(0_u8..12, 12 * 9),
            sigma_hit in 0.05..0.5_f64,
            max_distance in 0.1..2.0_f64,
        ) {
            let state = |c: Cell| match cells[(c.y * 12 + c.x) as usize] { 0 => CellState::Occupied, 1 => CellState::Unknown, _ => CellState::Free };
            let map = map(12, 9, state);
            for unknown in [UnknownSpace::Free, UnknownSpace::Uniform, UnknownSpace::Obstacle] {
                let params = LikelihoodFieldParams { sigma_hit, max_distance, unknown, only_surfaces: false, ..Default::default() };
                let field = LikelihoodField::new(&map, params).unwrap();
                for i in 0..map.layout().len() {
                    let cell = map.layout().cell(i);
                    let distance = brute_force(&map, cell, |i| map.values()[i] == CellState::Occupied
                        || (unknown == UnknownSpace::Obstacle && map.values()[i] == CellState::Unknown));
                    let expected = if unknown == UnknownSpace::Uniform && state(cell) == CellState::Unknown {
                        0.01
                    } else {
                        let d = distance.min(max_distance);
                        0.5 * (-d * d / (2.0 * sigma_hit * sigma_hit)).exp() / (sigma_hit * TAU.sqrt()) + 0.005
                    };
                    prop_assert!((f64::from(field.likelihood(cell)) - expected).abs() < 1e-6 * expected.max(1.0));
                }
            }
        }
    }

    #[test]
    fn a_reach_too_long_for_a_table_gives_the_same_field() {
        let map = map(40, 30, |c| if c == Cell::new(7, 9) { CellState::Occupied } else { CellState::Free });
        let params = LikelihoodFieldParams { sigma_hit: 1.0, max_distance: 100.0, ..Default::default() };
        let (tabulated, computed) = (
            LikelihoodField::new(&map, params).unwrap(),
            LikelihoodField::new(&map, LikelihoodFieldParams { max_distance: 200.0, ..params }).unwrap(),
        );
        assert_eq!(tabulated.values(), computed.values());
    }

    #[test]
    fn the_inside_of_a_wall_is_no_surface() {
        // From the left: unobserved, a wall of five cells, free space.
        let wall = |front: CellState| {
            map(14, 9, move |c| match c.x {
                0..3 => CellState::Unknown,
                3..8 => CellState::Occupied,
                _ => front,
            })
        };
        let field = |map: &Grid<CellState>, only_surfaces| {
            let params = LikelihoodFieldParams { only_surfaces, ..Default::default() };
            LikelihoodField::new(map, params).unwrap()
        };
        let observed = wall(CellState::Free);
        let (surface, solid) = (field(&observed, true), field(&observed, false));
        for y in 0..9 {
            for x in 0..14 {
                let distance = 0.1 * (7.0 - f64::from(x)).abs();
                let expected = surface.params().density(distance) as f32;
                assert!((surface.likelihood(Cell::new(x, y)) - expected).abs() < 1e-6 * expected, "({x}, {y})");
            }
        }
        assert_eq!(solid.likelihood(Cell::new(4, 4)), solid.likelihood(Cell::new(7, 4)));
        let unobserved = wall(CellState::Unknown);
        assert_eq!(field(&unobserved, true).values(), field(&unobserved, false).values());
    }

    #[test]
    fn what_was_seen_through_a_gap_is_a_surface() {
        // From the left: free space, a wall of two cells with a gap, unobserved space, and in it a thin wall and a solid one.
        let map = map(40, 20, |c| match (c.x, c.y) {
            (0..10, _) => CellState::Free,
            (10..12, y) if y != 7 => CellState::Occupied,
            (20 | 30..34, _) => CellState::Occupied,
            _ => CellState::Unknown,
        });
        let field = LikelihoodField::new(&map, LikelihoodFieldParams::default()).unwrap();
        let is_surface = |x: i32| field.likelihood(Cell::new(x, 12)) > field.params().density(0.05) as f32;
        let found: Vec<i32> = (0..40).filter(|&x| is_surface(x)).collect();
        // Not the back of the first wall, but both sides of the one that no surface says to be a back.
        assert_eq!(found, [10, 20, 30, 33]);
    }

    #[test]
    fn a_map_without_obstacles_says_the_same_everywhere() {
        let field = LikelihoodField::new(&map(5, 4, |_| CellState::Free), LikelihoodFieldParams::default()).unwrap();
        assert!(field.values().iter().all(|&v| v == field.off_map()));
        assert_eq!(field.likelihood_at(&Vector2::new(f64::NAN, 0.0)), field.off_map());
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = LikelihoodFieldParams::default();
        let map = map(5, 4, |_| CellState::Free);
        for (name, bad) in [
            ("sigma_hit", LikelihoodFieldParams { sigma_hit: 0.0, ..good }),
            ("z_hit", LikelihoodFieldParams { z_hit: -0.1, ..good }),
            ("z_rand", LikelihoodFieldParams { z_rand: 0.0, ..good }),
            ("range_max", LikelihoodFieldParams { range_max: f64::INFINITY, ..good }),
            ("max_distance", LikelihoodFieldParams { max_distance: f64::NAN, ..good }),
            ("z_rand / range_max", LikelihoodFieldParams { z_rand: 1e-300, ..good }),
            ("z_hit / sigma_hit", LikelihoodFieldParams { sigma_hit: 1e-300, ..good }),
        ] {
            let error = LikelihoodField::new(&map, bad).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }
}
