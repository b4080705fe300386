//! What a vehicle may not touch in a map, as a mask and a distance field, and whether an outline does.
//!
//! A pose collides if the footprint has a point in common with an obstacle's cell, the cell's edges included. Two
//! circles decide many poses by one look at the distance field, and those that cover a long outline most others: with `d`
//! from centre to centre of the cells, of edge `e`, obstacles are no nearer to a point than `d - √2 e`, and one has its
//! centre within `d + e/√2`.
//!
//! On the way, no point of the footprint is faster than `|v| + |ω| R`, `R` being the circumscribed radius. If in the middle
//! of a motion the footprint is free, grown by how far a point goes until the motion's end, all of it is; if not, either
//! half is looked at, until the growth is no more than a margin: whatever the vehicle touches at any time is found, however
//! thin. The price is that obstacles that it passes within the margin, a quarter of a cell, may count too.

use super::CollisionParams;
use crate::{
    Error, check,
    compute::Par,
    geometry::{LieGroup, Se2, Twist2},
    grid::{Cell, CellState, DistanceParams, DistanceTransform, Footprint, Grid, GridLayout},
};
use nalgebra::Vector2;
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

/// The obstacles of a map: which cells are blocked, and how far the nearest is.
///
/// Queries read only and do not allocate, so that planners on several threads may share one map, for vehicles of any outline.
/// A motion that passes an obstacle within a quarter of a cell may count as one that touches it.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, CollisionParams, Footprint, Grid, GridLayout, ObstacleMap};
/// use agv_core::nalgebra::Vector2;
///
/// let mut map = Grid::filled(GridLayout::new(200, 100, 0.05, Se2::default())?, CellState::Free);
/// map.set(Cell::new(100, 50), CellState::Occupied);
/// let obstacles = ObstacleMap::new(&map, CollisionParams::default(), None)?;
/// let (distance, gradient) = obstacles.distance_at(&Vector2::new(4.0, 2.525)).unwrap();
/// assert!((distance - 1.025).abs() < 1e-6 && gradient.x < -0.99); // nearer with every step ahead
/// assert!(obstacles.collides(&Footprint::circle(1.1)?, &Se2::new(4.0, 2.5, 0.0))?);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ObstacleMap {
    params: CollisionParams,
    blocked: Grid<bool>,
    transform: DistanceTransform,
    distance: Grid<f32>,
    /// Distance from which on the field does not tell more.
    cut_off: f32,
}

/// Growth of the footprint in the shortest stretches of a motion, in cells.
pub(super) const MARGIN: f64 = 0.25;

/// Clearance of the circle around a vehicle, in cells, that is enough not to look closer.
const FAR: f64 = 4.0;

impl ObstacleMap {
    /// Most samples of one motion.
    pub const MAX_SAMPLES: usize = 1 << 20;

    /// The obstacles of a map; distances greater than `max_distance` metres are reported as that.
    ///
    /// # Errors
    /// A map that is too long for a [`DistanceTransform`], or a `max_distance` that is not finite and positive.
    pub fn new(map: &Grid<CellState>, params: CollisionParams, max_distance: Option<f64>) -> Result<Self, Error> {
        let rule = DistanceParams { unknown_is_obstacle: params.unknown_is_obstacle, max_distance };
        let mut obstacles = Self {
            params,
            blocked: Grid::filled(*map.layout(), false),
            transform: DistanceTransform::new(rule)?,
            distance: Grid::filled(*map.layout(), 0.0),
            cut_off: max_distance.map_or(f32::INFINITY, |d| d as f32),
        };
        obstacles.set_map(map)?;
        Ok(obstacles)
    }

