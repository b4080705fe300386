//! Best-first search: one loop for Dijkstra, A* and what is built on them.

use super::{
    heuristic::Heuristic,
    queue::{BucketQueue, Entry, OpenList},
};

/// A graph that is searched, its nodes numbered from zero.
pub trait SearchSpace {
    /// How a node was reached, enough to find the node before it (a step, or that node). The default value marks a start.
    type Link: Copy + Default;

    /// Number of nodes.
    fn node_count(&self) -> usize;

    /// Greatest cost of one step.
    fn max_step(&self) -> u32;

    /// Calls `visit(neighbour, cost of the step, link)` for the neighbours of `node`, which was reached by
    /// `arrival`. Those that the way by which `node` was reached shows to be useless may be left out.
    fn successors(&self, node: u32, arrival: Self::Link, visit: impl FnMut(u32, u32, Self::Link));

    /// The node from which `link` led to `node`; none if `link` marks a start.
    fn predecessor(&self, node: u32, link: Self::Link) -> Option<u32>;
}

/// When a search gives up.
pub struct Limits<'a> {
    /// Most nodes to expand.
    pub budget: u64,
    /// Asked every [`Limits::CANCEL_INTERVAL`] expansions; `true` stops the search.
    pub cancel: Option<&'a mut dyn FnMut() -> bool>,
}

impl Limits<'_> {
    /// Expansions between two questions to `cancel`: some 25 µs.
    pub const CANCEL_INTERVAL: u64 = 1024;

    /// No limits.
    pub const fn none() -> Self {
        Self { budget: u64::MAX, cancel: None }
    }
}

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SearchEnd {
    /// A goal was reached at least cost.
    Goal {
        /// The goal.
        node: u32,
        /// Cost of the way to it.
        cost: u32,
    },
    /// Every node that can be reached was expanded.
    Exhausted,
    /// The budget ran out, or costs left the range of the integers (above four million straight steps).
    Budget,
    /// The callback asked to stop.
    Cancelled,
}

/// What a search did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SearchResult {
    /// Why it ended.
    pub end: SearchEnd,
    /// Nodes that were expanded.
    pub expansions: u64,
    /// The expanded node that the heuristic holds nearest to the goal; the start if nothing was expanded.
    pub nearest: u32,
}

/// What is known of a node; valid if its generation is the search's.
#[derive(Debug, Clone, Copy, Default)]
struct Node<L> {
    cost: u32,
    generation: u16,
    link: L,
}

/// Memory of a search, reused from query to query: nothing is allocated once it has seen the largest space.
///
/// Nodes are stamped with the number of the query, so that a query costs what it expands and not the size of the map.
///
/// ```
/// use agv_plan::grid::{BucketQueue, Heuristic, Limits, SearchEnd, SearchSpace, Workspace, Zero};
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
///     fn successors(&self, k: u32, _: Option<u32>, mut visit: impl FnMut(u32, u32, Option<u32>)) {
///         for (next, cost) in [(k + 1, 3), (2 * k, 5)] {
///             if next < self.0 {
///                 visit(next, cost, Some(k));
///             }
///         }
///     }
///     fn predecessor(&self, _: u32, before: Option<u32>) -> Option<u32> {
///         before
///     }
/// }
///
/// let mut workspace: Workspace<Option<u32>, BucketQueue> = Workspace::default();
/// let result = workspace.search(&Numbers(100), &Zero, 1, |k| k == 24, &mut Limits::none());
/// assert_eq!(result.end, SearchEnd::Goal { node: 24, cost: 21 });
/// let mut way = Vec::new();
/// workspace.trace_into(&Numbers(100), 24, &mut way);
/// assert_eq!(way, [1, 2, 3, 6, 12, 24]);
/// ```
#[derive(Debug, Clone)]
pub struct Workspace<L, Q = BucketQueue> {
    nodes: Vec<Node<L>>,
    open: Q,
    generation: u16,
}

impl<L: Copy + Default, Q: OpenList> Default for Workspace<L, Q> {
    fn default() -> Self {
        Self { nodes: Vec::new(), open: Q::default(), generation: 0 }
    }
}

