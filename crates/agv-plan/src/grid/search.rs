//! Best-first search: one loop for Dijkstra, A* and what is built on them.
//!
//! ```text
//! until the open list is empty:
//!     take the node of least key                  Workspace::pop
//!     say what is known of it for good            SearchSpace::settle
//!     for what can be reached from it: the way    SearchSpace::expand, Frontier::reach
//! ```
//!
//! A space says *absolute* costs and may look at what is known of other nodes, so that a node's way need not come from the
//! node that is expanded (any-angle search), a step need not lead to a neighbour (jump points), and a guess may be mended
//! when its node comes up (lazy search). The three lines are open: who searches from both ends, or shares the open list
//! between searches, calls them one by one.

use super::{
    heuristic::Heuristic,
    limits::{Limits, SearchEnd, SearchResult},
    nodes::{DenseNodes, Known, NodeStore},
    queue::{BucketQueue, Entry, OpenList},
};

/// A node and what is known of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reached<L> {
    /// The node.
    pub node: u32,
    /// Cost of the way to it.
    pub cost: u32,
    /// How it was reached.
    pub link: L,
}

/// A graph that is searched, its nodes numbered from zero.
pub trait SearchSpace {
    /// How a node was reached, enough to find the node before it (a step, or that node). The default value marks a start.
    type Link: Copy + Default;

    /// Number of nodes.
    fn node_count(&self) -> usize;

    /// Cost of a step that few exceed, to size the open list by; dearer ones are queued at a higher price.
    fn max_step(&self) -> u32;

    /// Tells `frontier` what can be reached from a node, at which cost from the start and how. What the way by which `at` was
    /// reached shows to be useless may be left out.
    fn expand(&self, at: Reached<Self::Link>, frontier: &mut impl Frontier<Self::Link>);

    /// The node from which `link` led to `node`; none if `link` marks a start.
    fn predecessor(&self, node: u32, link: Self::Link) -> Option<u32>;

    /// A last word on a node before it is expanded: another cost and link, if those with which it was queued were a guess.
    #[inline]
    fn settle(&self, _at: Reached<Self::Link>, _nodes: &impl NodeStore<Self::Link>) -> Option<Known<Self::Link>> {
        None
    }
}

/// What a search offers the space while a node is expanded.
pub trait Frontier<L> {
    /// What is known of a node so far.
    fn known(&self, node: u32) -> Option<Known<L>>;

    /// A way to `node` of that cost from the start; kept if it is the cheapest one so far. A cost of `u32::MAX` stands for
    /// whatever is too large to count.
    fn reach(&mut self, node: u32, cost: u32, link: L);
}

/// Memory of a search, reused from query to query: nothing is allocated once it has seen the largest space.
///
/// A query costs what it expands and not the size of the space.
///
/// ```
/// use agv_plan::grid::{Frontier, Limits, Reached, SearchEnd, SearchSpace, Workspace, Zero};
///
/// /// The numbers below `n`; from k one may go to k + 1 at cost 3 and to 2 k at cost 5.
/// struct Numbers(u32);
///
/// impl SearchSpace for Numbers {
///     type Link = Option<u32>; // the number before
///     fn node_count(&self) -> usize {
///         self.0 as usize
///     }
///     fn max_step(&self) -> u32 {
///         5
///     }
///     fn expand(&self, at: Reached<Option<u32>>, frontier: &mut impl Frontier<Option<u32>>) {
///         for (next, step) in [(at.node + 1, 3), (2 * at.node, 5)] {
///             if next < self.0 {
///                 frontier.reach(next, at.cost.saturating_add(step), Some(at.node));
///             }
///         }
///     }
///     fn predecessor(&self, _: u32, before: Option<u32>) -> Option<u32> {
///         before
///     }
/// }
///
/// let mut workspace: Workspace<_> = Workspace::default();
/// let result = workspace.search(&Numbers(100), &Zero, 1, |k| k == 24, &mut Limits::none());
/// assert_eq!(result.end, SearchEnd::Goal { node: 24, cost: 21 });
/// let mut way = Vec::new();
/// workspace.trace_into(&Numbers(100), 24, &mut way);
/// assert_eq!(way, [1, 2, 3, 6, 12, 24]);
///
/// // The same step by step: all that costs no more than 5.
/// workspace.begin(&Numbers(100));
/// workspace.add_start(&Zero, 1, 0);
/// let mut near = Vec::new();
/// while workspace.least_key().is_some_and(|key| key <= 5) {
///     near.extend(workspace.expand_next(&Numbers(100), &Zero).map(|at| at.node));
/// }
/// assert_eq!(near, [1, 2]);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Workspace<L, Q = BucketQueue, N = DenseNodes<L>> {
    nodes: N,
    open: Q,
    /// Some way was too long to be counted.
    overflow: bool,
    link: std::marker::PhantomData<L>,
}

