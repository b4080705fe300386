//! The best pose of a window to a cell: branch and bound.
//!
//! Turns are tried in steps in which the farthest point moves by a cell. For each, a square of offsets scores at most what the
//! maxima over squares of cells say (Hess et al. 2016, Eqs. 10 to 13); squares that cannot beat the best offset so far are left
//! out, so that the result is that of trying all.

use super::{
    params::SearchWindow,
    pyramid::Pyramid,
    squares::{room_of, whole},
    target::Target,
};
use agv_core::geometry::{LieGroup, Se2, So2};
use nalgebra::Vector2;

/// Best pose of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    /// Where the source lies in the target.
    pub(super) pose: Se2,
    /// Sum over the points of the value of the cell where each ends.
    pub(super) score: u32,
    /// Squares and cells whose points were looked up.
    pub(super) evaluated: usize,
}

/// Memory of searches, which serves one after the other.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    /// Turns, those near the guess first.
    rotations: Vec<So2>,
    /// Cells of all points of each turn.
    cells: Vec<(i32, i32)>,
    roots: Vec<Offsets>,
}

impl Scratch {
    /// Bytes of it.
    pub(super) const fn memory(&self) -> usize {
        room_of(&self.rotations) + room_of(&self.cells) + room_of(&self.roots)
    }
}

/// Offsets from (x, y) on, a square of `2^level` each way.
#[derive(Debug, Clone, Copy)]
struct Offsets {
    turn: u32,
    x: i32,
    y: i32,
    bound: u32,
}

/// Most turns to either side.
const MAX_TURNS: f64 = 4096.0;

/// Cells farther off than this are off any grid.
const FAR: f64 = 1e8;

/// Coarsest level: squares of 128 cells.
const MAX_LEVEL: u32 = 7;

/// The search, with what it does not change.
struct Search<'a> {
    pyramid: &'a Pyramid,
    cells: &'a [(i32, i32)],
    points: usize,
    /// Farthest offset, in cells.
    reach: i32,
    best: Offsets,
    evaluated: usize,
}

/// The best pose of `points` around a guess; none if nowhere the points score more than `floor` on average, from 0 to 1, or if there are
/// none. The greater the floor, the sooner that is known.
pub(super) fn search(
    target: &mut Target,
    points: &[Vector2<f64>],
    guess: &Se2,
    window: &SearchWindow,
    floor: f64,
    scratch: &mut Scratch,
) -> Option<Found> {
    let resolution = target.layout.resolution();
    let farthest = points.iter().map(nalgebra::Matrix::norm).fold(resolution, f64::max);
    let turns = (window.angle * farthest / resolution).ceil().min(MAX_TURNS) as i32;
    let step = if turns > 0 { window.angle / f64::from(turns) } else { 0.0 };
    let Scratch { rotations, cells, roots } = scratch;
    rotations.clear();
    let guessed = guess.rotation();
    rotations.push(guessed);
    for turn in 1..=turns {
        rotations.extend([turn, -turn].map(|turn| guessed.compose(&So2::from_angle(f64::from(turn) * step))));
    }
    cells.clear();
    for rotation in &*rotations {
        let turned = Se2::from_parts(guess.translation(), *rotation);
        cells.extend(points.iter().map(|point| {
            let place = target.layout.to_grid(&turned.act(point)).map(|v| v.clamp(-FAR, FAR));
            (whole(place.x), whole(place.y))
        }));
    }

    let reach = (window.distance / resolution).ceil() as i32;
    let level = (2 * reach + 1).ilog2().min(MAX_LEVEL);
    let pyramid = target.pyramid(level as usize);
    let floor = (255.0 * floor * points.len() as f64) as u32;
    let nothing = Offsets { turn: 0, x: 0, y: 0, bound: floor };
    let mut search = Search { pyramid, cells: &cells[..], points: points.len(), reach, best: nothing, evaluated: 0 };
    roots.clear();
    for turn in 0..rotations.len() as u32 {
        for y in (-reach..=reach).step_by(1 << level) {
            roots.extend((-reach..=reach).step_by(1 << level).map(|x| search.bounded(turn, x, y, level)));
        }
    }
    // Of equals the turn nearest to the guess comes first.
    roots.sort_unstable_by_key(|square| (std::cmp::Reverse(square.bound), square.turn, square.y, square.x));
    for square in &*roots {
        search.descend(square, level);
    }
    let Search { best, evaluated, .. } = search;
    let offset = Vector2::new(f64::from(best.x), f64::from(best.y)) * resolution;
    let rotation = *rotations.get(best.turn as usize)?;
    let pose = Se2::from_parts(guess.translation() + offset, rotation);
    (best.bound > floor).then_some(Found { pose, score: best.bound, evaluated })
}

impl Search<'_> {
    /// A square with the bound of its scores; at level zero that is the score.
    #[inline]
    fn bounded(&mut self, turn: u32, x: i32, y: i32, level: u32) -> Offsets {
        self.evaluated += 1;
        let first = turn as usize * self.points;
        let values = self.cells[first..first + self.points]
            .iter()
            .map(|cell| u32::from(self.pyramid.at(level as usize, cell.0 + x, cell.1 + y)));
        Offsets { turn, x, y, bound: values.sum() }
    }

    /// Tries all offsets of a square that may beat the best so far.
    fn descend(&mut self, square: &Offsets, level: u32) {
        if square.bound <= self.best.bound {
            return;
        }
        let Some(finer) = level.checked_sub(1) else {
            self.best = *square;
            return;
        };
        let half = 1 << finer;
        let mut parts = [None; 4];
        for (part, (dx, dy)) in parts.iter_mut().zip([(0, 0), (half, 0), (0, half), (half, half)]) {
            let (x, y) = (square.x + dx, square.y + dy);
            if x <= self.reach && y <= self.reach {
                *part = Some(self.bounded(square.turn, x, y, finer));
            }
        }
        parts.sort_by_key(|part| std::cmp::Reverse(part.map_or(0, |part| part.bound)));
        for part in parts.iter().flatten() {
            self.descend(part, finer);
        }
    }
}
