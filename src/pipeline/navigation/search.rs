//! A way out of tight places, found by a search with the exact outline.
//!
//! Local planners look for one smooth motion. Between two pillars it may take several: back, turn, ahead. A best-first search over
//! poses (4 cm, 15°) finds them where they exist, out of contacts too. It is spread over cycles, for the vehicle stands meanwhile; if it had
//! to get out of somebody's way, the search begins anew.

use super::{
    NavigationRequest, contact,
    manoeuvre::{HEADINGS, Manoeuvre, Piece},
};
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, nearest_on_segment, wrap_angle},
    grid::Footprint,
    path::Path,
};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    f64::consts::PI,
};

/// Poses that are looked at before giving up, and of those that are gone on from in one cycle.
const MOST: usize = 3000;
const PER_CYCLE: usize = 40;
/// Edge of a cell of positions, in metres.
const CELL: f64 = 0.04;
/// How far ahead on the path the way out leads, in metres.
const AHEAD: f64 = 0.9;
/// How near to that it ends, in metres and radians.
const NEAR: f64 = 0.15;
const ALIGNED: f64 = 0.5;

/// A pose that was reached, and how.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) pose: Se2,
    pub(super) parent: Option<usize>,
    pub(super) piece: Piece,
    cost: f64,
}

/// A search that is under way.
#[derive(Debug, Clone)]
pub(super) struct Search {
    start: Se2,
    target: Se2,
    nodes: Vec<Node>,
    known: BTreeMap<(i32, i32, i32), f64>,
    open: BinaryHeap<Reverse<(u64, usize)>>,
}

/// What a search came to.
#[derive(Debug)]
pub(super) enum Found {
    Way(Manoeuvre),
    NoWay,
    /// It takes more cycles.
    NotYet,
}

impl Search {
    /// A search for a way to a place ahead on the path; none if the vehicle cannot turn on the spot.
    pub(super) fn new(request: &NavigationRequest<'_>, path: &Path) -> Option<Self> {
        let start = request.state.map_from_base;
        let can_turn = request.limits.steering.is_none() && request.limits.twist.yaw_rate > 0.0;
        let target = place_ahead(path, &start).filter(|_| can_turn)?;
        Some(Self::between(start, target))
    }

    fn between(start: Se2, target: Se2) -> Self {
        Self {
            start,
            target,
            nodes: vec![Node { pose: start, parent: None, piece: Piece::ALL[0], cost: 0.0 }],
            known: BTreeMap::from([((0, 0, 0), 0.0)]),
            open: BinaryHeap::from([Reverse((0, 0))]),
        }
    }

    /// Begins anew if the vehicle is not where the search began.
    pub(super) fn stay_with(&mut self, here: &Se2) {
        let moved = self.start.between(here);
        if moved.translation().norm() > 0.5 * CELL || moved.yaw().abs() > 0.5 * PI / f64::from(HEADINGS) {
            *self = Self::between(*here, self.target);
        }
    }

    /// A cycle's share of the search.
    pub(super) fn go_on(&mut self, request: &NavigationRequest<'_>, footprint: &Footprint) -> Result<Found, Error> {
        for _ in 0..PER_CYCLE {
            let Some(Reverse((_, index))) = self.open.pop().filter(|_| self.nodes.len() <= MOST) else {
                return Ok(Found::NoWay);
            };
            let (pose, cost) = (self.nodes[index].pose, self.nodes[index].cost);
            let error = wrap_angle(pose.yaw() - self.target.yaw());
            let is_there = index > 0 && self.rest(&pose) < NEAR && error.abs() < ALIGNED;
            if is_there && !request.map.collides(footprint, &pose)? {
                return Ok(Found::Way(Manoeuvre::from_nodes(&self.nodes, index)));
            }
            let may_back_up = request.limits.twist.reverse_speed > 0.0;
            for piece in Piece::ALL.into_iter().filter(|piece| may_back_up || piece.leads_ahead()) {
                let (to, cost) = (pose * piece.twist().integrate(1.0), cost + piece.cost());
                let key = self.key(&to);
                if self.known.get(&key).is_some_and(|&known| known <= cost + 1e-9)
                    || !contact::may_pass(request, footprint, &pose, &piece.twist(), 1.0)?
                {
                    continue;
                }
                self.known.insert(key, cost);
                // Micrometres, so that the queue has a total order.
                self.open.push(Reverse((((cost + self.rest(&to)) * 1e6) as u64, self.nodes.len())));
                self.nodes.push(Node { pose: to, parent: Some(index), piece, cost });
            }
        }
        Ok(Found::NotYet)
    }

