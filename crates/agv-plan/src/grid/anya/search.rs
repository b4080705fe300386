//! The search: cones from row to row, and the corners round which a taut string bends.

use super::{
    ray::{Cone, Point, Ray, cross},
    runs::Runs,
};
use crate::grid::{Limits, SearchEnd};
use agv_core::{grid::Cell, roles::NoPathReason};
use std::{cmp::Reverse, collections::BinaryHeap};

/// Costs, in half cells, that differ by no more are equal but for rounding.
const ROUNDING: f64 = 1e-9;

/// Where a way bends: the start, or a corner of an obstacle.
#[derive(Debug, Clone, Copy)]
struct Root {
    point: Point,
    cost: f64,
    /// Number of the root before; of the start its own.
    parent: u32,
    /// From the root before to here.
    arrival: [i64; 2],
    /// How the way goes on from here, unless it is the start.
    bend: Bend,
    /// A cheaper way to this corner was found.
    is_dead: bool,
}

/// Into which quadrant a way bends (signs of x and y), and whether towards the obstacle's upright or its level edge.
#[derive(Debug, Clone, Copy, Default)]
struct Bend {
    side: i32,
    direction: i32,
    upright: bool,
}

/// What is expanded.
#[derive(Debug, Clone, Copy)]
enum Node {
    /// The cone is to be followed into a row of cells, in the direction of this sign.
    Cone { root: u32, cone: Cone, row: i32, direction: i32 },
    /// What lies behind a corner is to be looked at.
    Corner { root: u32 },
    /// The goal is seen from the root.
    Goal { root: u32 },
}

/// The best root at a corner for one way round it, if `stamp` is that of the search.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    stamp: u32,
    root: u32,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Search {
    roots: Vec<Root>,
    nodes: Vec<Node>,
    /// By the bits of a cost, which order as the cost does: it is not negative.
    open: BinaryHeap<(Reverse<u64>, u32)>,
    best: Vec<Slot>,
    stamp: u32,
    goal: Point,
    /// The root from which the way ends, and whether it ends at the goal.
    last: Option<(u32, bool)>,
    pub(super) expansions: u64,
}

impl Search {
    /// Searches between the centres of two free cells.
    ///
    /// # Errors
    /// Why no way was found; where the limits stopped the search, the way leads to the corner nearest to the goal.
    pub(super) fn run(
        &mut self,
        runs: &Runs,
        (start, goal): (Cell, Cell),
        limits: &mut Limits<'_>,
    ) -> Result<(), NoPathReason> {
        let center = |cell: Cell| Point { x: 2 * cell.x + 1, y: 2 * cell.y + 1 };
        self.begin(runs, center(goal));
        let point = center(start);
        self.roots.push(Root { point, cost: 0.0, parent: 0, arrival: [0, 0], bend: Bend::default(), is_dead: false });
        self.last = Some((0, start == goal));
        if start == goal {
            return Ok(());
        }
        if let Some((run, true)) = runs.run(start.x, start.y) {
            for direction in [1, -1] {
                self.enter(runs, 0, Cone { left: Ray::LEFT, right: Ray::RIGHT }, (start.y, direction), run);
            }
        }
        let (mut nearest, mut pause) = (f64::INFINITY, limits.next_pause(0));
        while let Some((_, node)) = self.open.pop() {
            let Some(&node) = self.nodes.get(node as usize) else { continue };
            let (Node::Cone { root, .. } | Node::Corner { root } | Node::Goal { root }) = node;
            if self.roots[root as usize].is_dead {
                continue;
            }
            if self.expansions >= pause {
                match limits.stopped(self.expansions) {
                    Some(SearchEnd::Cancelled) => return Err(NoPathReason::Cancelled),
                    Some(_) => return Err(NoPathReason::Budget),
                    None => pause = limits.next_pause(self.expansions),
                }
            }
            self.expansions += 1;
            let to_goal = self.roots[root as usize].point.distance(self.goal);
            if to_goal < nearest {
                (nearest, self.last) = (to_goal, Some((root, false)));
            }
            match node {
                Node::Goal { root } => {
                    self.last = Some((root, true));
                    return Ok(());
                }
                Node::Cone { root, cone, row, direction } => self.follow(runs, root, cone, row, direction),
                Node::Corner { root } => self.bend(runs, root),
            }
        }
        self.last = None;
        Err(NoPathReason::Disconnected)
    }

