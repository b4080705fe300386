//! Search from both ends until the two halves meet (Pohl 1971; consistent halves: Ikeda et al. 1994).
//!
//! The two searches must agree on how much a step is worth. With lower bounds `h` to the goal and `h'` to the start they are
//! guided by
//!
//! ```text
//! p(n) = (h(n) - h'(n) + c) / 2        p'(n) = c - p(n)
//! ```
//!
//! each of which falls by no more than a step costs, if `h` and `h'` do. A node that both have reached closes a way; the
//! best one, of cost `m`, is optimal as soon as the least keys of the two open lists together are no less than `m + c`.
//!
//! Each half looks at one of several equally short ways only, as [`Uniform`](super::Uniform) does, and the halves may prefer
//! different ones. They still agree on the cost of each cell, so they meet in a cell of a shortest way, if each has settled
//! it. Along such a way the keys of the two halves of a cell add up to its cost plus `c`, and rise by at most two steps from
//! cell to cell. If the least keys together exceed the best cost by those two steps as well, some cell of it lies below both.

use super::{
    astar::{AStarParams, GridHeuristic},
    heuristic::{Euclidean, Heuristic, Manhattan, Octile, Offset, Zero},
    limits::{Limits, SearchEnd, SearchResult},
    nodes::Known,
    planner::{GridPlanner, GridSolver},
    search::{Frontier, Reached, SearchSpace, Workspace},
    space::GridSpace,
    step::{DIAGONAL, Step},
};
use crate::Error;
use std::cell::Cell;

/// Bidirectional A*, and with [`GridHeuristic::Zero`] bidirectional Dijkstra: costs as those of [`AStar`](super::AStar).
///
/// Without a heuristic two circles are searched, each with half the radius of the one. With a heuristic the gain is small
/// in the open (both bounds pull to the straight line) and large where start or goal lie in a dead end.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{AStarParams, Bidirectional};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(20, 10, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.25, 0.25, 0.0), Se2::new(1.75, 0.25, 0.0), Path::new());
/// let outcome = Bidirectional::new(AStarParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - 1.5).abs() < 1e-12));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Bidirectional = GridPlanner<BidirectionalSolver>;

/// The search of [`Bidirectional`].
#[derive(Debug, Clone)]
pub struct BidirectionalSolver {
    heuristic: GridHeuristic,
    forward: Workspace<Step>,
    backward: Workspace<Step>,
    /// Goal of the last search, and where its halves met at least cost.
    met: Option<(u32, Meeting)>,
}

/// A node that both halves have reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Meeting {
    cost: u32,
    node: u32,
}

impl Bidirectional {
    /// Checks the parameters.
    ///
    /// # Errors
    /// As [`AStar::new`](super::AStar::new).
    pub fn new(params: AStarParams) -> Result<Self, Error> {
        let (params, heuristic) = params.split()?;
        let (forward, backward) = (Workspace::default(), Workspace::default());
        Self::with_solver(params, BidirectionalSolver { heuristic, forward, backward, met: None })
    }
}

impl BidirectionalSolver {
    fn search_by<H: Heuristic>(
        &mut self,
        space: &GridSpace,
        bound: impl Fn(Offset) -> H,
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        let (to_goal, to_start) = (bound(Offset::to(space, goal)), bound(Offset::to(space, start)));
        // No less than any difference of the bounds, so that keys are not negative.
        let (width, height) = space.layout().map_or((0, 0), |l| (l.width() as u32, l.height() as u32));
        let balanced = Balanced { to_goal, to_start, constant: 2 * DIAGONAL * (width + height) };
        if space.is_weighted() {
            self.search_between(&space.weighted(), &balanced, (start, goal), limits)
        } else {
            self.search_between(&space.uniform(), &balanced, (start, goal), limits)
        }
    }

    fn search_between<H: Heuristic>(
        &mut self,
        space: &impl SearchSpace<Link = Step>,
        balanced: &Balanced<H>,
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        let mirrored = Mirrored(balanced);
        self.forward.begin(space);
        self.backward.begin(space);
        self.forward.add_start(balanced, start, 0);
        self.backward.add_start(&mirrored, goal, 0);
        let best = Cell::new((start == goal).then_some(Meeting { cost: 0, node: start }));
        let mut result = SearchResult { end: SearchEnd::Exhausted, expansions: 0, nearest: start };
        let mut nearest_estimate = u32::MAX;
        let mut pause = limits.next_pause(0);
        let margin = 2 * space.max_step();
        while let (Some(ahead), Some(behind)) = (self.forward.least_key(), self.backward.least_key()) {
            let still_possible = ahead.saturating_add(behind).saturating_sub(balanced.constant);
            if best.get().is_some_and(|meeting| meeting.cost.saturating_add(margin) <= still_possible) {
                break;
            }
            if result.expansions >= pause {
                if let Some(end) = limits.stopped(result.expansions) {
                    result.end = end;
                    self.met = None;
                    return result;
                }
                pause = limits.next_pause(result.expansions);
            }
            // In turn: neither half waits for a wide room around the other's end.
            let is_forward = result.expansions.is_multiple_of(2);
            let (one, other) =
                if is_forward { (&mut self.forward, &self.backward) } else { (&mut self.backward, &self.forward) };
            let expanded = if is_forward {
                one.expand_next(&Watched { space, other, best: &best, rest: &balanced.to_goal }, balanced)
            } else {
                one.expand_next(&Watched { space, other, best: &best, rest: &balanced.to_start }, &mirrored)
            };
            result.expansions += u64::from(expanded.is_some());
            if let Some(at) = expanded.filter(|_| is_forward) {
                let estimate = balanced.to_goal.estimate(at.node);
                if estimate < nearest_estimate {
                    (nearest_estimate, result.nearest) = (estimate, at.node);
                }
            }
        }
        self.met = best.get().map(|meeting| (goal, meeting));
        if let Some(Meeting { cost, .. }) = best.get() {
            result.end = SearchEnd::Goal { node: goal, cost };
        }
        result
    }
}

