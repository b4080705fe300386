//! Does the vehicle touch an obstacle, standing or on the way?
//!
//! A pose collides if the footprint has a point in common with an obstacle's cell, the cell's edges included. Two
//! circles decide most poses by one look at the distance field: with `d` from centre to centre of the cells, of edge
//! `e`, obstacles are no nearer to the origin than `d - √2 e`, and one has its centre within `d + e/√2`.
//!
//! On the way, no point of the footprint is faster than `|v| + |ω| R`, `R` being the circumscribed radius. A motion is
//! cut so that between two samples no point moves farther than twice a margin, and at each sample the footprint grown
//! by the margin is checked: whatever it touches at any time in between, it is found, however thin. The price is that
//! obstacles that it passes within the margin, a quarter of a cell, may count too.

use super::{Cell, CellState, DistanceParams, DistanceTransform, Footprint, Grid, GridLayout};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2, Twist2},
};
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

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
    params: CollisionParams,
    blocked: Grid<bool>,
    transform: DistanceTransform,
    distance: Grid<f32>,
}

/// Growth of the footprint between samples of a motion, in cells.
const MARGIN: f64 = 0.25;

impl CollisionChecker {
    /// Most samples of one motion.
    pub const MAX_SAMPLES: usize = 1 << 20;

    /// A checker for a map.
    ///
    /// # Errors
    /// A map that is too long for a [`DistanceTransform`].
    pub fn new(map: &Grid<CellState>, footprint: Footprint, params: CollisionParams) -> Result<Self, Error> {
        let rule = DistanceParams { unknown_is_obstacle: params.unknown_is_obstacle, max_distance: None };
        let mut checker = Self {
            footprint,
            params,
            blocked: Grid::filled(*map.layout(), false),
            transform: DistanceTransform::new(rule)?,
            distance: Grid::filled(*map.layout(), 0.0),
        };
        checker.set_map(map)?;
        Ok(checker)
    }

    /// Takes another map; memory is used again. O(cells).
    ///
    /// # Errors
    /// As [`new`](Self::new); the checker then keeps the map it has.
    pub fn set_map(&mut self, map: &Grid<CellState>) -> Result<(), Error> {
        self.transform.compute_into(map, &mut self.distance)?;
        self.blocked.reshape(*map.layout(), false);
        let unknown_is_obstacle = self.params.unknown_is_obstacle;
        for (blocked, &state) in self.blocked.values_mut().iter_mut().zip(map.values()) {
            *blocked = state == CellState::Occupied || (state == CellState::Unknown && unknown_is_obstacle);
        }
        Ok(())
    }

    /// Takes another outline, as when a load is taken up; the map stays. O(1).
    pub fn set_footprint(&mut self, footprint: Footprint) {
        self.footprint = footprint;
    }

    /// The vehicle's outline.
    pub const fn footprint(&self) -> &Footprint {
        &self.footprint
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        self.blocked.layout()
    }

    /// Whether the vehicle touches an obstacle at a pose.
    ///
    /// # Errors
    /// A pose that is not finite, or 2^28 cells away.
    pub fn collides(&self, map_from_base: &Se2) -> Result<bool, Error> {
        self.check_pose(map_from_base)?;
        Ok(self.touches(map_from_base, 0.0))
    }

    /// Whether the vehicle touches an obstacle while it moves at a constant twist for `dt` seconds, both ends included.
    ///
    /// Nothing it touches is missed, however thin; see the module's head for what may count that it only passes.
    ///
    /// # Errors
    /// A pose or twist that is not finite, a negative `dt`, or more than [`MAX_SAMPLES`](Self::MAX_SAMPLES) samples.
    pub fn collides_along(&self, map_from_base: &Se2, twist: &Twist2, dt: f64) -> Result<bool, Error> {
        self.check_pose(map_from_base)?;
        check::all_finite("twist", &[twist.vx, twist.vy, twist.yaw_rate])?;
        check::non_negative("dt", dt)?;
        let resolution = self.layout().resolution();
        let speed = twist.speed() + twist.yaw_rate.abs() * self.footprint.circumscribed_radius();
        let margin = MARGIN * resolution;
        let samples = (speed * dt / (2.0 * margin)).ceil();
        check::in_range("samples of the motion", samples, 0.0, Self::MAX_SAMPLES as f64)?;
        if samples == 0.0 {
            return Ok(self.touches(map_from_base, 0.0));
        }
        // A sample stands for the time of one step around it: half a step is a margin of motion.
        let step = dt / samples;
        let mut time = 0.5 * step;
        while time < dt {
            let pose = map_from_base.compose(&twist.integrate(time));
            // Free for as long as no point can cross the clearance, which is at least half a step, before and after.
            let clearance = self.clearance(&pose);
            if clearance > margin {
                time += clearance / speed + 0.5 * step;
                continue;
            }
            if self.touches(&pose, MARGIN) {
                return Ok(true);
            }
            time += step;
        }
        // The last step may have ended short of the end.
        let end = map_from_base.compose(&twist.integrate(dt));
        Ok(self.touches(&end, MARGIN))
    }

