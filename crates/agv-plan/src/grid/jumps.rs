//! Jump points: the search that [`Jps`](super::Jps) and [`JpsPlus`](super::JpsPlus) share.
//!
//! With the canonical ordering of [`Uniform`](super::Uniform) (of equally short ways the one that takes its diagonals first)
//! most cells have one successor, straight ahead. Those are run through without being queued:
//!
//! - a straight run ends in a *jump point*, a cell that has other successors, or in a dead end;
//! - a diagonal run passes cells from whose sides straight runs lead to jump points. Those are queued, not the cell where the
//!   way turns (*intermediate pruning*: Harabor and Grastien 2014, section 5); it follows from where the jump began and ended.
//!
//! Whoever knows where runs end makes a planner: by scanning ([`Scan`](super::straight_runs)), or by looking it up.

use super::{
    heuristic::Offset,
    masks::Pruning,
    search::{Frontier, Reached, SearchSpace},
    space::GridSpace,
    step::{DIAGONAL, STRAIGHT, Step},
};
use agv_core::grid::{Cell, CornerRule};

/// How a jump point was reached: from where, and by which last step. The way there runs along a diagonal first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Jump {
    from: u32,
    step: Step,
}

impl Default for Jump {
    /// No jump: a start.
    fn default() -> Self {
        Self { from: u32::MAX, step: Step::NONE }
    }
}

impl Jump {
    /// The jump point before; none for a start.
    #[inline]
    pub(super) fn from(self) -> Option<u32> {
        (self.step != Step::NONE).then_some(self.from)
    }
}

/// Where a run ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Run {
    /// Steps to its last cell; zero if it cannot begin.
    pub(super) steps: u32,
    /// Whether it ends because there is something to do; otherwise in a dead end.
    pub(super) is_jump: bool,
}

/// Where runs end. A run may end early in a jump point that is none: it is then run on from there.
pub(super) trait Runs {
    /// A straight run.
    fn straight(&self, at: Cell, step: Step) -> Run;

    /// A diagonal run, up to the first cell that has successors other than the natural ones, or from which a straight run to
    /// one of its sides (along columns first, then along rows) ends in a jump point; and those straight runs.
    fn diagonal(&self, at: Cell, step: Step) -> (Run, [Run; 2]);
}

/// A [`GridSpace`] of uniform cost as a graph of jump points on the way to one goal.
#[derive(Debug, Clone, Copy)]
pub(super) struct JumpPoints<'a, R> {
    masks: &'a [u8],
    strides: [u32; 8],
    pruning: &'a Pruning,
    runs: &'a R,
    goal: u32,
    goal_cell: Cell,
    /// Whether a diagonal run may come to successors that are not ahead: never, where no corner may be cut.
    may_force: bool,
    offset: Offset,
}

impl<'a, R: Runs> JumpPoints<'a, R> {
    /// Straight steps that are counted as a usual jump.
    const USUAL_JUMP: u32 = 16;

    /// The jump points of a space, for ways to `goal`.
    pub(super) fn new(space: &'a GridSpace, runs: &'a R, goal: u32) -> Self {
        Self {
            masks: space.masks(),
            strides: space.strides(),
            pruning: space.canonical(),
            runs,
            goal,
            goal_cell: space.cell(goal),
            may_force: space.params().corner_rule != CornerRule::Never,
            offset: Offset::to(space, goal),
        }
    }

    /// The node `steps` further.
    #[inline]
    fn further(&self, node: u32, step: Step, steps: u32) -> u32 {
        node.wrapping_add(self.strides[step.index() & 7].wrapping_mul(steps))
    }

    /// Steps from a cell straight ahead to the goal, if it lies there.
    #[inline]
    fn steps_to_goal(&self, at: Cell, step: Step) -> Option<u32> {
        let (dx, dy) = (self.goal_cell.x - at.x, self.goal_cell.y - at.y);
        let (along, across) = if step.dx() != 0 { (dx * step.dx(), dy) } else { (dy * step.dy(), dx) };
        (across == 0 && along > 0).then_some(along as u32)
    }

    /// Queues where a straight run leads.
    #[inline]
    fn reach_straight(
        &self,
        (node, at, run): (u32, Cell, Run),
        (step, cost, from): (Step, u32, u32),
        frontier: &mut impl Frontier<Jump>,
    ) {
        let to_goal = self.steps_to_goal(at, step).filter(|&steps| steps <= run.steps);
        if let Some(steps) = to_goal.or(run.is_jump.then_some(run.steps)) {
            let cost = cost.saturating_add(steps.saturating_mul(STRAIGHT));
            frontier.reach(self.further(node, step, steps), cost, Jump { from, step });
        }
    }

