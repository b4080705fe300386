//! D* Lite (Koenig and Likhachev, *Fast replanning for navigation in unknown terrain*, 2005, Fig. 4, the optimised version): a
//! search that mends its answer where the map has changed, for a vehicle that has moved.
//!
//! The search runs from the goal. Each cell has a cost `g` to the goal and a cost `rhs` that its neighbours promise,
//!
//! ```text
//! rhs(s) = min over neighbours s' of c(s, s') + g(s'),   rhs(goal) = 0
//! ```
//!
//! and waits in the open list while the two differ, with the key (min(g, rhs) + h(start, s) + k, min(g, rhs)). Where steps
//! change, `rhs` is computed anew; the open list then leads to what has to be expanded again. `k` grows by h when the vehicle
//! moves, so that no key need be mended before it comes up. With a vehicle that stands still this is LPA* (Koenig, Likhachev
//! and Furcy 2004).

use super::{
    heuristic::{Heuristic, Manhattan, Octile, Offset},
    indexed_heap::IndexedHeap,
    limits::{Limits, SearchEnd, SearchResult},
    nodes::{DenseNodes, Known, NodeStore},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    space::{GridParams, GridSpace},
    view::{CostWeighted, Lengths, StepPrices},
};
use crate::Error;
use agv_core::grid::{Cell, CellRect, Connectivity, Revision};

/// Replans on a map that changes: costs as those of [`AStar`](super::AStar), for a fraction of the expansions.
///
/// As long as the goal stays the same, a query costs what the changes of the costmap and the way of the vehicle cause. What
/// has changed it asks the costmap for (`Costmap::changed_since`), so that it pays to write to one costmap, not to build
/// another in every cycle. Another goal or a map of another size begins anew, at several times the cost of
/// [`AStar`](super::AStar) per expansion. A budget that ran out is gone on with by the next query; since the search comes
/// from the goal, there is no path so far then but the start.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout, cost};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{DStarLite, GridPlannerParams};
///
/// let mut map = Costmap::from_map(&Grid::filled(GridLayout::new(200, 100, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.25, 5.05, 0.0), Se2::new(19.05, 5.05, 0.0), Path::new());
/// let mut planner = DStarLite::new(GridPlannerParams::default())?;
/// planner.plan_into(&map, &start, &goal, &mut path)?;
///
/// // On its way the vehicle sees something in the way.
/// let here = Se2::new(16.05, 5.05, 0.0);
/// for y in 45..55 {
///     map.set(Cell::new(170, y), cost::LETHAL);
/// }
/// let outcome = planner.plan_into(&map, &here, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if cost > 3.0 && cost < 4.0));
/// // Asked again, it has nothing to do.
/// let outcome = planner.plan_into(&map, &here, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { expansions: 0, .. }));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type DStarLite = GridPlanner<DStarLiteSolver>;

/// The search of [`DStarLite`], with all it knows from earlier queries.
#[derive(Debug, Clone, Default)]
pub struct DStarLiteSolver {
    /// `g` as the cost and `rhs` as the link; what is not in it is infinite.
    nodes: DenseNodes<u32>,
    open: IndexedHeap,
    /// The space as it was seen last.
    seen: Option<Revision>,
    params: GridParams,
    size: (usize, usize),
    masks: Vec<u8>,
    costs: Vec<u8>,
    start: u32,
    goal: u32,
    /// `k` above.
    raised: u32,
    /// Some way was too long to be counted.
    overflow: bool,
}

const INFINITE: u32 = u32::MAX;

impl DStarLite {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative, a cost weight out of range.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        Self::with_solver(params, DStarLiteSolver::default())
    }
}

impl DStarLiteSolver {
    /// What is known of a node: `g` and `rhs`.
    #[inline]
    fn known(&self, node: u32) -> (u32, u32) {
        self.nodes.get(node).map_or((INFINITE, INFINITE), |known| (known.cost, known.link))
    }

    #[inline]
    fn put(&mut self, node: u32, (g, rhs): (u32, u32)) {
        self.nodes.set(node, Known { cost: g, link: rhs });
    }

    /// Both parts of the key, the first one in front.
    #[inline]
    fn key(&self, bound: &impl Heuristic, node: u32) -> u64 {
        let (g, rhs) = self.known(node);
        let cost = g.min(rhs);
        let first = cost.saturating_add(bound.estimate(node)).saturating_add(self.raised);
        u64::from(first) << 32 | u64::from(cost)
    }