impl<L: Copy + Default, Q: OpenList, N: NodeStore<L>> Workspace<L, Q, N> {
    /// Searches from `start` for a node that `is_goal` accepts.
    ///
    /// With a consistent heuristic the way found is of least cost and each node is expanded at most once. Constant time
    /// per expansion with a [`BucketQueue`]. A start beyond the space is a space without successors: exhausted.
    pub fn search<S, H>(
        &mut self,
        space: &S,
        heuristic: &H,
        start: u32,
        is_goal: impl Fn(u32) -> bool,
        limits: &mut Limits<'_>,
    ) -> SearchResult
    where
        S: SearchSpace<Link = L>,
        H: Heuristic,
    {
        self.begin(space);
        self.add_start(heuristic, start, 0);
        let result = self.run(space, heuristic, is_goal, limits);
        SearchResult { nearest: if result.expansions == 0 { start } else { result.nearest }, ..result }
    }

    /// Goes on from where the search stands: after [`begin`](Self::begin) and [`add_start`](Self::add_start), or after an
    /// earlier end. The goal that ended a search is not looked at again.
    pub fn run<S, H>(
        &mut self,
        space: &S,
        heuristic: &H,
        is_goal: impl Fn(u32) -> bool,
        limits: &mut Limits<'_>,
    ) -> SearchResult
    where
        S: SearchSpace<Link = L>,
        H: Heuristic,
    {
        let mut result = SearchResult { end: SearchEnd::Exhausted, expansions: 0, nearest: u32::MAX };
        let mut nearest_estimate = u32::MAX;
        let mut pause = limits.next_pause(0);
        while let Some((key, at)) = self.pop(space) {
            if is_goal(at.node) {
                result.end = SearchEnd::Goal { node: at.node, cost: at.cost };
                return result;
            }
            if result.expansions >= pause {
                if let Some(end) = limits.stopped(result.expansions) {
                    // It was not expanded: whoever goes on finds it where it was.
                    self.open.push(key, Entry { node: at.node, cost: at.cost });
                    result.end = end;
                    return result;
                }
                pause = limits.next_pause(result.expansions);
            }
            result.expansions += 1;
            let estimate = key.wrapping_sub(at.cost);
            if estimate < nearest_estimate {
                nearest_estimate = estimate;
                result.nearest = at.node;
            }
            self.expand(space, heuristic, at);
        }
        if self.overflow {
            result.end = SearchEnd::Budget;
        }
        result
    }

    /// Forgets the last search.
    pub fn begin<S: SearchSpace<Link = L>>(&mut self, space: &S) {
        let len = space.node_count();
        self.nodes.begin(len);
        // A consistent heuristic falls by at most the step, so keys rise by at most twice the step.
        self.open.reset(space.max_step().saturating_mul(2), len);
        self.overflow = false;
    }

    /// Adds a node to begin at (there may be several), reached at `cost`; false if there is no such node.
    pub fn add_start(&mut self, heuristic: &impl Heuristic, node: u32, cost: u32) -> bool {
        let is_new = self.nodes.get(node).is_none_or(|known| cost < known.cost);
        let added = is_new && self.nodes.set(node, Known { cost, link: L::default() });
        if added {
            self.open.push(cost.saturating_add(heuristic.estimate(node)), Entry { node, cost });
        }
        added
    }

