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
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    space::{GridParams, GridSpace},
    step::Step,
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
    records: Vec<Record>,
    generation: u32,
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

/// Valid if its generation is the solver's; otherwise nothing is known: both infinite.
#[derive(Debug, Clone, Copy, Default)]
struct Record {
    g: u32,
    rhs: u32,
    generation: u32,
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
        match self.records.get(node as usize) {
            Some(record) if record.generation == self.generation => (record.g, record.rhs),
            _ => (INFINITE, INFINITE),
        }
    }

    #[inline]
    fn put(&mut self, node: u32, (g, rhs): (u32, u32)) {
        if let Some(record) = self.records.get_mut(node as usize) {
            *record = Record { g, rhs, generation: self.generation };
        }
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
    fn promise(&mut self, space: &GridSpace, prices: &impl StepPrices, node: u32) -> u32 {
        let mut least = INFINITE;
        for (next, price) in neighbours(space, prices, node) {
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

    fn mend(&mut self, space: &GridSpace, prices: &impl StepPrices, bound: &impl Heuristic, node: u32) {
        if node != self.goal {
            let rhs = self.promise(space, prices, node);
            let (g, before) = self.known(node);
            if rhs != before {
                self.put(node, (g, rhs));
            }
            self.list(bound, node);
        }
    }

    /// Forgets everything but the goal.
    fn begin(&mut self, space: &GridSpace, bound: &impl Heuristic, goal: u32) {
        self.generation = self.generation.wrapping_add(1);
        if self.generation == 0 {
            self.records.fill(Record::default());
            self.generation = 1;
        }
        self.records.resize(space.len(), Record::default());
        self.open.reset(space.len());
        (self.goal, self.raised, self.overflow) = (goal, 0, false);
        self.put(goal, (INFINITE, 0));
        self.list(bound, goal);
    }

    /// Follows the space and the start, or begins anew.
    fn follow(
        &mut self,
        space: &GridSpace,
        prices: &impl StepPrices,
        bound: &impl Heuristic,
        (start, goal): (u32, u32),
    ) {
        let Some(layout) = space.layout() else { return };
        let size = (layout.width(), layout.height());
        let is_known = self.seen.is_some() && self.size == size && self.params == *space.params();
        let whole = CellRect::whole(size.0, size.1);
        let seen = self.seen.replace(space.revision().clone()).filter(|_| is_known);
        let changed = seen.map_or(Some(whole), |seen| space.changed_since(&seen));
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
        for y in min.y..=max.y {
            let first = y as usize * size.0;
            let cells = first + min.x as usize..=first + max.x as usize;
            if goes_on {
                self.mend_row(space, prices, bound, (y, min.x..=max.x));
            }
            self.masks[cells.clone()].copy_from_slice(&space.masks()[cells.clone()]);
            self.costs[cells.clone()].copy_from_slice(&space.costs()[cells]);
        }
    }

    /// Mends the cells of a row whose steps have changed.
    fn mend_row(
        &mut self,
        space: &GridSpace,
        prices: &impl StepPrices,
        bound: &impl Heuristic,
        (y, columns): (i32, std::ops::RangeInclusive<i32>),
    ) {
        for x in columns {
            let Some(node) = space.node(Cell::new(x, y)) else { continue };
            let (index, weighted) = (node as usize, space.is_weighted());
            if weighted && self.costs[index] != space.costs()[index] {
                // Steps to and from it cost something else.
                for step in Step::ALL {
                    if let Some(beside) = space.node(step.from(Cell::new(x, y))) {
                        self.mend(space, prices, bound, beside);
                    }
                }
                self.mend(space, prices, bound, node);
            } else if self.masks[index] != space.mask(node) {
                self.mend(space, prices, bound, node);
            }
        }
    }

    /// Expands until the start is known.
    fn settle(
        &mut self,
        space: &GridSpace,
        prices: &impl StepPrices,
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
            self.expand(space, prices, bound, node);
        }
        match self.known(self.start) {
            (_, INFINITE) if self.overflow => result.end = SearchEnd::Budget,
            (_, INFINITE) => {}
            (_, cost) => result.end = SearchEnd::Goal { node: self.goal, cost },
        }
        result
    }

    fn expand(&mut self, space: &GridSpace, prices: &impl StepPrices, bound: &impl Heuristic, node: u32) {
        let (g, rhs) = self.known(node);
        if g > rhs {
            self.put(node, (rhs, rhs));
            self.open.remove(node);
            for (beside, price) in neighbours(space, prices, node) {
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
            for (beside, price) in neighbours(space, prices, node) {
                if self.known(beside).1 == g.saturating_add(price) {
                    self.mend(space, prices, bound, beside);
                }
            }
        }
    }

    fn search_with(
        &mut self,
        space: &GridSpace,
        prices: &impl StepPrices,
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        // Distances to where the vehicle is.
        let offset = Offset::to(space, start);
        match space.params().connectivity {
            Connectivity::Eight => {
                self.follow(space, prices, &Octile(offset), (start, goal));
                self.settle(space, prices, &Octile(offset), limits)
            }
            Connectivity::Four => {
                self.follow(space, prices, &Manhattan(offset), (start, goal));
                self.settle(space, prices, &Manhattan(offset), limits)
            }
        }
    }

    /// From the start, each time to the neighbour that promises most.
    fn descend(&self, space: &GridSpace, prices: &impl StepPrices, way: &mut Vec<u32>) {
        let mut node = self.start;
        // No way is longer than there are cells.
        while node != self.goal && way.len() <= space.len() {
            way.push(node);
            let promised = |(next, price): (u32, u32)| (self.known(next).0.saturating_add(price), next);
            match neighbours(space, prices, node).map(promised).min() {
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
            self.search_with(space, &CostWeighted::of(space), (start, goal), limits)
        } else {
            self.search_with(space, &Lengths, (start, goal), limits)
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
            self.descend(space, &CostWeighted::of(space), way);
        } else if node == self.goal {
            self.descend(space, &Lengths, way);
        }
    }
}

/// Neighbours of a node and what the steps to them cost, which is what those back do.
#[inline]
fn neighbours<P: StepPrices>(space: &GridSpace, prices: &P, node: u32) -> impl Iterator<Item = (u32, u32)> {
    let (mut open, strides, from) = (space.mask(node), space.strides(), prices.leaving(node));
    std::iter::from_fn(move || {
        let bit = open.trailing_zeros();
        let stride = strides.get(bit as usize)?;
        open &= open - 1;
        let next = node.wrapping_add(*stride);
        Some((next, prices.price(from, next, bit >= 4)))
    })
}
