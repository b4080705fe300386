//! A navigation function: how far it is to a target from everywhere near, around obstacles and with room to them.
//!
//! The length `T` of the best way solves the eikonal equation
//!
//! ```text
//! |∇T| = c(d)       c(d) = 1 + k max(0, 1 - (d - r) / m)²      d > r
//! ```
//!
//! with `d` the distance to the nearest obstacle and `r` the vehicle's inscribed radius: within `m` metres beyond it every metre counts
//! for more. It is solved outwards from the target by fast marching (Sethian 1996) with buckets for a queue (Yatziv, Bartesaghi
//! and Sapiro 2006), on cells coarser than the map's, as far as the vehicle needs. Unlike costs of steps from cell to cell it has
//! the right direction everywhere, so that a vehicle can be steered by its slope (the navigation function of Brock and Khatib's global
//! dynamic window, 1999).
//!
//! Cells along the way that was best the last time count for a little less, so that two ways of one length do not take turns.

mod slope;

use crate::Error;
use agv_core::{
    check,
    grid::{Cell, GridLayout, LocalMap},
};
use nalgebra::Vector2;

/// Parameters of a [`NavigationField`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FieldParams {
    /// Edge of its cells, in metres, about: whole cells of the map are put together.
    pub resolution: f64,
    /// `k`: how much dearer a metre is that passes an obstacle closely.
    pub nearness: f64,
    /// `m`: room beyond the inscribed radius from which on obstacles do not matter, in metres.
    pub room: f64,
    /// Share by which the way of the last cycle is cheaper, from 0 to below 1.
    pub loyalty: f64,
}

impl Default for FieldParams {
    /// Cells of a decimetre, four times the price next to an obstacle, 0.4 m of room, and a fifth off for the last way.
    fn default() -> Self {
        Self { resolution: 0.1, nearness: 3.0, room: 0.4, loyalty: 0.2 }
    }
}

/// Distances to a target, in metres that are weighed by nearness to obstacles.
#[derive(Debug, Clone)]
pub struct NavigationField {
    params: FieldParams,
    layout: Option<GridLayout>,
    /// Price of a metre, by cell; infinite where the vehicle's origin cannot be.
    prices: Vec<f32>,
    /// Cells along the way that was best.
    cheaper: Vec<bool>,
    values: Vec<f32>,
    open: Vec<Vec<(u32, f32)>>,
    /// The way that was best, in the map.
    way: Vec<Vector2<f64>>,
    target: Vector2<f64>,
}

/// Buckets per edge of a cell at the least price.
const PER_CELL: f32 = 2.0;

/// How much room may be missing, in cells of the map: its cells claim more than the obstacles in them have, and whether the vehicle fits is
/// decided by trajectories.
const SLACK: f32 = 0.5;

