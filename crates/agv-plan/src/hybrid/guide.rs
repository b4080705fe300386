//! How far it is to the goal, estimated: the larger of what two look-ups say.
//!
//! One knows the obstacles and not the vehicle: the potential of the goal on the coarse grid of the [`Site`], Dijkstra's
//! algorithm from the goal outwards. Ways of eight directions are up to 8 % longer than straight ones, so it may say more than
//! is left to go. It is run only as far as it is asked for: beyond its horizon, the horizon is the estimate. The other knows
//! the vehicle and not the obstacles: the table of curves. (Dolgov et al. 2010, section 3.1)

use super::{UNIT, lattice::Lattice, site::Site, table::CurveTable};
use crate::grid::{BucketQueue, DenseNodes, Heuristic, STRAIGHT, SearchSpace, Step, Workspace, Zero};
use agv_core::geometry::{LieGroup, Se2};
use std::f64::consts::TAU;

/// The potential of one goal, as far as it was computed.
///
/// It is kept from query to query, but what a query sees of it ends at its own horizon, which follows from the costs alone:
/// the answer to a query does not depend on those before.
#[derive(Debug, Clone, Default)]
pub(super) struct Potential {
    workspace: Workspace<Step, BucketQueue, DenseNodes<Step>>,
    goal: Option<u32>,
    /// Costs below this one are final.
    known: u32,
    /// As far as this query looks.
    horizon: u32,
    /// Units of the search per unit of the grid's costs.
    scale: f64,
}

impl Potential {
    /// Another map: what was computed says nothing of it.
    pub(super) const fn forget(&mut self) {
        self.goal = None;
    }

    /// Begins a query; what is known is kept if its goal is the same.
    pub(super) fn begin(&mut self, site: &Site, goal: u32) {
        self.horizon = 0;
        if self.goal == Some(goal) {
            return;
        }
        let space = site.coarse();
        let (_, _, block) = site.coarse_size();
        self.scale = UNIT * site.layout().resolution() * block as f64 / f64::from(STRAIGHT);
        self.goal = Some(goal);
        self.known = 0;
        if space.is_weighted() {
            self.workspace.begin(&space.weighted());
        } else {
            self.workspace.begin(&space.uniform());
        }
        self.workspace.add_start(&Zero, goal, 0);
    }

    /// Moves the horizon until the cost of a cell is known, and by a share further.
    pub(super) fn reach(&mut self, site: &Site, node: u32) {
        let cost = self.final_cost(node);
        if self.horizon == u32::MAX || cost.is_some_and(|cost| cost < self.horizon) {
            return;
        }
        if site.coarse().is_weighted() {
            self.flood(&site.coarse().weighted(), node);
        } else {
            self.flood(&site.coarse().uniform(), node);
        }
    }

    fn final_cost(&self, node: u32) -> Option<u32> {
        self.workspace.cost(node).filter(|&cost| cost < self.known)
    }

    fn flood(&mut self, space: &impl SearchSpace<Link = Step>, node: u32) {
        while self.final_cost(node).is_none() && self.workspace.expand_next(space, &Zero).is_some() {
            self.known = self.workspace.least_key().unwrap_or(u32::MAX);
        }
        // A cell that nothing joins to the goal is known by all others being known.
        let end =
            self.final_cost(node).map_or(u32::MAX, |cost| cost.saturating_add(cost / 4).saturating_add(20 * STRAIGHT));
        while self.known <= end && self.workspace.expand_next(space, &Zero).is_some() {
            self.known = self.workspace.least_key().unwrap_or(u32::MAX);
        }
        self.horizon = self.horizon.max(end);
    }

    /// Writes the way from the goal to a coarse cell that was reached for, both included; empty if nothing joins the two.
    pub(super) fn way_into(&self, site: &Site, node: u32, way: &mut Vec<u32>) {
        way.clear();
        if self.final_cost(node).is_none() {
            return;
        }
        if site.coarse().is_weighted() {
            self.workspace.trace_into(&site.coarse().weighted(), node, way);
        } else {
            self.workspace.trace_into(&site.coarse().uniform(), node, way);
        }
    }

    /// Estimate for a coarse cell, in units of the search.
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        // Beyond the horizon a cost may not be final yet, and is not looked at.
        let cost = self.workspace.cost(node).unwrap_or(u32::MAX).min(self.horizon);
        (f64::from(cost) * self.scale) as u32
    }
}

/// Both estimates for one goal.
pub(super) struct Guide<'a> {
    potential: &'a Potential,
    table: &'a CurveTable,
    lattice: &'a Lattice<'a>,
    goal_from_map: Se2,
    goal_heading: f64,
    /// Cost of a turn by one heading.
    per_heading: f64,
    weight: f64,
}

impl<'a> Guide<'a> {
    pub(super) fn new(potential: &'a Potential, table: &'a CurveTable, lattice: &'a Lattice<'a>, goal: &Se2) -> Self {
        let params = lattice.params();
        let per_heading = UNIT * params.turning_radius * TAU / f64::from(params.headings);
        let goal_heading = goal.yaw() / TAU * f64::from(params.headings);
        Self {
            potential,
            table,
            lattice,
            goal_from_map: goal.inverse(),
            goal_heading,
            per_heading,
            weight: params.heuristic_weight,
        }
    }
}

impl Heuristic for Guide<'_> {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        let headings = u32::from(self.lattice.params().headings);
        let (cell, heading) = (node / headings, node % headings);
        let point = self.goal_from_map.act(&self.lattice.center(cell));
        let turn = (f64::from(heading) - self.goal_heading).round() as i32;
        let turn = turn.rem_euclid(headings as i32);
        let curve = self.table.cost(point.x, point.y, turn);
        // Less half a heading at either end, which the lattice rounds away.
        let turning = (f64::from(turn.min(headings as i32 - turn) - 1) * self.per_heading).max(0.0) as u32;
        let most = self.potential.estimate(cell).max(curve).max(turning);
        (f64::from(most) * self.weight) as u32
    }
}
