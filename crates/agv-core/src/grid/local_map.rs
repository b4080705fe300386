//! The surroundings as a local planner asks for them: costs, obstacles, and how far they are.

use super::{CellState, CollisionParams, Costmap, Footprint, Grid, GridLayout, ObstacleMap, cost, revision::Revision};
use crate::{
    Error,
    compute::Par,
    geometry::{Se2, Twist2},
};
use nalgebra::Vector2;

/// Parameters of a [`LocalMap`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LocalMapParams {
    /// What counts as an obstacle.
    pub collision: CollisionParams,
    /// Distance to obstacles beyond which planners do not care, in metres: greater ones are reported as this.
    pub max_distance: f64,
}

impl Default for LocalMapParams {
    /// Nothing unseen may be touched, and 5 m: what a vehicle of 2 m/s needs to stop and to swerve, twice.
    fn default() -> Self {
        Self { collision: CollisionParams::default(), max_distance: 5.0 }
    }
}

/// A costmap with the distance to its lethal cells, built once for all that ask.
///
/// [`update`](Self::update) takes a costmap at each cycle and does nothing if it is the one that is known; the queries read
/// only, so that the trajectories of a planner may be checked on several threads.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost};
/// use agv_core::nalgebra::Vector2;
///
/// let layout = GridLayout::new(120, 120, 0.05, Se2::default())?;
/// let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
/// let mut local = LocalMap::new(&costmap, LocalMapParams::default())?;
/// costmap.set(Cell::new(80, 60), cost::LETHAL);
/// assert!(local.update(&costmap)?);
/// assert!(!local.update(&costmap)?, "nothing new");
/// let (distance, gradient) = local.distance_at(&Vector2::new(3.0, 3.0)).unwrap();
/// assert!((distance - 1.025).abs() < 1e-3 && gradient.x < -0.99);
/// assert!(local.collides(&Footprint::circle(0.3)?, &Se2::new(3.8, 3.0, 0.0))?);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct LocalMap {
    costmap: Costmap,
    /// What was taken last.
    seen: Revision,
    obstacles: ObstacleMap,
    /// The costmap as a map of obstacles: working memory.
    cells: Grid<CellState>,
}

fn state(cost: u8) -> CellState {
    match cost {
        cost::LETHAL => CellState::Occupied,
        cost::UNKNOWN => CellState::Unknown,
        _ => CellState::Free,
    }
}

impl LocalMap {
    /// The local map of a costmap. Lethal cells are obstacles, and those that were not observed as the parameters say;
    /// inflated costs are not.
    ///
    /// # Errors
    /// A `max_distance` that is not finite and positive, or a map that is too long for a
    /// [`DistanceTransform`](super::DistanceTransform).
    pub fn new(costmap: &Costmap, params: LocalMapParams) -> Result<Self, Error> {
        let cells = Grid::new(*costmap.layout(), costmap.costs().iter().copied().map(state).collect())?;
        let obstacles = ObstacleMap::new(&cells, params.collision, Some(params.max_distance))?;
        Ok(Self { costmap: costmap.clone(), seen: costmap.revision().clone(), obstacles, cells })
    }

