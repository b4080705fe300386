//! Fields of cylinders like those of the BARN data set, drawn from a seed.
//!
//! D. Perille et al., *Benchmarking Metric Ground Navigation* (SSRR 2020): the cells of a grid are filled at random, a
//! cellular automaton smooths them (a cell with five filled neighbours or more is filled, one with one or none emptied), and each filled
//! cell becomes a cylinder; fields that cannot be crossed are drawn again. Cells whose neighbours are all filled need none.
//!
//! ```text
//!        + goal                  walls at both sides and behind the start
//!   #    .    #
//!   #. ##.   .#   field of 30 by 30 cells of 0.15 m
//!   #  .   ## #
//!   #         #
//!   #    + start
//!   ###########
//! ```

use crate::{Error, Shape};
use agv_core::{
    check,
    compute::{Seed, Stream},
    geometry::Se2,
};
use nalgebra::Vector2;
use rand::RngExt as _;
use std::{cmp::Reverse, collections::BinaryHeap, f64::consts::FRAC_PI_2};

/// Cells of the field along x and along y.
const CELLS: usize = 30;
/// Edge of a cell, in metres.
const PITCH: f64 = 0.15;
/// Cells along which a wall runs from behind the start to the end of the field.
const WALL: usize = 64;
/// Rows of the wall before the field.
const APPROACH: usize = 34;
/// Cells to all sides of a filled one that the middle of a vehicle cannot enter.
const REACH: usize = 2;
/// Fields that are drawn before giving up.
const ATTEMPTS: u64 = 1000;

/// Parameters of a [`Clutter`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClutterParams {
    /// Share of cells that are filled before smoothing; BARN has 0.15 to 0.3.
    pub fill: f64,
    /// Rounds of smoothing; BARN has 2 to 4.
    pub smoothing: usize,
}

impl Default for ClutterParams {
    /// The middle of BARN's range.
    fn default() -> Self {
        Self { fill: 0.2, smoothing: 3 }
    }
}

/// A field of cylinders with a way through it.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_sim::{Clutter, ClutterParams, World2d};
///
/// let clutter = Clutter::generate(ClutterParams::default(), Seed(1))?;
/// let world = World2d::new(clutter.shapes())?;
/// assert!(clutter.way_length() > 10.0 && world.shapes().len() > 100);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Clutter {
    cylinders: Vec<Vector2<f64>>,
    way: Vec<Vector2<f64>>,
}

impl Clutter {
    /// Radius of all cylinders, in metres.
    pub const RADIUS: f64 = 0.075;

    /// Draws a field that can be crossed.
    ///
    /// # Errors
    /// A fill outside of `[0, 1]`, or one at which no field of a thousand can be crossed.
    pub fn generate(params: ClutterParams, seed: Seed) -> Result<Self, Error> {
        check::in_range("fill", params.fill, 0.0, 1.0)?;
        for attempt in 0..ATTEMPTS {
            let mut filled = Field::random(params.fill, &mut seed.stream(attempt, 0));
            for _ in 0..params.smoothing {
                filled = filled.smoothed();
            }
            if let Some(cells) = filled.way() {
                let mut way = vec![Self::start().translation()];
                way.extend(cells.iter().map(|&(x, y)| place(x as f64, (y + APPROACH) as f64)));
                way.push(Self::goal().translation());
                return Ok(Self { cylinders: filled.cylinders(), way });
            }
        }
        Err(agv_core::Error::OutOfRange { name: "fill", value: params.fill, min: 0.0, max: 0.4 }.into())
    }

    /// Where the vehicle starts, facing the field.
    pub fn start() -> Se2 {
        Se2::new(-2.25, 3.0, FRAC_PI_2)
    }

    /// Where it is to go, behind the field.
    pub fn goal() -> Se2 {
        Se2::new(-2.25, 13.0, FRAC_PI_2)
    }

    /// Centres of the cylinders, the walls' ones included, in metres.
    pub fn cylinders(&self) -> &[Vector2<f64>] {
        &self.cylinders
    }

    /// The cylinders as shapes of a world.
    pub fn shapes(&self) -> Vec<Shape> {
        self.cylinders.iter().map(|&center| Shape::Circle { center, radius: Self::RADIUS }).collect()
    }

    /// A shortest way of grid steps from start to goal that keeps two cells from filled ones.
    pub fn way(&self) -> &[Vector2<f64>] {
        &self.way
    }

    /// Length of [`way`](Self::way), in metres: what times are judged by.
    pub fn way_length(&self) -> f64 {
        self.way.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }
}

/// Middle of a cell, counted from the walls' corner.
fn place(x: f64, y: f64) -> Vector2<f64> {
    Vector2::new(-4.425 + PITCH * x, 0.075 + PITCH * y)
}

/// Filled cells, row by row.
#[derive(Clone)]
struct Field(Vec<bool>);

impl Field {
    fn random(fill: f64, stream: &mut Stream) -> Self {
        Self((0..CELLS * CELLS).map(|_| stream.random::<f64>() < fill).collect())
    }

