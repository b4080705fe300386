//! Inflation: what it costs to come near an obstacle, as Nav2's inflation layer has it.
//!
//! With `d` the distance to the nearest obstacle (between cell centres),
//!
//! ```text
//! cost(d) = 254                                 d = 0
//!           253                                 d <= inscribed radius: the vehicle's centre cannot be here
//!           252 exp(-k (d - inscribed radius))  d <= inflation radius
//!             0                                 beyond
//! ```
//!
//! Nav2 spreads costs by a queue; here the exact distance transform says `d`, and a table by squared cells the cost.

use super::{CellState, Costmap, DistanceParams, DistanceTransform, Footprint, Grid, cost};
use crate::{Error, check, compute::Par};

/// Parameters of an [`Inflation`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct InflationParams {
    /// Radius of the greatest circle around the vehicle's origin that its footprint holds, in metres.
    pub inscribed_radius: f64,
    /// Distance from obstacles beyond which nothing is added, in metres; at least `inscribed_radius`.
    pub inflation_radius: f64,
    /// `k`: how fast costs fall with distance, per metre.
    pub cost_scaling_factor: f64,
    /// Whether cells that were not observed take any cost from obstacles near; if not, only one that forbids them.
    pub inflate_unknown: bool,
    /// Whether costs spread from cells that were not observed, as from obstacles.
    pub inflate_around_unknown: bool,
}

impl Default for InflationParams {
    /// Nav2's inflation layer, for a vehicle of 0.2 m radius.
    fn default() -> Self {
        Self {
            inscribed_radius: 0.2,
            inflation_radius: 0.55,
            cost_scaling_factor: 10.0,
            inflate_unknown: false,
            inflate_around_unknown: false,
        }
    }
}

impl InflationParams {
    /// The defaults for a vehicle: costs reach 0.35 m beyond the circle around its footprint.
    pub fn for_footprint(footprint: &Footprint) -> Self {
        let default = Self::default();
        Self {
            inscribed_radius: footprint.inscribed_radius(),
            inflation_radius: footprint.circumscribed_radius() + default.inflation_radius - default.inscribed_radius,
            ..default
        }
    }

    /// Cost at `distance` metres from the nearest obstacle.
    ///
    /// At the circumscribed radius of a footprint it is the cost below which a vehicle is free whatever its heading.
    pub fn cost_at(&self, distance: f64) -> u8 {
        // Six cells of 0.05 m are 0.3 m, and a hair more in binary: they are held by a radius of 0.3 m all the same.
        let within = |radius: f64| distance <= radius * (1.0 + 1e-9);
        if distance <= 0.0 {
            cost::LETHAL
        } else if within(self.inscribed_radius) {
            cost::INSCRIBED
        } else if within(self.inflation_radius) {
            let decay = (-self.cost_scaling_factor * (distance - self.inscribed_radius)).exp();
            (f64::from(cost::MAX_NON_OBSTACLE) * decay) as u8
        } else {
            cost::FREE
        }
    }
}

/// Turns maps into costmaps, and keeps its working memory for the next one.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout, Inflation, InflationParams, cost};
///
/// let mut map = Grid::filled(GridLayout::new(40, 40, 0.05, Se2::default())?, CellState::Free);
/// map.set(Cell::new(20, 20), CellState::Occupied);
/// let costmap = Inflation::new(InflationParams::default())?.inflate(&map)?;
/// assert_eq!(costmap.cost(Cell::new(24, 20)), Some(cost::INSCRIBED));
/// assert!(costmap.is_traversable(Cell::new(25, 20)));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Inflation {
    params: InflationParams,
    transform: DistanceTransform,
    /// Cost by squared distance in cells, for this resolution.
    costs: Vec<u8>,
    resolution: f64,
}

impl Inflation {
    /// Widest inflation, in cells: the table of costs grows with its square.
    pub const MAX_REACH: usize = 2048;

