//! String pulling: the path as a taut string between its ends, on the same side of every obstacle as before.
//!
//! While it can, the string is pulled tight over three of its points `a b c`: in the triangle that they span, everything that
//! is blocked is wrapped by a convex chain from `a` to `c`, which replaces `b`,
//!
//! ```text
//! a b c  ->  upper hull, seen from b, of {a, c} and the corners of blocked cells inside the triangle
//! ```
//!
//! which shortens the string unless it is taut there. What is left bends at corners of obstacles only, towards them: the
//! shortest path that can be reached without lifting the string over an obstacle (Hershberger and Snoeyink 1994). Key nodes,
//! by contrast, are points of the path that was given.

use super::{LineOfSight, LineOfSightParams, PathSmoother, straight::write_piece};
use crate::Error;
use agv_core::{
    grid::Costmap,
    path::{Path, PathPoint},
};
use nalgebra::Vector2;

/// Pulls paths taut; owns the memory that it needs for it.
///
/// Blocked cells are grown by the margin, along both axes, as [`LineOfSight`] has it. First and last pose stay as they are, and
/// so do cusps and turns on the spot; other headings look along the new lines. A stretch of the given path that is itself not
/// clear is kept. The result is never longer than the path, and clear where the path was. Each sweep along the string, of which
/// there are at most 1000, takes time in proportion to its points times the cells of a line, plus the cells of the triangles.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_plan::smooth::{LineOfSightParams, PathSmoother, TautString};
///
/// // Round a post, far too wide: the string touches its corners.
/// let mut map = Grid::filled(GridLayout::new(9, 9, 1.0, Se2::default())?, CellState::Free);
/// map.set(Cell::new(4, 4), CellState::Occupied);
/// let wide = [(1.5, 4.5), (1.5, 8.5), (7.5, 8.5), (7.5, 4.5)].map(|(x, y)| Vector2::new(x, y));
/// let mut taut = Path::new();
/// let mut string = TautString::new(LineOfSightParams::default())?;
/// string.smooth_into(&Costmap::from_map(&map), &Path::from_positions(&wide)?, &mut taut)?;
/// assert_eq!(taut.len(), 4);
/// assert!((taut.length() - (1.0 + 2.0 * 2.5_f64.hypot(0.5))).abs() < 1e-6);
/// # Ok::<(), agv_plan::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct TautString {
    sight: LineOfSight,
    /// The string, in cells of the grid frame.
    string: Vec<Knot>,
    pulled: Vec<Knot>,
    /// Corners within a triangle: along and above its base, and where they are.
    corners: Vec<(Vector2<f64>, Vector2<f64>)>,
    chain: Vec<(Vector2<f64>, Vector2<f64>)>,
    positions: Vec<Vector2<f64>>,
}

/// A point of the string; the line to the next one is not to be moved where it was not clear.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Knot {
    point: Vector2<f64>,
    next_is_clear: bool,
}

impl TautString {
    /// Sweeps along the string after which it counts as taut.
    const MAX_SWEEPS: usize = 1000;

    /// What new lines may cross.
    ///
    /// # Errors
    /// As [`LineOfSight::new`].
    pub fn new(params: LineOfSightParams) -> Result<Self, Error> {
        let sight = LineOfSight::new(params)?;
        let (string, pulled, corners, chain, positions) = Default::default();
        Ok(Self { sight, string, pulled, corners, chain, positions })
    }

    /// Pulls one piece of one gear, whose positions are in `string`.
    fn pull(&mut self, costmap: &Costmap) {
        let layout = costmap.layout();
        // More than what a line of sight takes for touching.
        let slack = 4e-9 * (2.0 + layout.width().max(layout.height()) as f64);
        let grown = self.sight.params().margin / layout.resolution() + slack;
        for _ in 0..Self::MAX_SWEEPS {
            let mut changed = false;
            self.pulled.clear();
            for index in 0..self.string.len() {
                let knot = self.string[index];
                let next = self.string.get(index + 1).copied();
                let (Some(before), Some(next)) = (self.pulled.last().copied(), next) else {
                    self.pulled.push(knot);
                    continue;
                };
                let is_free = before.next_is_clear && knot.next_is_clear;
                if is_free && self.tighten(costmap, grown, [before.point, knot.point, next.point]) {
                    let chain = self.chain.iter().map(|&(_, point)| Knot { point, next_is_clear: true });
                    self.pulled.extend(chain);
                    changed = true;
                } else {
                    self.pulled.push(knot);
                }
            }
            std::mem::swap(&mut self.string, &mut self.pulled);
            if !changed {
                return;
            }
        }
    }

