//! Search from both ends until the two halves meet (Pohl 1971), each guided by its own bound and kept out of what the other
//! has closed (BS*, Kwa 1989; the bound on the rest: Pijls and Post, NBA*, 2009).
//!
//! Let `h` and `h'` be bounds on the cost to the goal and to the start, `F'` the least key of the backward half, and `m` the
//! cost of the best way that was closed by a cell which both halves have reached. A cell `v` with cost `g` that comes up in
//! the forward half is not expanded, if
//!
//! ```text
//! the backward half has closed it              the best way through it is known
//! g + h(v) >= m   or   g + F' - h'(v) >= m     no way through it is better
//! ```
//!
//! and likewise backward. The search ends when a half has nothing left below `m`: as long as a better way is to be found, none
//! of its cells is left out by either half, so that each half would have come to the other's end.
//!
//! Each half looks at one of several equally short ways only, as [`Uniform`](super::Uniform) does. Both still agree on the cost
//! of each cell, which is all that the argument needs.

use super::{
    astar::{AStarParams, GridHeuristic},
    heuristic::{Euclidean, Heuristic, Manhattan, Octile, Offset, Zero},
    limits::{Limits, SearchEnd, SearchResult},
    nodes::Known,
    planner::{GridPlanner, GridSolver},
    search::{Frontier, Reached, SearchSpace, Workspace},
    space::GridSpace,
    step::Step,
};
use crate::Error;
use std::cell::Cell;

/// Bidirectional A*, and with [`GridHeuristic::Zero`] bidirectional Dijkstra: costs as those of [`AStar`](super::AStar).
///
/// Without a heuristic two circles are searched, each with half the radius of the one. With a heuristic the gain is small
/// in the open and large where start or goal lie in a dead end.
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
        let bounds = (bound(Offset::to(space, goal)), bound(Offset::to(space, start)));
        if space.is_weighted() {
            self.search_between(&space.weighted(), (&bounds.0, &bounds.1), (start, goal), limits)
        } else {
            self.search_between(&space.uniform(), (&bounds.0, &bounds.1), (start, goal), limits)
        }
    }

    fn search_between<H: Heuristic>(
        &mut self,
        space: &impl SearchSpace<Link = Step>,
        (to_goal, to_start): (&H, &H),
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        self.forward.begin(space);
        self.backward.begin(space);
        self.forward.add_start(to_goal, start, 0);
        self.backward.add_start(to_start, goal, 0);
        self.met = None;
        let best = Cell::new((start == goal).then_some(Meeting { cost: 0, node: start }));
        let overflow = Cell::new(false);
        let mut result = SearchResult { end: SearchEnd::Exhausted, expansions: 0, nearest: start };
        let mut nearest_estimate = u32::MAX;
        let (mut pause, mut stopped) = (limits.next_pause(0), None);
        let mut is_forward = false;
        while let (Some(ahead), Some(behind)) = (self.forward.least_key(), self.backward.least_key()) {
            if best.get().is_some_and(|meeting| meeting.cost <= ahead.max(behind)) {
                break;
            }
            if result.expansions >= pause {
                if let Some(end) = limits.stopped(result.expansions) {
                    stopped = Some(end);
                    break;
                }
                pause = limits.next_pause(result.expansions);
            }
            // In turn: neither half waits for a wide room around the other's end.
            is_forward = !is_forward;
            let (one, other, least_of_other, rest, back) = if is_forward {
                (&mut self.forward, &self.backward, behind, to_goal, to_start)
            } else {
                (&mut self.backward, &self.forward, ahead, to_start, to_goal)
            };
            let Some((_, at)) = one.pop(space) else { continue };
            // What the other half has not closed costs it no less than this.
            let least_rest = least_of_other.saturating_sub(back.estimate(at.node));
            let is_closed = other.cost(at.node).is_some_and(|cost| cost < least_rest);
            let is_worse = |meeting: Meeting| at.cost.saturating_add(least_rest) >= meeting.cost;
            if is_closed || best.get().is_some_and(is_worse) {
                continue;
            }
            result.expansions += 1;
            if is_forward {
                let estimate = rest.estimate(at.node);
                if estimate < nearest_estimate {
                    (nearest_estimate, result.nearest) = (estimate, at.node);
                }
            }
            one.expand(&Watched { space, other, best: &best, overflow: &overflow, rest }, rest, at);
        }
        self.met = best.get().map(|meeting| (goal, meeting));
        // A whole way may be known before it is known to be the best: it is what there is so far.
        if self.met.is_some() {
            result.nearest = goal;
        }
        result.end = match (stopped, self.met) {
            (Some(end), _) => end,
            (None, Some((node, Meeting { cost, .. }))) => SearchEnd::Goal { node, cost },
            (None, None) if overflow.get() || self.forward.has_overflowed() || self.backward.has_overflowed() => {
                SearchEnd::Budget
            }
            (None, None) => SearchEnd::Exhausted,
        };
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

/// A space that notes which of the nodes that are reached the other half has reached too.
struct Watched<'a, S, H> {
    space: &'a S,
    other: &'a Workspace<Step>,
    best: &'a Cell<Option<Meeting>>,
    /// Whether the halves of some way are together too long to be counted.
    overflow: &'a Cell<bool>,
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
        let Watched { other, best, overflow, rest, .. } = self.watched;
        // No way through the node is better than the one that is known.
        if best.get().is_some_and(|meeting| cost.saturating_add(rest.estimate(node)) >= meeting.cost) {
            return;
        }
        self.frontier.reach(node, cost, link);
        if let Some(rest) = other.cost(node) {
            let cost = cost.saturating_add(rest);
            if cost == u32::MAX {
                overflow.set(true);
            } else if best.get().is_none_or(|meeting| cost < meeting.cost) {
                best.set(Some(Meeting { cost, node }));
            }
        }
    }
}