impl NavigationField {
    /// A field without cells.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: FieldParams) -> Result<Self, Error> {
        check::positive("resolution", params.resolution)?;
        check::in_range("nearness", params.nearness, 0.0, 100.0)?;
        check::positive("room", params.room)?;
        check::in_range("loyalty", params.loyalty, 0.0, 0.9)?;
        Ok(Self {
            params,
            layout: None,
            prices: Vec::new(),
            cheaper: Vec::new(),
            values: Vec::new(),
            open: Vec::new(),
            way: Vec::new(),
            target: Vector2::new(0.0, 0.0),
        })
    }

    /// Forgets the way of the last cycle.
    pub fn forget(&mut self) {
        self.way.clear();
    }

    /// The way along which the field falls fastest from where the vehicle was at the last update, in the map frame.
    pub fn way(&self) -> &[Vector2<f64>] {
        &self.way
    }

    /// Where it leads, in the map frame.
    pub const fn target(&self) -> &Vector2<f64> {
        &self.target
    }

    /// Takes the room that the map leaves for a vehicle of this inscribed radius, in metres. O(cells).
    pub fn set_map(&mut self, map: &LocalMap, inscribed_radius: f64) {
        let fine = map.layout();
        let factor = ((self.params.resolution / fine.resolution()).round() as usize).max(1);
        let (width, height) = ((fine.width() / factor).max(1), (fine.height() / factor).max(1));
        let resolution = fine.resolution() * factor as f64;
        let Ok(layout) = GridLayout::new(width, height, resolution, fine.map_from_grid()) else { return };
        self.layout = Some(layout);
        self.prices.resize(width * height, f32::INFINITY);
        let distance = map.obstacles().distance().values();
        let half = 0.5 * fine.resolution() as f32;
        let (radius, per_room) = (inscribed_radius as f32, 1.0 / self.params.room as f32);
        let nearness = self.params.nearness as f32;
        // The best of the map's cells that make one up, so that no gap is lost between them.
        let slack = SLACK * fine.resolution() as f32;
        for (y, row) in self.prices.chunks_exact_mut(width).enumerate() {
            row.fill(f32::NEG_INFINITY);
            for line in distance.chunks_exact(fine.width()).skip(y * factor).take(factor) {
                for (widest, cells) in row.iter_mut().zip(line.chunks_exact(factor)) {
                    *widest = cells.iter().fold(*widest, |widest, &d| widest.max(d));
                }
            }
            for price in row {
                let room = *price - half - radius;
                let near = (1.0 - room * per_room).clamp(0.0, 1.0);
                *price = if room > -slack { 1.0 + nearness * near * near } else { f32::INFINITY };
            }
        }
        let discount = (1.0 - self.params.loyalty) as f32;
        self.cheaper.clear();
        self.cheaper.resize(width * height, false);
        for cell in self.way.iter().filter_map(|point| layout.cell_at(point)) {
            for (dx, dy) in (-2..=2).flat_map(|dx| (-2..=2).map(move |dy| (dx, dy))) {
                let Some(index) = layout.index(Cell::new(cell.x + dx, cell.y + dy)) else { continue };
                if !std::mem::replace(&mut self.cheaper[index], true) {
                    self.prices[index] *= discount;
                }
            }
        }
    }

    /// Edge of a cell, in metres, once there is a map: a multiple of that of the map's cells.
    pub(crate) fn resolution(&self) -> Option<f64> {
        self.layout.as_ref().map(GridLayout::resolution)
    }

    /// Whether the vehicle's origin may be at a point of the map.
    pub fn is_open(&self, point: &Vector2<f64>) -> bool {
        let cell = self.layout.as_ref().and_then(|layout| layout.index(layout.cell_at(point)?));
        cell.and_then(|cell| self.prices.get(cell)).is_some_and(|price| price.is_finite())
    }

    /// Computes the distances to `target` as far as from `vehicle`, and `beyond` metres more; says whether there is a way.
    pub fn compute(&mut self, target: &Vector2<f64>, vehicle: &Vector2<f64>, beyond: f64) -> bool {
        let Some(layout) = self.layout else { return false };
        self.values.clear();
        self.values.resize(layout.len(), f32::INFINITY);
        self.target = *target;
        let edge = layout.resolution() as f32;
        let least = (1.0 - self.params.loyalty) as f32;
        let width = edge / PER_CELL * least;
        let most = edge * (1.0 + self.params.nearness as f32);
        // A step leads a cell ahead; the cells that the front begins with are up to 1.5 √2 of one from the target.
        let buckets = (most * 2.2 / width).ceil() as usize + 3;
        self.open.resize_with(buckets, Vec::new);
        self.open.iter_mut().for_each(Vec::clear);
        let Some(center) = layout.cell_at(target) else { return false };
        // Around the target distances are as the crow flies, so that the front begins round.
        for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
            let cell = Cell::new(center.x + dx, center.y + dy);
            let Some(index) = layout.index(cell) else { continue };
            let price = self.prices.get(index).copied().unwrap_or(f32::INFINITY);
            if price.is_finite() {
                let value = price * (layout.center(cell) - target).norm() as f32;
                self.values[index] = value;
                let bucket = ((value / width) as usize).min(buckets - 1);
                self.open[bucket].push((index as u32, value));
            }
        }
        let start = layout.cell_at(vehicle);
        let columns = layout.width();
        let (mut slot, mut round, mut empty) = (0_usize, 0_usize, 0);
        let mut limit = f32::INFINITY;
        while empty < buckets {
            let mut current = std::mem::take(&mut self.open[slot]);
            empty = if current.is_empty() { empty + 1 } else { 0 };
            let mut next = 0;
            while let Some(&(index, value)) = current.get(next) {
                next += 1;
                let index = index as usize;
                if self.values[index] != value {
                    continue;
                }
                let (x, y) = (index % columns, index / columns);
                let neighbours = [
                    (x > 0).then(|| index - 1),
                    (x + 1 < columns).then_some(index + 1),
                    (y > 0).then(|| index - columns),
                    (y + 1 < layout.height()).then_some(index + columns),
                ];
                for near in neighbours.into_iter().flatten() {
                    let price = self.prices[near];
                    if !price.is_finite() || self.values[near] <= value {
                        continue;
                    }
                    let reached = self.solve(near, columns, layout.height(), edge * price);
                    if reached < self.values[near] - 1e-5 {
                        self.values[near] = reached;
                        let place = ((reached / width) as usize).max(round);
                        if place == round {
                            current.push((near as u32, reached));
                        } else {
                            self.open[place % buckets].push((near as u32, reached));
                        }
                    }
                }
            }
            current.clear();
            self.open[slot] = current;
            round += 1;
            slot = round % buckets;
            if limit == f32::INFINITY
                && let Some(value) = start.and_then(|cell| self.near_value(&layout, cell))
            {
                limit = value + beyond as f32;
            }
            if round as f32 * width > limit {
                break;
            }
        }
        limit < f32::INFINITY
    }

    /// The least value in the cell or next to it.
    fn near_value(&self, layout: &GridLayout, cell: Cell) -> Option<f32> {
        let own = layout.index(cell).map_or(f32::INFINITY, |i| self.values[i]);
        if own.is_finite() {
            return Some(own);
        }
        if layout.index(cell).is_some_and(|i| self.prices[i].is_finite()) {
            return None;
        }
        let around = (-2..=2).flat_map(|dx| (-2..=2).map(move |dy| Cell::new(cell.x + dx, cell.y + dy)));
        let least = around.filter_map(|cell| layout.index(cell)).map(|i| self.values[i]).fold(f32::INFINITY, f32::min);
        least.is_finite().then_some(least)
    }

    /// Godunov's upwind solution at a cell.
    fn solve(&self, index: usize, columns: usize, rows: usize, step: f32) -> f32 {
        let (x, y) = (index % columns, index / columns);
        let at = |inside: bool, i: usize| if inside { self.values[i] } else { f32::INFINITY };
        let a = at(x > 0, index.wrapping_sub(1)).min(at(x + 1 < columns, index + 1));
        let b = at(y > 0, index.wrapping_sub(columns)).min(at(y + 1 < rows, index + columns));
        let (low, high) = (a.min(b), a.max(b));
        if high - low >= step {
            return low + step;
        }
        let difference = high - low;
        0.5 * (low + high + (2.0 * step * step - difference * difference).sqrt())
    }
}

#[cfg(test)]
mod tests;