    /// The same map, updated on several threads; the bits do not depend on it.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.obstacles = self.obstacles.with_parallelism(par);
        self
    }

    /// Takes the costs as they are now, and says whether they are new.
    ///
    /// O(1) if the costmap was not written since the last call, O(cells) to compare if it was, or is another one, but its
    /// costs are the same; else O(cells) with the distance field. Allocates only for a map greater than those before.
    ///
    /// # Errors
    /// A map that is too long for a [`DistanceTransform`](super::DistanceTransform); the local map is then as it was.
    pub fn update(&mut self, costmap: &Costmap) -> Result<bool, Error> {
        if self.seen == *costmap.revision() {
            return Ok(false);
        }
        let same = self.costmap == *costmap;
        if !same {
            self.cells.reshape(*costmap.layout(), CellState::Unknown);
            for (cell, &cost) in self.cells.values_mut().iter_mut().zip(costmap.costs()) {
                *cell = state(cost);
            }
            self.obstacles.set_map(&self.cells)?;
            self.costmap.copy_from(costmap);
        }
        self.seen = costmap.revision().clone();
        Ok(!same)
    }

    /// Costs, as they were taken. Its [`revision`](Costmap::revision) changes when an update brings something new.
    pub const fn costmap(&self) -> &Costmap {
        &self.costmap
    }

    /// The blocked cells, and the distance to them.
    pub const fn obstacles(&self) -> &ObstacleMap {
        &self.obstacles
    }

    /// Size, resolution and pose.
    pub const fn layout(&self) -> &GridLayout {
        self.costmap.layout()
    }

    /// Which state of the local map this is: equal revisions have equal answers.
    pub const fn revision(&self) -> &Revision {
        self.costmap.revision()
    }

    /// As [`ObstacleMap::distance_at`]; none off the map only.
    #[inline]
    pub fn distance_at(&self, point: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        self.obstacles.distance_at(point)
    }

    /// As [`ObstacleMap::collides`].
    ///
    /// # Errors
    /// A pose that is not finite, or 2^28 cells away.
    pub fn collides(&self, footprint: &Footprint, map_from_base: &Se2) -> Result<bool, Error> {
        self.obstacles.collides(footprint, map_from_base)
    }

    /// As [`ObstacleMap::collides_along`].
    ///
    /// # Errors
    /// A pose or twist that is not finite, a negative `dt`, or too long a motion.
    pub fn collides_along(
        &self,
        footprint: &Footprint,
        map_from_base: &Se2,
        twist: &Twist2,
        dt: f64,
    ) -> Result<bool, Error> {
        self.obstacles.collides_along(footprint, map_from_base, twist, dt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Cell, CollisionChecker};
    use proptest::prelude::*;

    fn costmap(width: usize, costs: &[u8]) -> Costmap {
        let layout = GridLayout::new(width, costs.len() / width, 0.1, Se2::new(0.3, -0.2, 0.4)).unwrap();
        Costmap::from_costs(Grid::new(layout, costs.to_vec()).unwrap())
    }

    fn any_costs() -> impl Strategy<Value = Vec<u8>> {
        let cost = prop_oneof![8 => 0..=253_u8, 1 => Just(cost::LETHAL), 1 => Just(cost::UNKNOWN)];
        prop::collection::vec(cost, 24 * 18)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// A map that was updated answers as one that is new, and as a checker of the same obstacles.
        #[test]
        fn an_updated_map_is_as_a_new_one(
            before in any_costs(), after in any_costs(), unknown: bool, outside: bool,
            poses in prop::collection::vec((-1.0..3.0_f64, -1.0..3.0_f64, -3.0..3.0_f64), 20),
        ) {
            let collision = CollisionParams { unknown_is_obstacle: unknown, outside_is_obstacle: outside };
            let params = LocalMapParams { collision, max_distance: 0.5 };
            let mut local = LocalMap::new(&costmap(18, &before), params).unwrap();
            let revision = local.revision().clone();
            let next = costmap(24, &after);
            prop_assert!(local.update(&next).unwrap() && local.revision() != &revision);
            prop_assert_eq!(local.costmap(), &next);
            let fresh = LocalMap::new(&next, params).unwrap();
            prop_assert_eq!(local.obstacles().distance(), fresh.obstacles().distance());
            let cells = Grid::new(*next.layout(), after.iter().copied().map(state).collect()).unwrap();
            let footprint = Footprint::rectangle(-0.2, 0.7, 0.3).unwrap();
            let checker = CollisionChecker::new(&cells, footprint.clone(), collision).unwrap();
            for (x, y, yaw) in poses {
                let pose = Se2::new(x, y, yaw);
                prop_assert_eq!(local.collides(&footprint, &pose), checker.collides(&pose));
                let twist = Twist2::new(0.7, 0.0, 0.4);
                prop_assert_eq!(local.collides_along(&footprint, &pose, &twist, 1.0), checker.collides_along(&pose, &twist, 1.0));
            }
        }
    }

    #[test]
    fn what_is_known_is_not_built_again() {
        let mut source = costmap(4, &[0; 16]);
        let mut local = LocalMap::new(&source, LocalMapParams::default()).unwrap();
        let first = local.revision().clone();
        assert_eq!(local.update(&source), Ok(false));
        // Written, but with what was there; and another costmap of the same costs.
        source.costs_mut()[3] = 0;
        assert_eq!((local.update(&source), local.update(&source.clone())), (Ok(false), Ok(false)));
        assert_eq!(local.revision(), &first);
        source.set(Cell::new(1, 1), cost::LETHAL);
        assert_eq!((local.update(&source), local.update(&source)), (Ok(true), Ok(false)));
        assert_ne!(local.revision(), &first);
    }

    #[test]
    fn bad_input_is_named() {
        let source = costmap(4, &[0; 16]);
        for max_distance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let params = LocalMapParams { max_distance, ..LocalMapParams::default() };
            assert!(matches!(LocalMap::new(&source, params), Err(Error::NotPositive { name: "max_distance", .. })));
        }
        let mut local = LocalMap::new(&source, LocalMapParams::default()).unwrap();
        assert_eq!(local.distance_at(&Vector2::new(f64::NAN, 0.0)), None);
        assert!(local.collides(&Footprint::circle(0.1).unwrap(), &Se2::new(f64::NAN, 0.0, 0.0)).is_err());
        let long = GridLayout::new(40_000, 1, 0.1, Se2::default()).unwrap();
        assert!(local.update(&Costmap::from_costs(Grid::filled(long, 0))).is_err());
        assert_eq!(local.costmap(), &source);
    }
}