    /// An inflation with these parameters.
    ///
    /// # Errors
    /// A parameter that is not finite, a negative one, or an inflation radius of zero or below the inscribed one.
    pub fn new(params: InflationParams) -> Result<Self, Error> {
        check::non_negative("inscribed_radius", params.inscribed_radius)?;
        check::positive("inflation_radius", params.inflation_radius)?;
        check::in_range("inflation_radius", params.inflation_radius, params.inscribed_radius, f64::MAX)?;
        check::non_negative("cost_scaling_factor", params.cost_scaling_factor)?;
        let distance = DistanceParams {
            unknown_is_obstacle: params.inflate_around_unknown,
            max_distance: Some(params.inflation_radius),
        };
        Ok(Self { params, transform: DistanceTransform::new(distance)?, costs: Vec::new(), resolution: f64::NAN })
    }

    /// The same inflation on several threads.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.transform = self.transform.with_parallelism(par);
        self
    }

    /// The parameters.
    pub const fn params(&self) -> &InflationParams {
        &self.params
    }

    /// Costmap of a map. O(cells), whatever the radius.
    ///
    /// # Errors
    /// An inflation radius of more than [`MAX_REACH`](Self::MAX_REACH) cells, or a map that is too long for a
    /// [`DistanceTransform`].
    pub fn inflate(&mut self, map: &Grid<CellState>) -> Result<Costmap, Error> {
        let mut costmap = Costmap::from_costs(Grid::filled(*map.layout(), cost::FREE));
        self.inflate_into(map, &mut costmap)?;
        Ok(costmap)
    }

    /// As [`inflate`](Self::inflate), into a costmap that takes the map's layout; its memory is used again if it fits.
    ///
    /// # Errors
    /// As [`inflate`](Self::inflate); the costmap is then as it was.
    pub fn inflate_into(&mut self, map: &Grid<CellState>, costmap: &mut Costmap) -> Result<(), Error> {
        self.tabulate(map.layout().resolution())?;
        let Self { params, transform, costs, .. } = self;
        let cost_of = |squared: i32| costs.get(squared as usize).copied().unwrap_or(cost::FREE);
        transform.transform(map, costmap.grid_mut(), cost::FREE, cost_of)?;
        // Costs from which on an obstacle near hides that a cell was not observed.
        let hides = if params.inflate_unknown { cost::FREE + 1 } else { cost::INSCRIBED };
        for (cost, &state) in costmap.grid_mut().values_mut().iter_mut().zip(map.values()) {
            let own_source = params.inflate_around_unknown && *cost == cost::LETHAL;
            if state == CellState::Unknown && (*cost < hides || own_source) {
                *cost = cost::UNKNOWN;
            }
        }
        Ok(())
    }

    fn tabulate(&mut self, resolution: f64) -> Result<(), Error> {
        if self.resolution != resolution {
            let reach = (self.params.inflation_radius / resolution).ceil();
            check::in_range("inflation_radius (cells)", reach, 0.0, Self::MAX_REACH as f64)?;
            let cells = (reach as usize).pow(2);
            self.costs.clear();
            self.costs.extend((0..=cells).map(|squared| self.params.cost_at((squared as f64).sqrt() * resolution)));
            self.resolution = resolution;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::Se2,
        grid::{Cell, GridLayout},
    };
    use proptest::prelude::*;

    fn any_map() -> impl Strategy<Value = Grid<CellState>> {
        let cell =
            prop_oneof![40 => Just(CellState::Free), 3 => Just(CellState::Unknown), 1 => Just(CellState::Occupied)];
        prop::collection::vec(cell, 40 * 30)
            .prop_map(|states| Grid::new(GridLayout::new(40, 30, 0.05, Se2::default()).unwrap(), states).unwrap())
    }

    proptest! {
        /// Nav2's rule, applied to every pair of an obstacle and a cell: costs are the greatest that reach a cell.
        #[test]
        fn agrees_with_spreading_from_every_obstacle(map in any_map(), inflate_unknown: bool, around: bool) {
            let params = InflationParams { inflate_unknown, inflate_around_unknown: around, ..Default::default() };
            let costmap = Inflation::new(params).unwrap().inflate(&map).unwrap();
            let layout = *map.layout();
            for i in 0..layout.len() {
                let c = layout.cell(i);
                let mut own = match map.values()[i] {
                    CellState::Free => cost::FREE,
                    CellState::Unknown => cost::UNKNOWN,
                    CellState::Occupied => cost::LETHAL,
                };
                let unknown = own == cost::UNKNOWN;
                let spread = (0..layout.len())
                    .filter(|&o| o != i && (map.values()[o] == CellState::Occupied || (around && map.values()[o] == CellState::Unknown)))
                    .map(|o| {
                        let o = layout.cell(o);
                        params.cost_at(f64::from((o.x - c.x).pow(2) + (o.y - c.y).pow(2)).sqrt() * 0.05)
                    })
                    .max()
                    .unwrap_or(cost::FREE);
                if !unknown {
                    own = own.max(spread);
                } else if !around && spread >= if inflate_unknown { 1 } else { cost::INSCRIBED } {
                    own = spread;
                }
                prop_assert_eq!(costmap.cost(c), Some(own), "{:?}", c);
            }
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = InflationParams::default();
        for (name, bad) in [
            ("inscribed_radius", InflationParams { inscribed_radius: -0.1, ..good }),
            ("inscribed_radius", InflationParams { inscribed_radius: f64::NAN, ..good }),
            ("inflation_radius", InflationParams { inflation_radius: f64::INFINITY, ..good }),
            ("inflation_radius", InflationParams { inflation_radius: 0.1, ..good }),
            ("cost_scaling_factor", InflationParams { cost_scaling_factor: f64::NAN, ..good }),
        ] {
            assert!(Inflation::new(bad).unwrap_err().to_string().starts_with(name), "{name}");
        }
        let map = Grid::filled(GridLayout::new(3, 3, 0.05, Se2::default()).unwrap(), CellState::Free);
        let wide = InflationParams { inflation_radius: 1e6, ..good };
        assert!(matches!(Inflation::new(wide).unwrap().inflate(&map), Err(Error::OutOfRange { .. })));
    }

    #[test]
    fn used_memory_and_another_resolution_change_nothing() {
        let mut inflation = Inflation::new(InflationParams::default()).unwrap();
        let mut costmap = Costmap::from_costs(Grid::filled(GridLayout::new(1, 1, 1.0, Se2::default()).unwrap(), 0));
        for resolution in [0.05, 0.1, 0.05] {
            let layout = GridLayout::new(30, 20, resolution, Se2::default()).unwrap();
            let mut map = Grid::filled(layout, CellState::Free);
            map.set(Cell::new(10, 10), CellState::Occupied);
            inflation.inflate_into(&map, &mut costmap).unwrap();
            assert_eq!(costmap, Inflation::new(InflationParams::default()).unwrap().inflate(&map).unwrap());
        }
    }

    #[test]
    fn a_radius_holds_the_cells_at_that_distance() {
        for (resolution, cells) in [(0.05, 6), (0.05, 7), (0.03, 10), (0.1, 3), (0.1, 7)] {
            let radius: f64 = format!("{:.2}", resolution * f64::from(cells)).parse().unwrap();
            let params = InflationParams { inscribed_radius: radius, inflation_radius: radius, ..Default::default() };
            let mut map = Grid::filled(GridLayout::new(30, 1, resolution, Se2::default()).unwrap(), CellState::Free);
            map.set(Cell::new(0, 0), CellState::Occupied);
            let costmap = Inflation::new(params).unwrap().inflate(&map).unwrap();
            let costs = [cells, cells + 1].map(|x| costmap.cost(Cell::new(x, 0)).unwrap());
            assert_eq!(costs, [cost::INSCRIBED, cost::FREE], "{resolution} {cells}");
        }
    }
}