    /// Whether the vehicle touches an obstacle on the arc of constant twist from one pose to another.
    ///
    /// # Errors
    /// As [`collides_along`](Self::collides_along).
    pub fn collides_between(&self, from: &Se2, to: &Se2) -> Result<bool, Error> {
        self.check_pose(to)?;
        self.collides_along(from, &Twist2::from(to.minus(from)), 1.0)
    }

    fn check_pose(&self, pose: &Se2) -> Result<(), Error> {
        check::all_finite("map_from_base", &[pose.x(), pose.y(), pose.yaw()])?;
        let far = self.layout().to_grid(&pose.translation()).amax();
        check::in_range("map_from_base (cells)", far, 0.0, f64::from(1 << 28)).map(|_| ())
    }

    /// Least distance, in metres, from the circumscribed circle to anything that the vehicle may not touch; a lower
    /// bound, negative if nothing is known.
    fn clearance(&self, pose: &Se2) -> f64 {
        let layout = self.layout();
        let resolution = layout.resolution();
        let p = layout.to_grid(&pose.translation());
        let (width, height) = (layout.width() as f64, layout.height() as f64);
        // Distance to the map's edge, in cells: positive inside.
        let to_edge = p.x.min(p.y).min(width - p.x).min(height - p.y);
        let to_obstacle = match layout.cell_at(&pose.translation()).and_then(|cell| self.distance.get(cell)) {
            Some(&d) => {
                let inside = f64::from(d) * (1.0 - 1e-6) - SQRT_2 * resolution;
                if self.params.outside_is_obstacle { inside.min(to_edge * resolution) } else { inside }
            }
            None if self.params.outside_is_obstacle => 0.0,
            None => -to_edge * resolution,
        };
        to_obstacle - self.footprint.circumscribed_radius()
    }

