//! Straight pieces, turns on the spot and tight arcs, driven slowly, one after the other: what gets a vehicle out of tight places.

use super::{NavigationRequest, search::Node};
use agv_core::geometry::{LieGroup, Se2, Twist2};
use std::f64::consts::{FRAC_PI_2, PI};

/// Headings that are told apart.
pub(super) const HEADINGS: i32 = 24;
/// Length of a straight piece, in metres.
const PIECE: f64 = 0.06;
/// Speeds, in metres per second and radians per second, and the errors at which a piece is done.
const SPEED: f64 = 0.4;
const TURN_RATE: f64 = 1.2;
const DONE: f64 = 0.03;
const TURNED: f64 = 0.05;

/// What a piece is: a straight, a turn on the spot, or a tight arc, along which a vehicle gets off a wall beside it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Piece {
    /// Sign of the way: ahead, none, or back.
    way: i8,
    /// Sign of the turn: to the left, none, or to the right.
    turn: i8,
}

impl Piece {
    pub(super) const ALL: [Self; 8] = [
        Self { way: 1, turn: 0 },
        Self { way: 1, turn: 1 },
        Self { way: 1, turn: -1 },
        Self { way: 0, turn: 1 },
        Self { way: 0, turn: -1 },
        Self { way: -1, turn: 0 },
        Self { way: -1, turn: 1 },
        Self { way: -1, turn: -1 },
    ];

    /// The unit motion, for one second.
    pub(super) fn twist(self) -> Twist2 {
        let turn = 2.0 * PI / f64::from(HEADINGS);
        Twist2::new(PIECE * f64::from(self.way), 0.0, turn * f64::from(self.turn))
    }

    /// Whether a vehicle that may not back up can do it.
    pub(super) const fn leads_ahead(self) -> bool {
        self.way >= 0
    }

    /// What it costs, in metres: backing up and turning take longer.
    pub(super) const fn cost(self) -> f64 {
        match (self.way, self.turn) {
            (1, 0) => PIECE,
            (0 | 1, _) => 0.08,
            (_, 0) => 1.5 * PIECE,
            _ => 0.12,
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

impl Manoeuvre {
    pub(super) fn from_nodes(nodes: &[Node], end: usize) -> Self {
        let mut targets: Vec<(Piece, Se2)> = Vec::new();
        let mut at = end;
        while let Some(Node { pose, parent: Some(parent), piece, .. }) = nodes.get(at) {
            // No target is more than half a turn ahead: the sign of what is left must be known.
            let is_new = |(last, end): &(Piece, Se2)| last != piece || end.between(pose).yaw().abs() >= FRAC_PI_2;
            if targets.last().is_none_or(is_new) {
                targets.push((*piece, *pose));
            }
            at = *parent;
        }
        targets.reverse();
        Self { targets, next: 0 }
    }

    /// Ends of the pieces, in the map.
    #[cfg(test)]
    pub(super) fn targets(&self) -> &[(Piece, Se2)] {
        &self.targets
    }

    /// The twist to aim at, for a vehicle that can come to rest within this cycle or not; rest between two pieces, none when all
    /// are done.
    pub(super) fn wish(&mut self, request: &NavigationRequest<'_>, can_rest: bool) -> Option<Twist2> {
        let (piece, target) = *self.targets.get(self.next)?;
        let error = request.state.map_from_base.between(&target);
        let (way, side) = (f64::from(piece.way), f64::from(piece.turn));
        let (is_done, wish) = if piece.turn == 0 {
            let left = way * error.x();
            let mend = (2.0 * error.yaw()).clamp(-0.5, 0.5);
            (left < DONE, Twist2::new(way * SPEED.min(2.0 * left.abs() + 0.05), 0.0, mend))
        } else {
            let left = side * error.yaw();
            let rate = TURN_RATE.min(3.0 * left.abs() + 0.1);
            let per_turn = PIECE * f64::from(HEADINGS) / (2.0 * PI);
            (left < TURNED, Twist2::new(way * per_turn * rate, 0.0, side * rate))
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