    /// The way of the last search, from its end back to the start, without points on straight lines.
    pub(super) fn way_back_into(&self, way: &mut Vec<Point>) {
        way.clear();
        let Some((mut root, at_goal)) = self.last else { return };
        way.extend(at_goal.then_some(self.goal));
        loop {
            let Root { point, parent, .. } = self.roots[root as usize];
            if let [.., before, last] = way[..]
                && cross(before.to(last), last.to(point)) == 0
            {
                way.pop();
            }
            if way.last() != Some(&point) {
                way.push(point);
            }
            if parent == root {
                return;
            }
            root = parent;
        }
    }

    fn begin(&mut self, runs: &Runs, goal: Point) {
        self.roots.clear();
        self.nodes.clear();
        self.open.clear();
        (self.goal, self.expansions) = (goal, 0);
        let slots = 2 * runs.corner_count();
        if self.best.len() < slots {
            self.best.resize(slots, Slot::default());
        }
        self.stamp = self.stamp.wrapping_add(1);
        if self.stamp == 0 {
            self.best.fill(Slot::default());
            self.stamp = 1;
        }
    }

    fn push(&mut self, node: Node, cost: f64) {
        let number = self.nodes.len() as u32;
        self.nodes.push(node);
        // The later of two of one cost first: deeper.
        self.open.push((Reverse(cost.to_bits()), number));
    }

    /// Follows a cone across the line at which it stands into the runs of free cells behind.
    fn follow(&mut self, runs: &Runs, root: u32, cone: Cone, row: i32, direction: i32) {
        let from = self.roots[root as usize].point;
        let near = if direction > 0 { 2 * row } else { 2 * row + 2 };
        let distance = i64::from(near - from.y).abs();
        let right_end = cone.right.meets(from.x, distance);
        let mut column = cone.left.column(from.x, distance);
        while f64::from(2 * column) < right_end {
            let Some((run, is_free)) = runs.run(column, row) else { break };
            if is_free {
                let [left, right] = run.map(|end| {
                    let corner = Point { x: 2 * end, y: near };
                    let ray = Ray::through(from, corner, direction);
                    if cone.holds(ray) {
                        self.turn(runs, root, corner);
                    }
                    ray
                });
                if let Some(part) = cone.between(left, right) {
                    self.enter(runs, root, part, (row, direction), run);
                }
            }
            column = run[1];
        }
    }

    /// Looks about in a run of free cells, and passes what is seen of its far side on to the next row.
    fn enter(&mut self, runs: &Runs, root: u32, cone: Cone, (row, direction): (i32, i32), run: [i32; 2]) {
        let Root { point: from, cost, .. } = self.roots[root as usize];
        let goal = self.goal;
        if goal.y == 2 * row + 1 && (2 * run[0]..2 * run[1]).contains(&goal.x) {
            let ray = Ray::through(from, goal, direction);
            if cone.holds(ray) {
                self.push(Node::Goal { root }, cost + from.distance(goal));
            }
        }
        let far = if direction > 0 { 2 * row + 2 } else { 2 * row };
        let [left, right] = run.map(|end| {
            let corner = Point { x: 2 * end, y: far };
            let ray = Ray::through(from, corner, direction);
            if cone.holds(ray) {
                self.turn(runs, root, corner);
            }
            ray
        });
        let next = row + direction;
        if runs.run(run[0], next).is_none() {
            return;
        }
        if let Some(part) = cone.between(left, right) {
            let distance = i64::from(far - from.y).abs();
            let ends = [part.left, part.right].map(|ray| ray.meets(from.x, distance));
            let bound = cost + self.bound(from, far, ends);
            self.push(Node::Cone { root, cone: part, row: next, direction }, bound);
        }
    }

