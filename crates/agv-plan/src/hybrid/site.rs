//! The map as a vehicle with an outline sees it: what it may not touch, where its base may be, and what that costs.

use super::params::HybridAStarParams;
use crate::Error;
use crate::grid::{GridParams, GridSpace};
use agv_core::{
    geometry::{Se2, Twist2},
    grid::{
        Cell, CellState, CollisionParams, Components, Connectivity, CornerRule, Costmap, Footprint, Grid, GridLayout,
        ObstacleMap, Revision, cost,
    },
};
use nalgebra::Vector2;
use std::f64::consts::FRAC_1_SQRT_2;

/// A costmap, taken apart for one footprint; what it costs to know is paid once per map.
#[derive(Debug, Clone)]
pub(super) struct Site {
    footprint: Footprint,
    /// Cells that the footprint may not touch: lethal ones, and unknown ones as the parameters say.
    lethal: ObstacleMap,
    /// Cells that the base may not enter, where there are any that do not follow from the lethal ones.
    barred: Option<ObstacleMap>,
    point: Footprint,
    states: Grid<CellState>,
    costs: Grid<u8>,
    /// Coarse cells, passable where some pose in them might be free.
    coarse: GridSpace,
    components: Components,
    /// Cells of the map along the edge of a coarse one.
    block: usize,
    /// Wanted edge of a coarse cell, and the greatest that a step leaves, in metres.
    cell: f64,
    most: f64,
    unknown_is_obstacle: bool,
    seen: Option<Revision>,
    /// Start and goal of the query.
    ends: [Se2; 2],
}

/// How near things may be that count as touched, in cells: on the way, and near start and goal.
const USUAL: f64 = 0.25;
const CLOSE: f64 = 1.0 / 16.0;

/// What is near start and goal, in metres.
const NEAR_END: f64 = 1.0;

/// Distance of the poses that are looked at first, in metres.
const LOOK: f64 = 0.3;

impl Site {
    pub(super) fn new(footprint: Footprint, vehicle: &HybridAStarParams) -> Result<Self, Error> {
        let HybridAStarParams { cell, step, cost_weight, unknown_is_obstacle, .. } = *vehicle;
        let nothing = Grid::filled(GridLayout::new(1, 1, 1.0, Se2::default())?, CellState::Free);
        let params = CollisionParams { unknown_is_obstacle, outside_is_obstacle: true };
        let coarse = GridParams {
            connectivity: Connectivity::Eight,
            // An estimate should not be dearer than the way: what might be free is.
            corner_rule: CornerRule::Free,
            cost_weight,
            ..GridParams::default()
        };
        Ok(Self {
            footprint,
            lethal: ObstacleMap::new(&nothing, params, None)?,
            barred: None,
            point: Footprint::point(),
            costs: Grid::filled(*nothing.layout(), cost::FREE),
            states: nothing,
            coarse: GridSpace::new(coarse)?,
            components: Components::default(),
            block: 1,
            cell,
            most: step / HybridAStarParams::STEP_PER_CELL,
            unknown_is_obstacle,
            seen: None,
            ends: [Se2::default(); 2],
        })
    }

    /// Takes a costmap and says whether it is another one than the last. O(cells) if it is.
    pub(super) fn update(&mut self, costmap: &Costmap) -> Result<bool, Error> {
        let same_place = self.seen.is_some() && self.costs.layout() == costmap.layout();
        if same_place && self.seen.as_ref() == Some(costmap.revision()) {
            return Ok(false);
        }
        let same = same_place && self.costs.values() == costmap.costs();
        if !same {
            self.seen = None;
            self.derive(costmap)?;
        }
        self.seen = Some(costmap.revision().clone());
        Ok(!same)
    }

    fn derive(&mut self, costmap: &Costmap) -> Result<(), Error> {
        let layout = *costmap.layout();
        let state = |value: u8| match value {
            cost::LETHAL => CellState::Occupied,
            cost::UNKNOWN => CellState::Unknown,
            _ => CellState::Free,
        };
        refill(&mut self.states, &layout, costmap.costs().iter().map(|&value| state(value)));
        refill(&mut self.costs, &layout, costmap.costs().iter().copied());
        self.lethal.set_map(&self.states)?;
        // Cells of the inscribed circle follow from the lethal ones only if they were made for this footprint.
        if costmap.costs().contains(&cost::INSCRIBED) || self.footprint.inscribed_radius() == 0.0 {
            let barred = |value: u8| if value == cost::INSCRIBED { CellState::Occupied } else { state(value) };
            refill(&mut self.states, &layout, costmap.costs().iter().map(|&value| barred(value)));
            match &mut self.barred {
                Some(barred) => barred.set_map(&self.states)?,
                None => self.barred = Some(ObstacleMap::new(&self.states, *self.lethal.params(), None)?),
            }
        } else {
            self.barred = None;
        }
        self.derive_coarse(&layout)
    }