impl GridSolver for BidirectionalSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        let ends = (start, goal);
        match self.heuristic {
            GridHeuristic::Exact | GridHeuristic::Octile => self.search_by(space, Octile, ends, limits),
            GridHeuristic::Manhattan => self.search_by(space, Manhattan, ends, limits),
            GridHeuristic::Euclidean => self.search_by(space, Euclidean, ends, limits),
            GridHeuristic::Zero => self.search_by(space, |_| Zero, ends, limits),
        }
    }

    /// The half that begins at the start may have been left unfinished when the other had nothing left.
    fn exhaust(&mut self, space: &GridSpace, limits: &mut Limits<'_>) -> u64 {
        if space.is_weighted() {
            self.forward.run(&space.weighted(), &Zero, |_| false, limits).expansions
        } else {
            self.forward.run(&space.uniform(), &Zero, |_| false, limits).expansions
        }
    }

    fn cost(&self, node: u32) -> Option<u32> {
        match self.met {
            Some((goal, meeting)) if goal == node => Some(meeting.cost),
            _ => self.forward.cost(node),
        }
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        let view = space.uniform();
        let Some((_, meeting)) = self.met.filter(|(goal, _)| *goal == node) else {
            return self.forward.trace_into(&view, node, way);
        };
        self.forward.trace_into(&view, meeting.node, way);
        // The backward half's links lead on to the goal.
        let onward = |node: u32| view.predecessor(node, self.backward.link(node)?);
        way.extend(std::iter::successors(onward(meeting.node), |&node| onward(node)));
    }

    fn is_guided(&self) -> bool {
        self.heuristic != GridHeuristic::Zero
    }
}

/// The guide of the forward half.
struct Balanced<H> {
    to_goal: H,
    to_start: H,
    constant: u32,
}

impl<H: Heuristic> Heuristic for Balanced<H> {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        (self.to_goal.estimate(node) + self.constant).saturating_sub(self.to_start.estimate(node)) / 2
    }
}

/// The guide of the backward half.
struct Mirrored<'a, H>(&'a Balanced<H>);

impl<H: Heuristic> Heuristic for Mirrored<'_, H> {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        self.0.constant - self.0.estimate(node)
    }
}

/// A space that notes which of the nodes that are reached the other half has reached too.
struct Watched<'a, S, H> {
    space: &'a S,
    other: &'a Workspace<Step>,
    best: &'a Cell<Option<Meeting>>,
    /// A bound on the rest of the way.
    rest: &'a H,
}

impl<S: SearchSpace<Link = Step>, H: Heuristic> SearchSpace for Watched<'_, S, H> {
    type Link = Step;

    fn node_count(&self) -> usize {
        self.space.node_count()
    }

    fn max_step(&self) -> u32 {
        self.space.max_step()
    }

    #[inline]
    fn expand(&self, at: Reached<Step>, frontier: &mut impl Frontier<Step>) {
        self.space.expand(at, &mut Watching { frontier, watched: self });
    }

    fn predecessor(&self, node: u32, link: Step) -> Option<u32> {
        self.space.predecessor(node, link)
    }
}

struct Watching<'a, 'b, F, S, H> {
    frontier: &'a mut F,
    watched: &'a Watched<'b, S, H>,
}

impl<F: Frontier<Step>, S, H: Heuristic> Frontier<Step> for Watching<'_, '_, F, S, H> {
    #[inline]
    fn known(&self, node: u32) -> Option<Known<Step>> {
        self.frontier.known(node)
    }

    #[inline]
    fn reach(&mut self, node: u32, cost: u32, link: Step) {
        let Watched { other, best, rest, .. } = self.watched;
        // No way through the node is better than the one that is known.
        if best.get().is_some_and(|meeting| cost.saturating_add(rest.estimate(node)) >= meeting.cost) {
            return;
        }
        self.frontier.reach(node, cost, link);
        if let Some(rest) = other.cost(node) {
            let cost = cost.saturating_add(rest);
            if best.get().is_none_or(|meeting| cost < meeting.cost) {
                best.set(Some(Meeting { cost, node }));
            }
        }
    }
}