    /// Finds the chain that replaces `b`, in `chain`, and says whether it is another one.
    fn tighten(&mut self, costmap: &Costmap, grown: f64, [a, b, c]: [Vector2<f64>; 3]) -> bool {
        self.corners.clear();
        self.chain.clear();
        let base = (c - a).try_normalize(0.0).unwrap_or_else(Vector2::zeros);
        // Above the base is where b is.
        let sign = if base.perp(&(b - a)) < 0.0 { -1.0 } else { 1.0 };
        let in_base = |p: Vector2<f64>| Vector2::new(base.dot(&(p - a)), sign * base.perp(&(p - a)));
        if in_base(b).y > 0.0 {
            self.corners_within(costmap, grown, [a, b, c], sign);
            self.corners.iter_mut().for_each(|(key, point)| *key = in_base(*point));
            // Round a, from the far side of the triangle down to the base; of two in line the nearer one first.
            let angle = |p: &Vector2<f64>| p.y.atan2(p.x);
            self.corners.sort_by(|p, q| {
                angle(&q.0).total_cmp(&angle(&p.0)).then(p.0.norm_squared().total_cmp(&q.0.norm_squared()))
            });
        }
        let start = (Vector2::zeros(), a);
        for &corner in self.corners.iter().chain([&(in_base(c), c)]) {
            let mut is_needed = true;
            while let Some(&last) = self.chain.last() {
                let before = self.chain.len().checked_sub(2).and_then(|i| self.chain.get(i)).copied().unwrap_or(start);
                let (line, onward) = (last.0 - before.0, corner.0 - last.0);
                let turn = line.perp(&onward);
                let rounding = ROUNDING * (line.norm() + onward.norm());
                // Of points in line with a, rounding may have put a nearer one behind a farther one.
                is_needed = turn < -rounding || turn > rounding || line.dot(&onward) >= 0.0;
                // What does not stick out above the line is not needed.
                if turn < -rounding || !is_needed {
                    break;
                }
                self.chain.pop();
            }
            if is_needed {
                self.chain.push(corner);
            }
        }
        self.chain.pop();
        if matches!(self.chain[..], [(_, only)] if only == b) {
            return false;
        }
        let ways = self.chain.iter().map(|&(_, point)| point).chain([c]);
        let length: f64 = ways.scan(a, |from, to| Some((to - std::mem::replace(from, to)).norm())).sum();
        // Fewer points, or a shorter way: it comes to an end.
        let worth = if self.chain.is_empty() { -ROUNDING } else { ROUNDING };
        if length > (b - a).norm() + (c - b).norm() - worth {
            return false;
        }
        // Rounding may leave a line that counts as touching: then the string stays where it was.
        let layout = costmap.layout();
        let mut from = a;
        self.chain.iter().map(|&(_, point)| point).chain([c]).all(|to| {
            let line = (layout.to_map(&from), layout.to_map(&to));
            from = to;
            self.sight.is_clear(costmap, &line.0, &line.1)
        })
    }

    /// Corners of blocked cells that lie in the triangle, with the cell on the inside.
    fn corners_within(&mut self, costmap: &Costmap, grown: f64, triangle: [Vector2<f64>; 3], sign: f64) {
        let [a, b, c] = triangle;
        let layout = costmap.layout();
        let (low, high) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
        let first = |v: f64| (v - 1.0 - grown).floor().max(0.0) as usize;
        let after = |v: f64, len: usize| ((v + grown).ceil().max(0.0) as usize + 1).min(len);
        for y in first(low.y)..after(high.y, layout.height()) {
            let (row_low, row_high) = (y as f64 - grown, y as f64 + 1.0 + grown);
            let Some([left, right]) = extent(triangle, row_low, row_high) else { continue };
            let columns = first(left)..after(right, layout.width());
            let row = y * layout.width();
            let Some(cells) = costmap.costs().get(row + columns.start.min(columns.end)..row + columns.end) else {
                continue;
            };
            for (x, _) in columns.zip(cells).filter(|(_, cost)| !self.sight.may_cross(**cost)) {
                for (out_x, out_y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                    let out = Vector2::new(out_x, out_y);
                    let corner = Vector2::new(x as f64 + 0.5, y as f64 + 0.5) + out * (0.5 + grown);
                    // The edges of the triangle belong to it where the cell lies on its side of them.
                    let inside = [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| {
                        let edge = (to - from) * sign;
                        let (at, inwards) = (edge.perp(&(corner - from)), edge.perp(&-out));
                        // The string runs from a over b above the base: clockwise.
                        at < -ROUNDING * edge.norm() || (at < ROUNDING * edge.norm() && inwards < 0.0)
                    });
                    if inside && corner != a && corner != c {
                        self.corners.push((corner, corner));
                    }
                }
            }
        }
    }
}