    /// The same obstacles, found on several threads when another map is taken.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.transform = self.transform.with_parallelism(par);
        self
    }

    /// Takes another map; memory is used again. O(cells).
    ///
    /// # Errors
    /// A map that is too long for a [`DistanceTransform`]; the obstacles then stay.
    pub fn set_map(&mut self, map: &Grid<CellState>) -> Result<(), Error> {
        self.transform.compute_into(map, &mut self.distance)?;
        self.blocked.reshape(*map.layout(), false);
        let unknown_is_obstacle = self.params.unknown_is_obstacle;
        for (blocked, &state) in self.blocked.values_mut().iter_mut().zip(map.values()) {
            *blocked = state == CellState::Occupied || (state == CellState::Unknown && unknown_is_obstacle);
        }
        Ok(())
    }

    /// What counts as an obstacle.
    pub const fn params(&self) -> &CollisionParams {
        &self.params
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        self.blocked.layout()
    }

    /// Which cells are obstacles.
    pub const fn blocked(&self) -> &Grid<bool> {
        &self.blocked
    }

    /// Distance of each cell to the nearest obstacle, centre to centre, in metres.
    pub const fn distance(&self) -> &Grid<f32> {
        &self.distance
    }

    /// Distance from a map point to the nearest obstacle's centre, in metres, interpolated, and its gradient in the map frame
    /// (metres per metre). O(1).
    ///
    /// An obstacle's edge is up to `1/√2` cell nearer than its centre. None off the map, and without any obstacle where no
    /// greatest distance is set.
    #[inline]
    pub fn distance_at(&self, point: &Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        self.distance.interpolate(point).map(|(distance, gradient)| (f64::from(distance), gradient.cast()))
    }

    /// Whether the vehicle touches an obstacle at a pose.
    ///
    /// # Errors
    /// A pose that is not finite, or 2^28 cells away.
    pub fn collides(&self, footprint: &Footprint, map_from_base: &Se2) -> Result<bool, Error> {
        self.check_pose(map_from_base)?;
        Ok(self.touches(footprint, map_from_base, 0.0))
    }

    /// As [`collides`](Self::collides), of the footprint grown by `margin` cells.
    ///
    /// # Errors
    /// As [`collides`](Self::collides), and a margin that is negative or not finite.
    pub fn collides_within(&self, footprint: &Footprint, map_from_base: &Se2, margin: f64) -> Result<bool, Error> {
        self.check_pose(map_from_base)?;
        let margin = check::non_negative("margin", margin)?;
        Ok(self.touches(footprint, map_from_base, margin))
    }

    /// Whether the vehicle touches an obstacle while it moves at a constant twist for `dt` seconds, both ends included.
    ///
    /// Nothing it touches is missed, however thin; see the module's head for what may count that it only passes.
    ///
    /// # Errors
    /// A pose or twist that is not finite, a negative `dt`, or more than [`MAX_SAMPLES`](Self::MAX_SAMPLES) samples.
    pub fn collides_along(
        &self,
        footprint: &Footprint,
        map_from_base: &Se2,
        twist: &Twist2,
        dt: f64,
    ) -> Result<bool, Error> {
        self.collides_along_within(footprint, map_from_base, twist, dt, MARGIN)
    }

    /// As [`collides_along`](Self::collides_along), but only obstacles that the vehicle passes within `margin` cells may count as
    /// touched, instead of a quarter of one. Near obstacles the time goes with `1 / margin`.
    ///
    /// # Errors
    /// As [`collides_along`](Self::collides_along), and a margin outside [1/256, 1].
    pub fn collides_along_within(
        &self,
        footprint: &Footprint,
        map_from_base: &Se2,
        twist: &Twist2,
        dt: f64,
        margin: f64,
    ) -> Result<bool, Error> {
        self.check_pose(map_from_base)?;
        let growth = check::in_range("margin", margin, 1.0 / 256.0, 1.0)?;
        check::all_finite("twist", &[twist.vx, twist.vy, twist.yaw_rate])?;
        check::non_negative("dt", dt)?;
        let resolution = self.layout().resolution();
        let speed = twist.speed() + twist.yaw_rate.abs() * footprint.circumscribed_radius();
        // How far a point goes at the most, in cells, and into how many stretches that is cut at the most: halves of halves.
        let travel = speed * dt / resolution;
        check::in_range("samples of the motion", (travel / (2.0 * growth)).ceil(), 0.0, Self::MAX_SAMPLES as f64)?;
        let (mut levels, mut finest) = (0, 0.5 * travel);
        while finest > growth {
            (levels, finest) = (levels + 1, 0.5 * finest);
        }
        let motion = Motion { obstacles: self, footprint, start: *map_from_base, twist, finest };
        Ok(motion.touches(0.5 * dt, 0.5 * dt, levels))
    }

    /// Whether the vehicle touches an obstacle on the arc of constant twist from one pose to another.
    ///
    /// # Errors
    /// As [`collides_along`](Self::collides_along).
    pub fn collides_between(&self, footprint: &Footprint, from: &Se2, to: &Se2) -> Result<bool, Error> {
        self.check_pose(to)?;
        self.collides_along(footprint, from, &Twist2::from(to.minus(from)), 1.0)
    }

    fn check_pose(&self, pose: &Se2) -> Result<(), Error> {
        check::all_finite("map_from_base", &[pose.x(), pose.y(), pose.yaw()])?;
        let far = self.layout().to_grid(&pose.translation()).amax();
        check::in_range("map_from_base (cells)", far, 0.0, f64::from(1 << 28)).map(|_| ())
    }

    /// Least distance, in metres, from the vehicle to anything that it may not touch; a lower bound, negative if nothing is
    /// known: from the circle around it, or where that is not clear from the circles that cover it.
    fn clearance(&self, footprint: &Footprint, pose: &Se2) -> f64 {
        let whole = self.room_at(&pose.translation()) - footprint.circumscribed_radius();
        let cover = footprint.cover();
        if cover.is_empty() || whole > FAR * self.layout().resolution() {
            return whole;
        }
        let part = |(center, radius): &(Vector2<f64>, f64)| self.room_at(&(*pose * *center)) - radius;
        cover.iter().map(part).fold(f64::INFINITY, f64::min).max(whole)
    }

    /// Least distance, in metres, from a point to anything that the vehicle may not touch; a lower bound.
    #[inline]
    fn room_at(&self, point: &Vector2<f64>) -> f64 {
        let layout = self.layout();
        let resolution = layout.resolution();
        let p = layout.to_grid(point);
        let (width, height) = (layout.width() as f64, layout.height() as f64);
        // Distance to the map's edge, in cells: positive inside.
        let to_edge = p.x.min(p.y).min(width - p.x).min(height - p.y);
        let cell = Cell::new(p.x.floor() as i32, p.y.floor() as i32);
        match self.distance.get(cell) {
            Some(&d) => {
                let inside = f64::from(d) * (1.0 - 1e-6) - SQRT_2 * resolution;
                if self.params.outside_is_obstacle { inside.min(to_edge * resolution) } else { inside }
            }
            None if self.params.outside_is_obstacle => 0.0,
            None => -to_edge * resolution,
        }
    }

    pub(super) fn touches(&self, footprint: &Footprint, pose: &Se2, margin: f64) -> bool {
        self.clearance(footprint, pose) <= margin * self.layout().resolution() * SQRT_2
            && self.touches_closely(footprint, pose, margin)
    }

    /// As `touches`, for poses whose clearance does not tell.
    fn touches_closely(&self, footprint: &Footprint, pose: &Se2, margin: f64) -> bool {
        let layout = self.blocked.layout();
        let resolution = layout.resolution();
        let distance = layout.cell_at(&pose.translation()).and_then(|cell| self.distance.get(cell));
        // A distance that was cut off says nothing of obstacles near.
        if distance.is_some_and(|&d| {
            d < self.cut_off && f64::from(d) * (1.0 + 1e-6) + FRAC_1_SQRT_2 * resolution < footprint.inscribed_radius()
        }) {
            return true;
        }
        let (width, height) = (layout.width() as i32, layout.height() as i32);
        let outside = self.params.outside_is_obstacle;
        let blocked = &self.blocked;
        footprint.any_run(layout, pose, margin, |row, first, last| {
            let inside = row >= 0 && row < height && last >= 0 && first < width;
            if outside && !(inside && first >= 0 && last < width) {
                return true;
            }
            let (first, last) = (first.max(0), last.min(width - 1));
            inside
                && layout.index(Cell::new(first, row)).is_some_and(|start| {
                    // `first` and `last` lie in one row of the grid.
                    blocked.values()[start..=start + (last - first) as usize].contains(&true)
                })
        })
    }
}