    /// Queues where a diagonal run and the straight runs to its sides lead.
    #[inline]
    fn reach_diagonal(&self, from: Reached<Jump>, at: Cell, step: Step, frontier: &mut impl Frontier<Jump>) {
        let (dx, dy) = (step.dx(), step.dy());
        let sides = [Step::towards(dx, 0), Step::towards(0, dy)];
        let natural = step.bit() | sides[0].bit() | sides[1].bit();
        // Where the run crosses the goal's column or row, whichever comes first.
        let (to_column, to_row) = ((self.goal_cell.x - at.x) * dx, (self.goal_cell.y - at.y) * dy);
        let crossing = if to_column > 0 && to_row > 0 { to_column.min(to_row) as u32 } else { u32::MAX };
        let (mut node, mut cell, mut cost, mut done) = (from.node, at, from.cost, 0);
        loop {
            let (run, side_runs) = self.runs.diagonal(cell, step);
            if crossing <= done + run.steps && crossing > done {
                self.reach_crossing((from, at, crossing), (step, sides), frontier);
                if to_column == to_row {
                    return;
                }
            }
            if !run.is_jump {
                return;
            }
            done += run.steps;
            node = self.further(node, step, run.steps);
            cell = Cell::new(at.x + dx * done as i32, at.y + dy * done as i32);
            cost = cost.saturating_add(run.steps.saturating_mul(DIAGONAL));
            if self.may_force {
                let mask = self.masks.get(node as usize).copied().unwrap_or(0);
                if self.pruning.successors(step, mask) & !natural != 0 {
                    return frontier.reach(node, cost, Jump { from: from.node, step });
                }
            }
            for (side, run) in sides.into_iter().zip(side_runs) {
                if run.is_jump {
                    let cost = cost.saturating_add(run.steps.saturating_mul(STRAIGHT));
                    frontier.reach(self.further(node, side, run.steps), cost, Jump { from: from.node, step: side });
                }
            }
        }
    }

    /// Queues the goal, where a diagonal run crosses its column or row after `steps` and the rest is open.
    #[cold]
    fn reach_crossing(
        &self,
        (from, at, steps): (Reached<Jump>, Cell, u32),
        (step, sides): (Step, [Step; 2]),
        frontier: &mut impl Frontier<Jump>,
    ) {
        let cell = Cell::new(at.x + step.dx() * steps as i32, at.y + step.dy() * steps as i32);
        let node = self.further(from.node, step, steps);
        let cost = from.cost.saturating_add(steps.saturating_mul(DIAGONAL));
        if node == self.goal {
            return frontier.reach(node, cost, Jump { from: from.node, step });
        }
        let mask = self.masks.get(node as usize).copied().unwrap_or(0);
        for side in sides {
            if let Some(rest) = self.steps_to_goal(cell, side)
                && mask & side.bit() != 0
                && rest <= self.runs.straight(cell, side).steps
            {
                let cost = cost.saturating_add(rest.saturating_mul(STRAIGHT));
                frontier.reach(self.goal, cost, Jump { from: from.node, step: side });
            }
        }
    }
}

/// The cell where the way of a jump turns from its diagonal to its straight part; none if it does not.
pub(super) fn turning_node(space: &GridSpace, from: u32, to: u32) -> Option<u32> {
    let (a, b) = (space.cell(from), space.cell(to));
    let (dx, dy) = (b.x - a.x, b.y - a.y);
    let steps = dx.abs().min(dy.abs());
    let turn = Cell::new(a.x + steps * dx.signum(), a.y + steps * dy.signum());
    (steps > 0 && turn != b).then(|| space.node(turn)).flatten()
}

impl<R: Runs> SearchSpace for JumpPoints<'_, R> {
    type Link = Jump;

    fn node_count(&self) -> usize {
        self.masks.len()
    }

    fn max_step(&self) -> u32 {
        Self::USUAL_JUMP * DIAGONAL
    }

    #[inline]
    fn expand(&self, at: Reached<Jump>, frontier: &mut impl Frontier<Jump>) {
        let mask = self.masks.get(at.node as usize).copied().unwrap_or(0);
        let mut open = self.pruning.successors(at.link.step, mask);
        let cell = self.offset.cell(at.node);
        while open != 0 {
            let step = Step::from_bit(open.trailing_zeros());
            open &= open - 1;
            if step.is_diagonal() {
                self.reach_diagonal(at, cell, step, frontier);
            } else {
                let run = self.runs.straight(cell, step);
                self.reach_straight((at.node, cell, run), (step, at.cost, at.node), frontier);
            }
        }
    }

    fn predecessor(&self, _: u32, link: Jump) -> Option<u32> {
        link.from()
    }
}