    /// Puts a node on the open list while its two costs differ.
    #[inline]
    fn list(&mut self, bound: &impl Heuristic, node: u32) {
        let (g, rhs) = self.known(node);
        if g == rhs {
            self.open.remove(node);
        } else {
            self.open.set(node, self.key(bound, node));
        }
    }

    /// What the neighbours promise, anew.
    fn promise(&mut self, graph: &Graph<impl StepPrices>, node: u32) -> u32 {
        let mut least = INFINITE;
        for (next, price) in graph.neighbours(node) {
            let (g, _) = self.known(next);
            least = least.min(self.sum(g, price));
        }
        least
    }

    #[inline]
    fn sum(&mut self, cost: u32, price: u32) -> u32 {
        let sum = cost.saturating_add(price);
        self.overflow |= sum == INFINITE && cost != INFINITE;
        sum
    }

    fn mend(&mut self, graph: &Graph<impl StepPrices>, bound: &impl Heuristic, node: u32) {
        if node != self.goal {
            let rhs = self.promise(graph, node);
            let (g, before) = self.known(node);
            if rhs != before {
                self.put(node, (g, rhs));
            }
            self.list(bound, node);
        }
    }

    /// Forgets everything but the goal.
    fn begin(&mut self, space: &GridSpace, bound: &impl Heuristic, goal: u32) {
        self.nodes.begin(space.len());
        self.open.reset(space.len());
        (self.goal, self.raised, self.overflow) = (goal, 0, false);
        self.put(goal, (INFINITE, 0));
        self.list(bound, goal);
    }

    /// Follows the space and the start, or begins anew.
    fn follow(&mut self, graph: &Graph<impl StepPrices>, bound: &impl Heuristic, (start, goal): (u32, u32)) {
        let space = graph.space;
        let Some(layout) = space.layout() else { return };
        let size = (layout.width(), layout.height());
        let is_known = self.seen.is_some() && self.size == size && self.params == *space.params();
        let changed = space.follow(&mut self.seen);
        (self.size, self.params) = (size, *space.params());
        // The bound of where the vehicle was from where it is.
        let moved = if is_known { bound.estimate(self.start) } else { 0 };
        self.raised = self.raised.saturating_add(moved);
        self.start = start;
        let goes_on = is_known && goal == self.goal && !self.overflow && self.raised < INFINITE / 4;
        if !goes_on {
            self.masks.resize(space.len(), 0);
            self.costs.resize(space.len(), 0);
            self.begin(space, bound, goal);
        }
        let Some(CellRect { min, max }) = changed else { return };
        if goes_on {
            (min.y..=max.y).for_each(|y| self.mend_row(graph, bound, y, (min.x, max.x)));
        }
        for y in min.y..=max.y {
            let first = y as usize * size.0;
            let cells = first + min.x as usize..=first + max.x as usize;
            self.masks[cells.clone()].copy_from_slice(&space.masks()[cells.clone()]);
            self.costs[cells.clone()].copy_from_slice(&space.costs()[cells]);
        }
    }

    /// Mends the cells of a row whose steps have changed, or where steps cost more than their length, the cost of a cell at
    /// either end.
    fn mend_row(&mut self, graph: &Graph<impl StepPrices>, bound: &impl Heuristic, y: i32, (first, last): (i32, i32)) {
        let costs_differ = graph.space.is_weighted() && self.differs_around(graph.space, y, (first, last));
        for x in first..=last {
            let Some(node) = graph.space.node(Cell::new(x, y)) else { continue };
            let steps_differ = self.masks[node as usize] != graph.space.mask(node);
            if steps_differ || (costs_differ && self.differs_around(graph.space, y, (x, x))) {
                self.mend(graph, bound, node);
            }
        }
    }

    /// Whether a cell of the row between these columns, or one beside them, costs something else than it did.
    fn differs_around(&self, space: &GridSpace, y: i32, (first, last): (i32, i32)) -> bool {
        let (width, height) = (self.size.0 as i32, self.size.1 as i32);
        let (first, last) = ((first - 1).max(0), (last + 1).min(width - 1));
        ((y - 1).max(0)..=(y + 1).min(height - 1)).any(|y| {
            let cells = (y * width + first) as usize..=(y * width + last) as usize;
            self.costs[cells.clone()] != space.costs()[cells]
        })
    }

