//! A way out of tight places: straight pieces and turns on the spot, found by a search with the exact outline.
//!
//! Local planners look for one smooth motion. Between two pillars it may take several: back, turn, ahead. A best-first search over
//! poses (5 cm, 22.5°) finds them where they exist; each piece is driven slowly, one after the other.

use super::NavigationRequest;
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, Twist2, wrap_angle},
    grid::Footprint,
    path::Path,
};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    f64::consts::PI,
};

/// Poses that are looked at before giving up.
const MOST: usize = 1500;
/// Edge of a cell of positions, in metres, and the headings that are told apart.
const CELL: f64 = 0.05;
const HEADINGS: i32 = 16;
/// Length of a straight piece, in metres.
const PIECE: f64 = 0.1;
/// How far ahead on the path the way out leads, in metres.
const AHEAD: f64 = 0.9;
/// How near to that it ends, in metres and radians.
const NEAR: f64 = 0.15;
const ALIGNED: f64 = 0.5;
/// Speeds, in metres per second and radians per second, and the errors at which a piece is done.
const SPEED: f64 = 0.4;
const TURN_RATE: f64 = 1.2;
const DONE: f64 = 0.03;
const TURNED: f64 = 0.05;

/// What a piece is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Piece {
    Ahead,
    Back,
    Left,
    Right,
}

impl Piece {
    const ALL: [Self; 4] = [Self::Ahead, Self::Left, Self::Right, Self::Back];

    /// The unit motion, for one second.
    fn twist(self) -> Twist2 {
        let turn = 2.0 * PI / f64::from(HEADINGS);
        match self {
            Self::Ahead => Twist2::new(PIECE, 0.0, 0.0),
            Self::Back => Twist2::new(-PIECE, 0.0, 0.0),
            Self::Left => Twist2::new(0.0, 0.0, turn),
            Self::Right => Twist2::new(0.0, 0.0, -turn),
        }
    }

    /// What it costs, in metres: backing up and turning take longer.
    const fn cost(self) -> f64 {
        match self {
            Self::Ahead => PIECE,
            Self::Back => 1.5 * PIECE,
            Self::Left | Self::Right => 0.12,
        }
    }
}

/// A sequence of pieces, and how far it was driven.
#[derive(Debug, Clone, Default)]
pub(super) struct Manoeuvre {
    /// Ends of the pieces, in the map; pieces of one kind in a row are one.
    targets: Vec<(Piece, Se2)>,
    next: usize,
}

struct Node {
    pose: Se2,
    parent: Option<usize>,
    piece: Piece,
    cost: f64,
}

impl Manoeuvre {
    /// A way to a place ahead on the path; none if the vehicle cannot turn on the spot, or none was found.
    pub(super) fn find(
        request: &NavigationRequest<'_>,
        footprint: &Footprint,
        path: &Path,
    ) -> Result<Option<Self>, Error> {
        let start = request.state.map_from_base;
        let can = request.limits.steering.is_none()
            && request.limits.twist.yaw_rate > 0.0
            && !request.map.collides(footprint, &start)?;
        let Some(target) = place_ahead(path, &start).filter(|_| can) else { return Ok(None) };
        let key = |pose: &Se2| {
            let local = start.between(pose);
            let heading = (local.yaw() / (2.0 * PI) * f64::from(HEADINGS)).round() as i32;
            ((local.x() / CELL).round() as i32, (local.y() / CELL).round() as i32, heading.rem_euclid(HEADINGS))
        };
        let rest = |pose: &Se2| (pose.translation() - target.translation()).norm();
        let mut nodes = vec![Node { pose: start, parent: None, piece: Piece::Ahead, cost: 0.0 }];
        let mut known = BTreeMap::from([(key(&start), 0.0)]);
        let mut open = BinaryHeap::from([Reverse((0_u64, 0_usize))]);
        while let Some(Reverse((_, index))) = open.pop() {
            let (pose, cost) = (nodes[index].pose, nodes[index].cost);
            if rest(&pose) < NEAR && wrap_angle(pose.yaw() - target.yaw()).abs() < ALIGNED && index > 0 {
                return Ok(Some(Self::from_nodes(&nodes, index)));
            }
            if nodes.len() > MOST {
                break;
            }
            for piece in Piece::ALL {
                let (to, cost) = (pose * piece.twist().integrate(1.0), cost + piece.cost());
                let key = key(&to);
                if known.get(&key).is_some_and(|&known| known <= cost + 1e-9)
                    || request.map.collides_along(footprint, &pose, &piece.twist(), 1.0)?
                {
                    continue;
                }
                known.insert(key, cost);
                nodes.push(Node { pose: to, parent: Some(index), piece, cost });
                // Micrometres, so that the queue has a total order.
                open.push(Reverse((((cost + rest(&to)) * 1e6) as u64, nodes.len() - 1)));
            }
        }
        Ok(None)
    }

    fn from_nodes(nodes: &[Node], end: usize) -> Self {
        let mut targets: Vec<(Piece, Se2)> = Vec::new();
        let mut at = end;
        while let Some(Node { pose, parent: Some(parent), piece, .. }) = nodes.get(at) {
            if targets.last().is_none_or(|(last, _)| last != piece) {
                targets.push((*piece, *pose));
            }
            at = *parent;
        }
        targets.reverse();
        Self { targets, next: 0 }
    }

    /// The twist to aim at, for a vehicle that can come to rest within this cycle or not; rest between two pieces, none when all
    /// are done.
    pub(super) fn wish(&mut self, request: &NavigationRequest<'_>, can_rest: bool) -> Option<Twist2> {
        let (piece, target) = *self.targets.get(self.next)?;
        let error = request.state.map_from_base.between(&target);
        let (is_done, wish) = match piece {
            Piece::Left | Piece::Right => {
                let turn = error.yaw();
                (turn.abs() < TURNED, Twist2::new(0.0, 0.0, turn.signum() * TURN_RATE.min(3.0 * turn.abs() + 0.1)))
            }
            Piece::Ahead | Piece::Back => {
                let sign = if piece == Piece::Ahead { 1.0 } else { -1.0 };
                let left = sign * error.x();
                let mend = (2.0 * error.yaw()).clamp(-0.5, 0.5);
                (left < DONE, Twist2::new(sign * SPEED.min(2.0 * left.abs() + 0.05), 0.0, mend))
            }
        };
        if !is_done {
            return Some(wish);
        }
        if can_rest {
            self.next += 1;
        }
        Some(Twist2::ZERO)
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
            let share = ((from - a).dot(&(b - a)) / (b - a).norm_squared().max(1e-12)).clamp(0.0, 1.0);
            (a + (b - a) * share - from).norm()
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