    /// Takes the node of least key from the open list, settled, and its key.
    #[inline]
    pub fn pop<S: SearchSpace<Link = L>>(&mut self, space: &S) -> Option<(u32, Reached<L>)> {
        loop {
            let (key, Entry { node, cost }) = self.open.pop()?;
            // A cheaper way was found after the entry was queued, or the node was settled at another cost.
            let Some(known) = self.nodes.get(node).filter(|known| known.cost == cost) else { continue };
            let at = Reached { node, cost, link: known.link };
            if let Some(known) = space.settle(at, &self.nodes) {
                self.nodes.set(node, known);
                return Some((key, Reached { node, cost: known.cost, link: known.link }));
            }
            return Some((key, at));
        }
    }

    /// Queues what can be reached from a node.
    #[inline]
    pub fn expand<S: SearchSpace<Link = L>>(&mut self, space: &S, heuristic: &impl Heuristic, at: Reached<L>) {
        let (nodes, open) = (&mut self.nodes, &mut self.open);
        let mut growing = Growing { nodes, open, heuristic, overflow: false, link: std::marker::PhantomData };
        space.expand(at, &mut growing);
        self.overflow |= growing.overflow;
    }

    /// One round of the loop: the node that was expanded, if any was left.
    pub fn expand_next<S: SearchSpace<Link = L>>(
        &mut self,
        space: &S,
        heuristic: &impl Heuristic,
    ) -> Option<Reached<L>> {
        let (_, at) = self.pop(space)?;
        self.expand(space, heuristic, at);
        Some(at)
    }

    /// Least key in the open list: no way that is still to be found is cheaper. It may be that of a node which has been
    /// reached more cheaply since.
    #[inline]
    pub fn least_key(&self) -> Option<u32> {
        self.open.least_key()
    }

    /// Whether some way was too long to be counted since the search began: what it led to is then not known to be out of
    /// reach.
    pub const fn has_overflowed(&self) -> bool {
        self.overflow
    }

    /// Cost of the way to `node` in the last search, if it was reached; final for nodes that were expanded.
    #[inline]
    pub fn cost(&self, node: u32) -> Option<u32> {
        self.nodes.get(node).map(|known| known.cost)
    }

    /// How `node` was reached in the last search, if it was.
    #[inline]
    pub fn link(&self, node: u32) -> Option<L> {
        self.nodes.get(node).map(|known| known.link)
    }

    /// Writes the way from the start of the last search to `node`, both included; empty if it was not reached.
    pub fn trace_into<S: SearchSpace<Link = L>>(&self, space: &S, node: u32, way: &mut Vec<u32>) {
        way.clear();
        let mut next = self.nodes.get(node).map(|_| node);
        while let Some(node) = next {
            way.push(node);
            next = self.link(node).and_then(|link| space.predecessor(node, link));
        }
        way.reverse();
    }
}

/// The frontier of a [`Workspace`].
struct Growing<'a, L, Q, N, H> {
    nodes: &'a mut N,
    open: &'a mut Q,
    heuristic: &'a H,
    overflow: bool,
    link: std::marker::PhantomData<L>,
}

impl<L: Copy, Q: OpenList, N: NodeStore<L>, H: Heuristic> Frontier<L> for Growing<'_, L, Q, N, H> {
    #[inline]
    fn known(&self, node: u32) -> Option<Known<L>> {
        self.nodes.get(node)
    }

    #[inline]
    fn reach(&mut self, node: u32, cost: u32, link: L) {
        if cost == u32::MAX {
            self.overflow = true;
        } else if self.nodes.improve(node, Known { cost, link }) {
            self.open.push(cost.saturating_add(self.heuristic.estimate(node)), Entry { node, cost });
        }
    }
}