    /// Expands until the start is known.
    fn settle(
        &mut self,
        graph: &Graph<impl StepPrices>,
        bound: &impl Heuristic,
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        let mut result = SearchResult { end: SearchEnd::Exhausted, expansions: 0, nearest: self.start };
        let mut pause = limits.next_pause(0);
        while let Some((key, node)) = self.open.first() {
            let (g, rhs) = self.known(self.start);
            if key >= self.key(bound, self.start) && rhs <= g {
                break;
            }
            if result.expansions >= pause {
                if let Some(end) = limits.stopped(result.expansions) {
                    result.end = end;
                    return result;
                }
                pause = limits.next_pause(result.expansions);
            }
            let now = self.key(bound, node);
            if key < now {
                // It was listed before the vehicle moved.
                self.open.set(node, now);
                continue;
            }
            result.expansions += 1;
            self.expand(graph, bound, node);
        }
        match self.known(self.start) {
            (_, INFINITE) if self.overflow => result.end = SearchEnd::Budget,
            (_, INFINITE) => {}
            (_, cost) => result.end = SearchEnd::Goal { node: self.goal, cost },
        }
        result
    }

    fn expand(&mut self, graph: &Graph<impl StepPrices>, bound: &impl Heuristic, node: u32) {
        let (g, rhs) = self.known(node);
        if g > rhs {
            self.put(node, (rhs, rhs));
            self.open.remove(node);
            for (beside, price) in graph.neighbours(node) {
                let (g, before) = self.known(beside);
                let promised = self.sum(rhs, price);
                if promised < before && beside != self.goal {
                    self.put(beside, (g, promised));
                    self.list(bound, beside);
                }
            }
        } else {
            self.put(node, (INFINITE, rhs));
            self.list(bound, node);
            for (beside, price) in graph.neighbours(node) {
                if self.known(beside).1 == g.saturating_add(price) {
                    self.mend(graph, bound, beside);
                }
            }
        }
    }

    fn search_with(
        &mut self,
        graph: &Graph<impl StepPrices>,
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        // Distances to where the vehicle is.
        let offset = Offset::to(graph.space, start);
        match graph.space.params().connectivity {
            Connectivity::Eight => {
                self.follow(graph, &Octile(offset), (start, goal));
                self.settle(graph, &Octile(offset), limits)
            }
            Connectivity::Four => {
                self.follow(graph, &Manhattan(offset), (start, goal));
                self.settle(graph, &Manhattan(offset), limits)
            }
        }
    }

    /// From the start, each time to the neighbour that promises most.
    fn descend(&self, graph: &Graph<impl StepPrices>, way: &mut Vec<u32>) {
        let mut node = self.start;
        // No way is longer than there are cells.
        while node != self.goal && way.len() <= graph.space.len() {
            way.push(node);
            let promised = |(next, price): (u32, u32)| (self.known(next).0.saturating_add(price), next);
            match graph.neighbours(node).map(promised).min() {
                Some((cost, next)) if cost != INFINITE => node = next,
                _ => return way.clear(),
            }
        }
        way.push(node);
    }
}

impl GridSolver for DStarLiteSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        if space.is_weighted() {
            self.search_with(&Graph::new(space, CostWeighted::of(space)), (start, goal), limits)
        } else {
            self.search_with(&Graph::new(space, Lengths), (start, goal), limits)
        }
    }

    /// Of the goal and the start.
    fn cost(&self, node: u32) -> Option<u32> {
        if node == self.start {
            return Some(0);
        }
        Some(self.known(self.start).1).filter(|&cost| node == self.goal && cost != INFINITE)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        way.clear();
        if node == self.start {
            way.push(node);
        } else if node == self.goal && space.is_weighted() {
            self.descend(&Graph::new(space, CostWeighted::of(space)), way);
        } else if node == self.goal {
            self.descend(&Graph::new(space, Lengths), way);
        }
    }
}

/// The space as it is searched.
#[derive(Debug, Clone, Copy)]
struct Graph<'a, P> {
    space: &'a GridSpace,
    prices: P,
    strides: [u32; 8],
}

impl<'a, P: StepPrices> Graph<'a, P> {
    fn new(space: &'a GridSpace, prices: P) -> Self {
        Self { space, prices, strides: space.strides() }
    }

    /// Neighbours of a node and what the steps to them cost, which is what those back do.
    #[inline]
    fn neighbours(&self, node: u32) -> impl Iterator<Item = (u32, u32)> {
        let (mut open, from) = (self.space.mask(node), self.prices.leaving(node));
        std::iter::from_fn(move || {
            let bit = open.trailing_zeros();
            let stride = self.strides.get(bit as usize)?;
            open &= open - 1;
            let next = node.wrapping_add(*stride);
            Some((next, self.prices.price(from, next, bit >= 4)))
        })
    }
}