    fn touches(&self, pose: &Se2, margin: f64) -> bool {
        let layout = self.blocked.layout();
        let resolution = layout.resolution();
        if self.clearance(pose) > margin * resolution * SQRT_2 {
            return false;
        }
        let distance = layout.cell_at(&pose.translation()).and_then(|cell| self.distance.get(cell));
        if distance.is_some_and(|&d| {
            f64::from(d) * (1.0 + 1e-6) + FRAC_1_SQRT_2 * resolution < self.footprint.inscribed_radius()
        }) {
            return true;
        }
        let (width, height) = (layout.width() as i32, layout.height() as i32);
        let outside = self.params.outside_is_obstacle;
        let blocked = &self.blocked;
        self.footprint.any_run(layout, pose, margin, |row, first, last| {
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

#[cfg(test)]
mod tests {
    use super::{super::footprint::edges, *};
    use nalgebra::Vector2;
    use proptest::prelude::*;

    const RESOLUTION: f64 = 0.05;

    fn any_map() -> impl Strategy<Value = Grid<CellState>> {
        let cell = prop_oneof![150 => Just(CellState::Free), 1 => Just(CellState::Occupied)];
        (prop::collection::vec(cell, 60 * 50), -3.0..3.0_f64).prop_map(|(states, yaw)| {
            Grid::new(GridLayout::new(60, 50, RESOLUTION, Se2::new(-0.3, 0.2, yaw)).unwrap(), states).unwrap()
        })
    }

    fn any_footprint() -> impl Strategy<Value = Footprint> {
        let l_shape = [(-0.3, -0.2), (0.4, -0.2), (0.4, 0.0), (0.0, 0.05), (-0.05, 0.3), (-0.3, 0.3)];
        let triangle = [(-0.1, 0.0), (0.5, -0.03), (0.5, 0.03)];
        prop_oneof![
            (0.01..0.6_f64).prop_map(|r| Footprint::circle(r).unwrap()),
            (0.02..0.6_f64, 0.02..0.5_f64).prop_map(|(l, w)| Footprint::rectangle(-0.3 * l, l, w).unwrap()),
            Just(Footprint::polygon(l_shape.map(|(x, y)| Vector2::new(x, y)).into()).unwrap()),
            Just(Footprint::polygon(triangle.map(|(x, y)| Vector2::new(x, y)).into()).unwrap()),
        ]
    }

    /// A pose, given in cells of the map.
    fn pose_in(map: &Grid<CellState>, x: f64, y: f64, yaw: f64) -> Se2 {
        map.layout().map_from_grid().compose(&Se2::new(x * RESOLUTION, y * RESOLUTION, yaw))
    }

    /// Whether a dense sample of the footprint's points, shrunk or grown by a factor, falls into an obstacle.
    fn sampled(map: &Grid<CellState>, footprint: &Footprint, pose: &Se2, outside: bool) -> bool {
        let r = footprint.circumscribed_radius();
        let steps = (2.0 * r / (0.2 * RESOLUTION)).ceil() as i32;
        (0..=steps).any(|i| {
            (0..=steps).any(|j| {
                let at = |k: i32| -r + 2.0 * r * f64::from(k) / f64::from(steps);
                let p = Vector2::new(at(i), at(j));
                footprint.contains(&p)
                    && match map.layout().cell_at(&(*pose * p)).and_then(|c| map.get(c)) {
                        Some(state) => *state == CellState::Occupied,
                        None => outside,
                    }
            })
        })
    }

    /// Whether any point of an obstacle cell, grown by `margin` metres, lies in the footprint, by sampling the cells, and
    /// the outline too: the tip of a needle lies between the samples of a cell.
    fn near(map: &Grid<CellState>, footprint: &Footprint, pose: &Se2, margin: f64, outside: bool) -> bool {
        let base_from_map = pose.inverse();
        let half = 0.5 * RESOLUTION + margin;
        let layout = map.layout();
        let span = 12;
        let cell_meets = |c: Cell| {
            let center = Vector2::new(f64::from(c.x) + 0.5, f64::from(c.y) + 0.5) * RESOLUTION;
            (0..=span).any(|i| {
                (0..=span).any(|j| {
                    let offset = |k: i32| half * (2.0 * f64::from(k) / f64::from(span) - 1.0);
                    let p = layout.map_from_grid() * (center + Vector2::new(offset(i), offset(j)));
                    footprint.contains(&(base_from_map * p))
                })
            })
        };
        let outline = footprint.vertices().unwrap_or_default();
        let on_outline =
            edges(outline).flat_map(|(a, b)| (0..=2000).map(move |k| a + (b - a) * (f64::from(k) / 2000.0)));
        let tip_meets = |p: Vector2<f64>| {
            let p = layout.to_grid(&(*pose * p));
            let reach = margin / RESOLUTION;
            (-1..=1).any(|i| {
                (-1..=1).any(|j| {
                    let near = Vector2::new(p.x + reach * f64::from(i), p.y + reach * f64::from(j));
                    let cell = Cell::new(near.x.floor() as i32, near.y.floor() as i32);
                    map.get(cell).map_or(outside, |s| *s == CellState::Occupied)
                })
            })
        };
        if on_outline.into_iter().any(tip_meets) {
            return true;
        }
        let (w, h) = (layout.width() as i32, layout.height() as i32);
        let border = 30;
        (-border..w + border).any(|x| {
            (-border..h + border).any(|y| {
                let c = Cell::new(x, y);
                let blocked = map.get(c).map_or(outside, |s| *s == CellState::Occupied);
                let reach = footprint.circumscribed_radius() + 2.0 * RESOLUTION + margin;
                blocked && (layout.center(c) - pose.translation()).norm() < reach && cell_meets(c)
            })
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]

        /// What a dense sample of the footprint finds is found; what is found lies within a hair of the footprint.
        #[test]
        fn poses_agree_with_sampling(
            map in any_map(), footprint in any_footprint(), x in -5.0..65.0_f64, y in -5.0..55.0_f64, yaw in -3.2..3.2_f64, outside: bool,
        ) {
            let params = CollisionParams { unknown_is_obstacle: true, outside_is_obstacle: outside };
            let checker = CollisionChecker::new(&map, footprint.clone(), params).unwrap();
            let pose = pose_in(&map, x, y, yaw);
            if checker.collides(&pose).unwrap() {
                prop_assert!(near(&map, &footprint, &pose, 0.15 * RESOLUTION, outside), "nothing is there");
            } else {
                prop_assert!(!sampled(&map, &footprint, &pose, outside), "missed");
            }
        }

        /// A motion is free only if every pose on it is; it collides only if one grown by the margin does.
        #[test]
        fn motions_agree_with_many_poses(
            map in any_map(), footprint in any_footprint(), x in 5.0..55.0_f64, y in 5.0..45.0_f64, yaw in -3.2..3.2_f64,
            vx in -1.0..1.0_f64, vy in -0.3..0.3_f64, w in -2.0..2.0_f64, dt in 0.0..1.5_f64,
        ) {
            let checker = CollisionChecker::new(&map, footprint, CollisionParams::default()).unwrap();
            let (start, twist) = (pose_in(&map, x, y, yaw), Twist2::new(vx, vy, w));
            let poses: Vec<Se2> = (0..=400).map(|i| start.compose(&twist.integrate(dt * f64::from(i) / 400.0))).collect();
            if checker.collides_along(&start, &twist, dt).unwrap() {
                prop_assert!(poses.iter().any(|pose| checker.touches(pose, 2.0 * MARGIN + 0.05)), "nothing is there");
            } else {
                prop_assert!(!poses.iter().any(|pose| checker.touches(pose, 0.0)), "missed");
            }
            let end = start.compose(&twist.integrate(dt));
            prop_assert!(checker.collides_between(&start, &end).unwrap() || !checker.collides(&end).unwrap());
        }
    }

    #[test]
    fn nothing_thin_is_jumped_over() {
        let mut map = Grid::filled(GridLayout::new(400, 40, RESOLUTION, Se2::default()).unwrap(), CellState::Free);
        map.set(Cell::new(200, 20), CellState::Occupied);
        let needle = Footprint::circle(0.001).unwrap();
        let checker = CollisionChecker::new(&map, needle, CollisionParams::default()).unwrap();
        let start = Se2::new(1.0, 20.5 * RESOLUTION, 0.0);
        assert!(checker.collides_along(&start, &Twist2::new(1000.0, 0.0, 0.0), 0.0185).unwrap());
        assert!(!checker.collides_along(&start, &Twist2::new(1.0, 0.0, 0.0), 8.9).unwrap());
    }

    #[test]
    fn threads_share_a_checker_and_a_load_changes_the_outline() {
        let mut map = Grid::filled(GridLayout::new(100, 60, RESOLUTION, Se2::default()).unwrap(), CellState::Free);
        map.set(Cell::new(50, 30), CellState::Occupied);
        let empty = Footprint::rectangle(-0.3, 0.3, 0.3).unwrap();
        let mut checker = CollisionChecker::new(&map, empty.clone(), CollisionParams::default()).unwrap();
        let poses: Vec<Se2> = (0..200).map(|i| Se2::new(0.5 + 0.02 * f64::from(i), 1.25, 0.1 * f64::from(i))).collect();
        let count = |checker: &CollisionChecker| poses.iter().filter(|p| checker.collides(p).unwrap()).count();
        let alone = count(&checker);
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..3).map(|_| scope.spawn(|| count(&checker))).collect();
            for thread in threads {
                assert_eq!(thread.join().unwrap(), alone);
            }
        });
        let many = (0..40).map(|i| f64::from(i) * 0.157).map(|a| 0.5 * Vector2::new(a.cos(), a.sin())).collect();
        for loaded in [Footprint::rectangle(-0.3, 0.5, 0.8).unwrap(), Footprint::polygon(many).unwrap()] {
            checker.set_footprint(loaded.clone());
            let anew = CollisionChecker::new(&map, loaded, CollisionParams::default()).unwrap();
            assert_eq!(count(&checker), count(&anew));
            assert!(count(&checker) > alone);
        }
        checker.set_footprint(empty);
        assert_eq!(count(&checker), alone);
    }

    #[test]
    fn bad_input_is_named() {
        let map = Grid::filled(GridLayout::new(40, 40, RESOLUTION, Se2::default()).unwrap(), CellState::Free);
        let checker = CollisionChecker::new(&map, Footprint::circle(0.1).unwrap(), CollisionParams::default()).unwrap();
        let (here, still) = (Se2::new(1.0, 1.0, 0.0), Twist2::ZERO);
        assert!(checker.collides(&Se2::new(f64::NAN, 0.0, 0.0)).is_err());
        assert!(checker.collides(&Se2::new(1e300, 0.0, 0.0)).is_err());
        assert!(checker.collides_along(&here, &Twist2::new(f64::NAN, 0.0, 0.0), 1.0).is_err());
        assert!(checker.collides_along(&here, &Twist2::new(1e9, 0.0, 0.0), 1.0).is_err());
        assert!(checker.collides_along(&here, &still, -1.0).is_err());
        assert!(checker.collides_along(&here, &still, f64::NAN).is_err());
        assert!(checker.collides_between(&here, &Se2::new(0.0, f64::INFINITY, 0.0)).is_err());
        assert_eq!(checker.collides_along(&here, &still, 1.0), Ok(false));
    }
}