impl<L: Copy + Default, Q: OpenList> Workspace<L, Q> {
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
        let mut result = SearchResult { end: SearchEnd::Exhausted, expansions: 0, nearest: start };
        let generation = self.generation;
        // The nodes may outnumber this space's, if an earlier one was larger.
        let Some(first) = self.nodes.get_mut(start as usize).filter(|_| (start as usize) < space.node_count()) else {
            return result;
        };
        *first = Node { cost: 0, generation, link: L::default() };
        self.open.push(heuristic.estimate(start), Entry { node: start, cost: 0 });
        let (mut nearest_estimate, mut overflow) = (u32::MAX, false);
        let mut pause = Self::next_pause(0, limits);
        while let Some((key, entry)) = self.open.pop() {
            let Entry { node, cost } = entry;
            let known = self.nodes[node as usize];
            if known.cost != cost {
                continue;
            }
            if is_goal(node) {
                result.end = SearchEnd::Goal { node, cost };
                return result;
            }
            if result.expansions >= pause {
                if let Some(end) = Self::stopped(result.expansions, limits) {
                    result.end = end;
                    return result;
                }
                pause = Self::next_pause(result.expansions, limits);
            }
            result.expansions += 1;
            let estimate = key.wrapping_sub(cost);
            if estimate < nearest_estimate {
                nearest_estimate = estimate;
                result.nearest = node;
            }
            let (nodes, open) = (&mut self.nodes, &mut self.open);
            space.successors(node, known.link, |next, step, link| {
                let Some(slot) = nodes.get_mut(next as usize) else { return };
                let (through, wrapped) = cost.overflowing_add(step);
                overflow |= wrapped;
                if (slot.generation == generation && slot.cost <= through) || wrapped {
                    return;
                }
                *slot = Node { cost: through, generation, link };
                open.push(through.saturating_add(heuristic.estimate(next)), Entry { node: next, cost: through });
            });
        }
        if overflow {
            result.end = SearchEnd::Budget;
        }
        result
    }

    /// Cost of the way to `node` in the last search, if it was reached; final for nodes that were expanded.
    #[inline]
    pub fn cost(&self, node: u32) -> Option<u32> {
        self.nodes.get(node as usize).filter(|n| n.generation == self.generation).map(|n| n.cost)
    }

    /// How `node` was reached in the last search, if it was.
    #[inline]
    pub fn link(&self, node: u32) -> Option<L> {
        self.nodes.get(node as usize).filter(|n| n.generation == self.generation).map(|n| n.link)
    }

    /// Writes the way from the start of the last search to `node`, both included; empty if it was not reached.
    pub fn trace_into<S: SearchSpace<Link = L>>(&self, space: &S, node: u32, way: &mut Vec<u32>) {
        way.clear();
        if self.cost(node).is_none() {
            return;
        }
        let mut node = node;
        way.push(node);
        while let Some(before) = self.nodes.get(node as usize).and_then(|n| space.predecessor(node, n.link)) {
            node = before;
            way.push(node);
        }
        way.reverse();
    }

    /// Forgets the last search.
    fn begin<S: SearchSpace>(&mut self, space: &S) {
        let len = space.node_count();
        if self.nodes.len() < len {
            self.nodes.resize(len, Node::default());
        }
        self.generation = self.generation.wrapping_add(1);
        if self.generation == 0 {
            // Once in 65 535 queries the stamps start anew.
            self.nodes.fill(Node::default());
            self.generation = 1;
        }
        // A consistent heuristic falls by at most the step, so keys rise by at most twice the step.
        self.open.reset(space.max_step().saturating_mul(2), len);
    }

    fn next_pause(expansions: u64, limits: &Limits<'_>) -> u64 {
        let interval = if limits.cancel.is_some() { Limits::CANCEL_INTERVAL } else { u64::MAX };
        limits.budget.min(expansions.saturating_add(interval))
    }

    #[cold]
    fn stopped(expansions: u64, limits: &mut Limits<'_>) -> Option<SearchEnd> {
        if expansions >= limits.budget {
            return Some(SearchEnd::Budget);
        }
        limits.cancel.as_mut().is_some_and(|cancel| cancel()).then_some(SearchEnd::Cancelled)
    }
}