    /// Whether a cell is filled; those beyond the border are not.
    fn is_filled(&self, x: i64, y: i64) -> bool {
        let inside = (0..CELLS as i64).contains(&x) && (0..CELLS as i64).contains(&y);
        inside && self.0.get(y as usize * CELLS + x as usize).copied().unwrap_or(false)
    }

    fn neighbours(&self, x: i64, y: i64) -> usize {
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy)));
        around.filter(|&(dx, dy)| (dx, dy) != (0, 0) && self.is_filled(x + dx, y + dy)).count()
    }

    fn smoothed(&self) -> Self {
        let next = |index: usize| {
            let (x, y) = ((index % CELLS) as i64, (index / CELLS) as i64);
            match self.neighbours(x, y) {
                5.. => true,
                0..=1 => false,
                _ => self.is_filled(x, y),
            }
        };
        Self((0..CELLS * CELLS).map(next).collect())
    }

    /// Whether the middle of a vehicle may be in a cell.
    fn is_open(&self, x: usize, y: usize) -> bool {
        let reach = REACH as i64;
        // The walls take the outermost columns.
        (1 + REACH..CELLS - 1 - REACH).contains(&x)
            && (-reach..=reach).all(|dx| (-reach..=reach).all(|dy| !self.is_filled(x as i64 + dx, y as i64 + dy)))
    }

    /// A shortest way from the first to the last row, by Dijkstra's algorithm in tenths of a cell.
    fn way(&self) -> Option<Vec<(usize, usize)>> {
        let mut cost = vec![u32::MAX; CELLS * CELLS];
        let mut parent = vec![usize::MAX; CELLS * CELLS];
        let mut open = BinaryHeap::new();
        for x in (0..CELLS).filter(|&x| self.is_open(x, 0)) {
            // The start lies before the middle of the field.
            let ahead = (10.0 * (x as f64 - 14.5).hypot(14.5)) as u32;
            cost[x] = ahead;
            open.push(Reverse((ahead, x)));
        }
        while let Some(Reverse((reached, index))) = open.pop() {
            let (x, y) = (index % CELLS, index / CELLS);
            if reached > cost[index] {
                continue;
            }
            if y == CELLS - 1 {
                let mut way = vec![(x, y)];
                let mut at = index;
                while parent[at] != usize::MAX {
                    at = parent[at];
                    way.push((at % CELLS, at / CELLS));
                }
                way.reverse();
                return Some(way);
            }
            for (dx, dy) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1_i64)] {
                let (Some(x), Some(y)) = (x.checked_add_signed(dx as isize), y.checked_add_signed(dy as isize)) else {
                    continue;
                };
                if x >= CELLS || y >= CELLS || !self.is_open(x, y) {
                    continue;
                }
                let (next, step) = (y * CELLS + x, if dx != 0 && dy != 0 { 14 } else { 10 });
                if reached + step < cost[next] {
                    cost[next] = reached + step;
                    parent[next] = index;
                    open.push(Reverse((reached + step, next)));
                }
            }
        }
        None
    }

    /// The walls, and a cylinder for each filled cell that is not hidden among others.
    fn cylinders(&self) -> Vec<Vector2<f64>> {
        let mut cylinders = Vec::new();
        for x in 0..CELLS {
            cylinders.push(place(x as f64, 0.0));
        }
        for y in 1..WALL {
            cylinders.extend([place(0.0, y as f64), place((CELLS - 1) as f64, y as f64)]);
        }
        for (index, _) in self.0.iter().enumerate().filter(|(_, filled)| **filled) {
            let (x, y) = (index % CELLS, index / CELLS);
            let on_wall = x == 0 || x == CELLS - 1;
            if !on_wall && self.neighbours(x as i64, y as i64) < 8 {
                cylinders.push(place(x as f64, (y + APPROACH) as f64));
            }
        }
        cylinders
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Body, PlanarWorld, World2d};

    #[test]
    fn a_vehicle_fits_along_the_way() {
        for seed in 0..20 {
            for (fill, smoothing) in [(0.15, 2), (0.2, 3), (0.3, 4)] {
                let clutter = Clutter::generate(ClutterParams { fill, smoothing }, Seed(seed)).unwrap();
                let world = World2d::new(clutter.shapes()).unwrap();
                // Two cells of room to the middle of a filled one, less its radius.
                let body = Body::circle(0.25).unwrap();
                for pair in clutter.way().windows(2) {
                    for k in 0..=10 {
                        let place = pair[0] + (pair[1] - pair[0]) * (f64::from(k) / 10.0);
                        assert!(!world.touches(&body, &Se2::new(place.x, place.y, 0.0)), "{seed} {place}");
                    }
                }
            }
        }
    }

    #[test]
    fn fields_follow_their_seed() {
        let of = |seed| Clutter::generate(ClutterParams::default(), Seed(seed)).unwrap();
        assert_eq!(of(3), of(3));
        assert_ne!(of(3), of(4));
        for fill in [-0.1, f64::NAN, 1.0] {
            assert!(Clutter::generate(ClutterParams { fill, ..ClutterParams::default() }, Seed(0)).is_err(), "{fill}");
        }
    }
}