/// A motion that is looked at.
struct Motion<'a> {
    obstacles: &'a ObstacleMap,
    footprint: &'a Footprint,
    start: Se2,
    twist: &'a Twist2,
    /// Farthest that a point goes in half of the shortest stretch, in cells.
    finest: f64,
}

impl Motion<'_> {
    /// Whether the stretch from `half` seconds before `middle` to as much after touches anything; it is halved `levels` times
    /// at the most.
    ///
    /// No point of the vehicle is farther from where it is in the middle than the motion of half a stretch: if the footprint, grown
    /// by that, is free in the middle, all of the stretch is.
    fn touches(&self, middle: f64, half: f64, levels: u32) -> bool {
        let pose = self.start.compose(&self.twist.integrate(middle));
        let (obstacles, growth) = (self.obstacles, f64::from(levels).exp2() * self.finest);
        let resolution = obstacles.layout().resolution();
        // Distance as the crow flies; the grown footprint, whose corners are square, reaches farther than points go.
        let clearance = obstacles.clearance(self.footprint, &pose);
        if clearance > growth * resolution {
            return false;
        }
        if levels == 0 {
            return obstacles.touches_closely(self.footprint, &pose, growth);
        }
        if growth <= LOOK_GROWN && !obstacles.touches_closely(self.footprint, &pose, growth) {
            return false;
        }
        // Where the vehicle touches something as it is, no halving helps.
        if growth > LOOK_AS_IT_IS && clearance <= 0.0 && obstacles.touches_closely(self.footprint, &pose, 0.0) {
            return true;
        }
        let quarter = 0.5 * half;
        self.touches(middle - quarter, quarter, levels - 1) || self.touches(middle + quarter, quarter, levels - 1)
    }
}

/// Growths, in cells, up to which the grown footprint is looked at closely before a stretch is halved, and from which on the
/// footprint as it is: in between, halving costs less than a look. (Counted in instructions, on motions of 0.6 and 1.5 m.)
const LOOK_GROWN: f64 = 1.0;
const LOOK_AS_IT_IS: f64 = 4.0;