/// How far a corner may lie beside an edge and still be on it, in cells.
const ROUNDING: f64 = 1e-10;

/// Least and greatest x of a triangle between two heights.
fn extent(triangle: [Vector2<f64>; 3], low: f64, high: f64) -> Option<[f64; 2]> {
    let [a, b, c] = triangle;
    let mut found: Option<[f64; 2]> = None;
    for (p, q) in [(a, b), (b, c), (c, a)] {
        if p.y.max(q.y) < low || p.y.min(q.y) > high {
            continue;
        }
        let at = |y: f64| {
            let t = if p.y == q.y { 0.0 } else { ((y - p.y) / (q.y - p.y)).clamp(0.0, 1.0) };
            p.x + (q.x - p.x) * t
        };
        let ends = if p.y == q.y { [p.x, q.x] } else { [at(low), at(high)] };
        for x in ends {
            found = Some(found.map_or([x, x], |[left, right]| [left.min(x), right.max(x)]));
        }
    }
    found
}

impl PathSmoother for TautString {
    fn smooth_into(&mut self, costmap: &Costmap, path: &Path, smooth: &mut Path) -> Result<(), agv_core::Error> {
        smooth.clear();
        let layout = costmap.layout();
        let mut points: &[PathPoint] = path.points();
        while let Some(end) = super::straight::piece_end(points) {
            let (piece, rest) = points.split_at(end + 1);
            self.string.clear();
            for (index, point) in piece.iter().enumerate() {
                let position = point.pose.translation();
                let next = piece.get(index + 1).map(|next| next.pose.translation());
                let next_is_clear = next.is_none_or(|next| self.sight.is_clear(costmap, &position, &next));
                self.string.push(Knot { point: layout.to_grid(&position), next_is_clear });
            }
            self.pull(costmap);
            self.positions.clear();
            self.positions.extend(self.string.iter().map(|knot| layout.to_map(&knot.point)));
            write_piece(piece, &self.positions, smooth)?;
            // The last point of a piece is the first of the next.
            points = if rest.is_empty() { rest } else { &points[end..] };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{AStar, AStarParams, Anya, GridPlannerParams};
    use crate::smooth::KeyNodes;
    use agv_core::{
        geometry::Se2,
        grid::{Cell, CellState, Grid, GridLayout, cost},
        path::Gear,
        roles::{GlobalPlanner, PlanOutcome},
    };
    use proptest::prelude::*;

    fn string() -> TautString {
        TautString::new(LineOfSightParams::default()).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        /// Clear, no longer than the key nodes' path, no shorter than the shortest of all, and no point can be left out or
        /// pulled on: a second pull changes nothing.
        #[test]
        fn planned_paths_become_taut(blocked in proptest::collection::vec(0_u8..10, 240), share in 1_u8..5) {
            let layout = GridLayout::new(16, 15, 0.5, Se2::new(-2.0, 1.0, 0.2)).unwrap();
            let mut costs: Vec<u8> = blocked.iter().map(|&b| if b < share { cost::LETHAL } else { cost::FREE }).collect();
            (costs[0], costs[239]) = (cost::FREE, cost::FREE);
            let costmap = Costmap::from_costs(Grid::new(layout, costs).unwrap());
            let pose = |x, y| Se2::from_parts(layout.center(Cell::new(x, y)), agv_core::geometry::So2::from_angle(1.0));
            let (start, goal) = (pose(0, 0), pose(15, 14));
            let (mut path, mut keys, mut taut, mut again) = (Path::new(), Path::new(), Path::new(), Path::new());
            let outcome = AStar::new(AStarParams::default()).unwrap().plan_into(&costmap, &start, &goal, &mut path).unwrap();
            let found = matches!(outcome, PlanOutcome::Found { .. });
            prop_assume!(found);
            KeyNodes::new(LineOfSightParams::default()).unwrap().shorten_into(&costmap, &path, &mut keys).unwrap();
            string().smooth_into(&costmap, &path, &mut taut).unwrap();
            prop_assert!(taut.length() <= keys.length() + 1e-6 || taut.length() <= path.length());
            let mut anya = Anya::new(GridPlannerParams::default()).unwrap();
            let least = anya.plan_into(&costmap, &start, &goal, &mut again).unwrap();
            let is_least = matches!(least, PlanOutcome::Found { cost, .. } if cost <= taut.length() + 1e-9);
            prop_assert!(is_least, "{:?} {}", least, taut.length());
            prop_assert_eq!((taut.points()[0].pose, taut.points()[taut.len() - 1].pose), (start, goal));
            let sight = LineOfSight::default();
            for pair in taut.points().windows(2) {
                let (a, b) = (pair[0].pose.translation(), pair[1].pose.translation());
                prop_assert!(sight.is_clear(&costmap, &a, &b));
            }
            string().smooth_into(&costmap, &taut, &mut again).unwrap();
            prop_assert!((again.length() - taut.length()).abs() < 1e-6, "{} {}", again.length(), taut.length());
        }
    }

    /// Where there is one obstacle, the taut string on the shorter side of it is the shortest path.
    #[test]
    fn round_one_block_it_is_the_shortest_path() {
        let layout = GridLayout::new(30, 30, 0.5, Se2::new(3.0, 1.0, -0.4)).unwrap();
        let mut map = Grid::filled(layout, CellState::Free);
        for (x, y) in (10..22).flat_map(|x| (5..17).map(move |y| (x, y))) {
            map.set(Cell::new(x, y), CellState::Occupied);
        }
        let costmap = Costmap::from_map(&map);
        let pose = |x, y| Se2::from_parts(layout.center(Cell::new(x, y)), agv_core::geometry::So2::default());
        for (start, goal) in [((2, 9), (28, 14)), ((12, 2), (25, 20)), ((5, 5), (25, 25))] {
            let (start, goal) = (pose(start.0, start.1), pose(goal.0, goal.1));
            let (mut path, mut taut) = (Path::new(), Path::new());
            AStar::new(AStarParams::default()).unwrap().plan_into(&costmap, &start, &goal, &mut path).unwrap();
            string().smooth_into(&costmap, &path, &mut taut).unwrap();
            let PlanOutcome::Found { cost, .. } =
                Anya::new(GridPlannerParams::default()).unwrap().plan_into(&costmap, &start, &goal, &mut path).unwrap()
            else {
                panic!("no path");
            };
            assert!((taut.length() - cost).abs() < 1e-5, "{} for {cost}", taut.length());
        }
    }

    #[test]
    fn cusps_turns_and_blocked_stretches_stay() {
        let layout = GridLayout::new(20, 20, 1.0, Se2::default()).unwrap();
        let mut map = Grid::filled(layout, CellState::Free);
        map.set(Cell::new(10, 15), CellState::Occupied);
        let costmap = Costmap::from_map(&map);
        let (mut path, mut taut) = (Path::new(), Path::new());
        for (x, y, gear) in [
            (1.5, 4.5, Gear::Forward),
            (5.5, 6.5, Gear::Forward),
            (9.5, 4.5, Gear::Forward),
            (6.5, 5.5, Gear::Reverse),
            (2.5, 4.5, Gear::Reverse),
        ] {
            path.push(PathPoint { pose: Se2::new(x, y, 0.0), gear }).unwrap();
        }
        path.push_turn(1.0).unwrap();
        // Straight through the block: not to be moved.
        for (x, y) in [(8.5, 15.5), (12.5, 15.5), (15.5, 12.5)] {
            path.push(PathPoint { pose: Se2::new(x, y, 0.0), gear: Gear::Forward }).unwrap();
        }
        string().smooth_into(&costmap, &path, &mut taut).unwrap();
        let positions: Vec<_> = taut.points().iter().map(|p| (p.pose.x(), p.pose.y())).collect();
        let want = [(1.5, 4.5), (9.5, 4.5), (2.5, 4.5), (2.5, 4.5), (8.5, 15.5), (12.5, 15.5), (15.5, 12.5)];
        assert_eq!(positions.len(), want.len(), "{positions:?}");
        assert!(positions.iter().zip(want).all(|(a, b)| (a.0 - b.0).hypot(a.1 - b.1) < 1e-9), "{positions:?}");
        assert!(taut.is_turn(3) && taut.points()[2].gear == Gear::Reverse);
        string().smooth_into(&costmap, &Path::new(), &mut taut).unwrap();
        assert!(taut.is_empty());
        assert!(TautString::new(LineOfSightParams { margin: f64::NAN, ..Default::default() }).is_err());
    }
}