    /// Least length from a root through an interval of the line at `y` to the goal, which is mirrored there if it lies on the
    /// root's side.
    fn bound(&self, from: Point, y: i32, [left, right]: [f64; 2]) -> f64 {
        let (before, behind) = (f64::from((y - from.y).abs()), f64::from((y - self.goal.y).abs()));
        let (x, goal) = (f64::from(from.x), f64::from(self.goal.x));
        let crossing = (x + (goal - x) * before / (before + behind)).max(left).min(right);
        (crossing - x).hypot(before) + (goal - crossing).hypot(behind)
    }

    /// Bends round a corner that the root sees, if a taut string would.
    ///
    /// Only the corner of a single blocked cell bends a string, and only towards the edges of that cell: the new cone lies
    /// between the arrival, drawn on, and the edge.
    fn turn(&mut self, runs: &Runs, root: u32, corner: Point) {
        let lattice = Cell::new(corner.x / 2, corner.y / 2);
        let Some([x, y]) = runs.lone_blocked(lattice) else { return };
        let Root { point: from, cost, .. } = self.roots[root as usize];
        let arrival = from.to(corner);
        let (along_x, along_y) = (arrival[0] * i64::from(x), arrival[1] * i64::from(y));
        // Along the cell's upright edge, or along its level one; and the quadrant in which the new cone lies.
        let (upright, side, direction) = if along_x < 0 && along_y >= 0 {
            (true, -x, y)
        } else if along_x >= 0 && along_y < 0 {
            (false, x, -y)
        } else {
            return;
        };
        let edge = if upright { [0, i64::from(y)] } else { [i64::from(x), 0] };
        let cost = cost + from.distance(corner);
        let slot = 2 * runs.corner_index(lattice) + usize::from(upright);
        let number = self.roots.len() as u32;
        if let Some(known) = self.best.get(slot).filter(|known| known.stamp == self.stamp) {
            let known = &mut self.roots[known.root as usize];
            let is_wider = cross(arrival, known.arrival) * cross(arrival, edge).signum() > 0;
            if cost > known.cost + ROUNDING || (cost >= known.cost - ROUNDING && !is_wider) {
                return;
            }
            known.is_dead = cost < known.cost - ROUNDING;
        }
        self.best[slot] = Slot { stamp: self.stamp, root: number };
        let bend = Bend { side, direction, upright };
        self.roots.push(Root { point: corner, cost, parent: root, arrival, bend, is_dead: false });
        self.push(Node::Corner { root: number }, cost + corner.distance(self.goal));
    }

    /// Looks about behind a corner.
    fn bend(&mut self, runs: &Runs, root: u32) {
        let Root { point, arrival, bend: Bend { side, direction, upright }, .. } = self.roots[root as usize];
        let onward = Ray { aside: arrival[0], ahead: arrival[1].abs() };
        let cone = match (upright, side > 0) {
            (true, true) => Cone { left: Ray::AHEAD, right: onward },
            (true, false) => Cone { left: onward, right: Ray::AHEAD },
            (false, true) => Cone { left: onward, right: Ray::RIGHT },
            (false, false) => Cone { left: Ray::LEFT, right: onward },
        };
        let lattice = Cell::new(point.x / 2, point.y / 2);
        let (column, row) = (lattice.x + (side - 1) / 2, lattice.y + (direction - 1) / 2);
        if let Some((run, true)) = runs.run(column, row) {
            self.enter(runs, root, cone, (row, direction), run);
        }
        if !upright {
            self.slide(runs, root, lattice, side);
        }
    }

    /// Along a line between two rows, from a corner on, for as long as there is a free cell beside it.
    fn slide(&mut self, runs: &Runs, root: u32, from: Cell, side: i32) {
        let (mut x, mut last) = (from.x, [true; 2]);
        loop {
            let column = x + (side - 1) / 2;
            let beside = [runs.is_free(column, from.y), runs.is_free(column, from.y - 1)];
            // Between two cells, or between two that touch at this corner, there is no way.
            let squeezes = (!last[0] && !beside[1]) || (!last[1] && !beside[0]);
            if beside == [false; 2] || squeezes {
                return;
            }
            (x, last) = (x + side, beside);
            self.turn(runs, root, Point { x: 2 * x, y: 2 * from.y });
        }
    }
}