    /// A coarse cell is passable if one of its cells is, and costs as much as the cheapest of them.
    fn derive_coarse(&mut self, layout: &GridLayout) -> Result<(), Error> {
        // A hair more: 0.3 m may be 5.999 cells of 0.05 m.
        let most = (self.most / layout.resolution() * (1.0 + 1e-9)).floor();
        self.block = ((self.cell / layout.resolution()).round().min(most) as usize).max(1);
        let (width, height) = (layout.width().div_ceil(self.block), layout.height().div_ceil(self.block));
        let coarse = GridLayout::new(width, height, layout.resolution() * self.block as f64, layout.map_from_grid())?;
        let mut least = vec![cost::LETHAL; coarse.len()];
        let reach = self.footprint.inscribed_radius() - FRAC_1_SQRT_2 * layout.resolution();
        for (y, row) in self.costs.values().chunks_exact(layout.width()).enumerate() {
            let distances = self.lethal.distance().row(y).unwrap_or_default();
            for (x, (&value, &distance)) in row.iter().zip(distances).enumerate() {
                let enters = match value {
                    cost::UNKNOWN => !self.unknown_is_obstacle,
                    cost::INSCRIBED | cost::LETHAL => false,
                    _ => true,
                };
                if enters && f64::from(distance) > reach {
                    let value = if value == cost::UNKNOWN { cost::FREE } else { value };
                    let slot = &mut least[y / self.block * width + x / self.block];
                    *slot = (*slot).min(value);
                }
            }
        }
        self.coarse.update(&Costmap::from_costs(Grid::new(coarse, least)?));
        self.coarse.components_into(&mut self.components);
        Ok(())
    }

    pub(super) const fn layout(&self) -> &GridLayout {
        self.costs.layout()
    }

    pub(super) const fn coarse(&self) -> &GridSpace {
        &self.coarse
    }

    /// Coarse cells side by side and one above the other, and their edge in cells of the map.
    pub(super) fn coarse_size(&self) -> (usize, usize, usize) {
        let layout = self.layout();
        (layout.width().div_ceil(self.block), layout.height().div_ceil(self.block), self.block)
    }

    /// Whether a vehicle that is a circle could go from one coarse cell to another.
    pub(super) fn are_joined(&self, a: u32, b: u32) -> bool {
        let label = |node: u32| self.components.label_at(node as usize);
        label(a).is_some() && label(a) == label(b)
    }

    /// Whether the vehicle can stand at a pose.
    pub(super) fn is_free(&self, pose: &Se2) -> bool {
        let barred = self.barred.as_ref().map(|barred| barred.collides(&self.point, pose));
        barred.is_none_or(|hit| hit == Ok(false)) && self.lethal.collides(&self.footprint, pose) == Ok(false)
    }

    /// Whether the vehicle can drive `length` metres at a twist of 1 m/s. Touches nothing if so, however thin.
    ///
    /// What it passes within a quarter of a cell counts as touched, but not near the ends of the query: there the vehicle
    /// stands as close to things as it was asked to.
    pub(super) fn is_free_along(&self, pose: &Se2, twist: &Twist2, length: f64) -> bool {
        // Most motions that touch something do so at their end, or at one of a few poses on the way.
        let looks = (length / LOOK).ceil().max(1.0);
        if (1..=looks as u32).rev().any(|i| !self.is_free(&(*pose * twist.integrate(length * f64::from(i) / looks)))) {
            return false;
        }
        let passes = |margin: f64| {
            let passes = |obstacles: &ObstacleMap, footprint: &Footprint| {
                obstacles.collides_along_within(footprint, pose, twist, length, margin) == Ok(false)
            };
            self.barred.as_ref().is_none_or(|barred| passes(barred, &self.point))
                && passes(&self.lethal, &self.footprint)
        };
        passes(USUAL) || (self.is_near_end(pose, NEAR_END + length) && passes(CLOSE))
    }

    /// Distance from a point to the nearest thing that may not be touched or the map's edge, in metres: to the centre of its
    /// cell; negative off the map.
    pub(super) fn room_at(&self, point: &Vector2<f64>) -> f64 {
        let layout = self.layout();
        let p = layout.to_grid(point);
        let to_edge = p.x.min(p.y).min(layout.width() as f64 - p.x).min(layout.height() as f64 - p.y);
        let to_obstacle = self.lethal.distance_at(point).map_or(f64::INFINITY, |(distance, _)| distance);
        to_obstacle.min(to_edge * layout.resolution())
    }

    /// Whether a pose is nearer than `reach` metres to the start or the goal.
    pub(super) fn is_near_end(&self, pose: &Se2, reach: f64) -> bool {
        self.ends.iter().any(|end| (pose.translation() - end.translation()).norm() < reach)
    }

    /// Sets the ends of a query.
    pub(super) const fn set_ends(&mut self, ends: [Se2; 2]) {
        self.ends = ends;
    }

    /// Cost of the base's cell, from 0 to 1.
    pub(super) fn cost_at(&self, pose: &Se2) -> f64 {
        let cell: Option<Cell> = self.layout().cell_at(&pose.translation());
        match cell.and_then(|cell| self.costs.get(cell)) {
            Some(&value) if value <= cost::MAX_NON_OBSTACLE => f64::from(value) / f64::from(cost::MAX_NON_OBSTACLE),
            _ => 0.0,
        }
    }
}

/// Fills a grid anew; its memory is used again.
fn refill<T: Copy + Default>(grid: &mut Grid<T>, layout: &GridLayout, values: impl Iterator<Item = T>) {
    if grid.layout() != layout {
        *grid = Grid::filled(*layout, T::default());
    }
    for (slot, value) in grid.values_mut().iter_mut().zip(values) {
        *slot = value;
    }
}
