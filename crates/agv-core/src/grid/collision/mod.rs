//! Does the vehicle touch an obstacle, standing or on the way?

mod obstacle_map;

use super::{CellState, Footprint, Grid, GridLayout};
use crate::{
    Error,
    geometry::{Se2, Twist2},
};
pub use obstacle_map::ObstacleMap;

/// What a vehicle may not touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CollisionParams {
    /// Whether cells that were not observed are obstacles.
    pub unknown_is_obstacle: bool,
    /// Whether all that lies off the map is an obstacle.
    pub outside_is_obstacle: bool,
}

impl Default for CollisionParams {
    /// Nothing unseen may be touched: the safe choice.
    fn default() -> Self {
        Self { unknown_is_obstacle: true, outside_is_obstacle: true }
    }
}

/// Checks poses and motions of one vehicle against one map.
///
/// Queries read only and do not allocate, so that planners on several threads may share one checker.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{Cell, CellState, CollisionChecker, CollisionParams, Footprint, Grid, GridLayout};
///
/// let mut map = Grid::filled(GridLayout::new(200, 100, 0.05, Se2::default())?, CellState::Free);
/// map.set(Cell::new(100, 50), CellState::Occupied);
/// let checker = CollisionChecker::new(&map, Footprint::rectangle(-0.5, 0.5, 0.6)?, CollisionParams::default())?;
/// let start = Se2::new(2.0, 2.5, 0.0);
/// assert!(!checker.collides(&start)?);
/// assert!(checker.collides_along(&start, &Twist2::new(1.0, 0.0, 0.0), 6.0)?);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CollisionChecker {
    footprint: Footprint,
    obstacles: ObstacleMap,
}

impl CollisionChecker {
    /// Most samples of one motion.
    pub const MAX_SAMPLES: usize = ObstacleMap::MAX_SAMPLES;

    /// A checker for a map.
    ///
    /// # Errors
    /// A map that is too long for a [`DistanceTransform`](super::DistanceTransform).
    pub fn new(map: &Grid<CellState>, footprint: Footprint, params: CollisionParams) -> Result<Self, Error> {
        Ok(Self { footprint, obstacles: ObstacleMap::new(map, params, None)? })
    }

    /// Takes another map; memory is used again. O(cells).
    ///
    /// # Errors
    /// As [`new`](Self::new); the checker then keeps the map it has.
    pub fn set_map(&mut self, map: &Grid<CellState>) -> Result<(), Error> {
        self.obstacles.set_map(map)
    }

    /// Takes another outline, as when a load is taken up; the map stays. O(1).
    pub fn set_footprint(&mut self, footprint: Footprint) {
        self.footprint = footprint;
    }

    /// The vehicle's outline.
    pub const fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// What it may not touch.
    pub const fn obstacles(&self) -> &ObstacleMap {
        &self.obstacles
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        self.obstacles.layout()
    }

    /// Whether the vehicle touches an obstacle at a pose.
    ///
    /// # Errors
    /// A pose that is not finite, or 2^28 cells away.
    pub fn collides(&self, map_from_base: &Se2) -> Result<bool, Error> {
        self.obstacles.collides(&self.footprint, map_from_base)
    }

    /// Whether the vehicle touches an obstacle while it moves at a constant twist for `dt` seconds, both ends included.
    ///
    /// Nothing it touches is missed, however thin; see [`ObstacleMap`] for what may count that it only passes.
    ///
    /// # Errors
    /// A pose or twist that is not finite, a negative `dt`, or more than [`MAX_SAMPLES`](Self::MAX_SAMPLES) samples.
    pub fn collides_along(&self, map_from_base: &Se2, twist: &Twist2, dt: f64) -> Result<bool, Error> {
        self.obstacles.collides_along(&self.footprint, map_from_base, twist, dt)
    }

    /// Whether the vehicle touches an obstacle on the arc of constant twist from one pose to another.
    ///
    /// # Errors
    /// As [`collides_along`](Self::collides_along).
    pub fn collides_between(&self, from: &Se2, to: &Se2) -> Result<bool, Error> {
        self.obstacles.collides_between(&self.footprint, from, to)
    }
}

#[cfg(test)]
mod tests;