    /// The least that is left to go, in metres.
    fn rest(&self, pose: &Se2) -> f64 {
        (pose.translation() - self.target.translation()).norm()
    }

    /// The cell of a pose.
    fn key(&self, pose: &Se2) -> (i32, i32, i32) {
        let local = self.start.between(pose);
        let heading = (local.yaw() / (2.0 * PI) * f64::from(HEADINGS)).round() as i32;
        ((local.x() / CELL).round() as i32, (local.y() / CELL).round() as i32, heading.rem_euclid(HEADINGS))
    }
}

/// A pose some way ahead on a path, along it.
fn place_ahead(path: &Path, here: &Se2) -> Option<Se2> {
    let points = path.points();
    let from = here.translation();
    // The nearest segment, then on from there.
    let nearest = (1..points.len()).min_by(|&a, &b| {
        let distance = |i: usize| {
            let (a, b) = (points[i - 1].pose.translation(), points[i].pose.translation());
            (nearest_on_segment(from, a, b) - from).norm()
        };
        distance(a).total_cmp(&distance(b))
    })?;
    let mut left = AHEAD;
    let mut at = from;
    for point in points.iter().skip(nearest) {
        let to = point.pose.translation();
        let way = to - at;
        let length = way.norm();
        if length >= left && length > 0.0 {
            let place = at + way * (left / length);
            return Some(Se2::new(place.x, place.y, way.y.atan2(way.x)));
        }
        left -= length;
        at = to;
    }
    points.last().map(|point| point.pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        geometry::Twist2,
        grid::{CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams},
        kinematics::MotionLimits,
        nalgebra::Vector2,
        roles::VehicleState,
    };

    /// A passage along x, 0.7 m wide, with a cell that sticks out of its left wall.
    fn passage() -> LocalMap {
        let mut map = Grid::filled(GridLayout::new(80, 40, 0.05, Se2::default()).unwrap(), CellState::Free);
        for x in 0..80 {
            for y in (0..13).chain(27..40) {
                map.set(agv_core::grid::Cell::new(x, y), CellState::Occupied);
            }
        }
        map.set(agv_core::grid::Cell::new(38, 26), CellState::Occupied);
        LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap()
    }

    fn search(pose: Se2) -> Result<Option<Vec<(Piece, Se2)>>, Error> {
        let (map, limits) = (passage(), MotionLimits::default());
        let footprint = Footprint::rectangle(-0.25, 0.25, 0.4)?;
        let path = Path::from_positions(&[Vector2::new(1.0, 1.0), Vector2::new(3.8, 1.0)])?;
        let state = VehicleState::new(pose, Twist2::ZERO);
        let request = NavigationRequest { state, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
        let Some(mut search) = Search::new(&request, &path) else { return Ok(None) };
        for _ in 0..=MOST / PER_CYCLE {
            match search.go_on(&request, &footprint)? {
                Found::Way(way) => return Ok(Some(way.targets().to_vec())),
                Found::NoWay => return Ok(None),
                Found::NotYet => {}
            }
        }
        Ok(None)
    }

    #[test]
    fn a_way_is_found_along_a_wall() {
        let (pose, footprint) = (Se2::new(1.9, 1.0, 0.0), Footprint::rectangle(-0.25, 0.25, 0.4).unwrap());
        let way = search(pose).unwrap().unwrap_or_default();
        let end = way.last().unwrap().1;
        assert!(end.x() > pose.x() + AHEAD - 2.0 * NEAR && !passage().collides(&footprint, &end).unwrap());
    }

    #[test]
    fn there_is_no_way_through_a_wall() {
        let pose = Se2::new(1.9, 1.0, 0.0);
        let map = Grid::filled(GridLayout::new(80, 40, 0.05, Se2::default()).unwrap(), CellState::Occupied);
        let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap();
        let path = Path::from_positions(&[Vector2::new(1.0, 1.0), Vector2::new(3.8, 1.0)]).unwrap();
        let (state, limits) = (VehicleState::new(pose, Twist2::ZERO), MotionLimits::default());
        let request = NavigationRequest { state, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
        let footprint = Footprint::rectangle(-0.25, 0.25, 0.4).unwrap();
        let mut search = Search::new(&request, &path).unwrap();
        let mut answers = (0..=MOST / PER_CYCLE).map(|_| search.go_on(&request, &footprint).unwrap());
        let last = answers.find(|found| !matches!(found, Found::NotYet));
        assert!(matches!(last, Some(Found::NoWay)), "{last:?}");
    }
}
