//! The graph that is searched: cells and headings, each with the pose by which it was reached.
//!
//! A node is a cell of the coarse grid and a heading. The pose in it is exact, not its centre: motions join without a gap.
//! The cheapest pose of a node stands for all others; once expanded it stays, so that no later way can cut a path in two.

use super::{
    UNIT,
    gate::{Gate, GateFinder},
    motion::{LENGTHS, Leg, Motion, Wheels},
    params::HybridAStarParams,
    shot::Curves,
    site::Site,
};
use crate::grid::{Frontier, Known, NodeStore, Reached, SearchSpace};
use agv_core::{
    Error, check,
    geometry::{Se2, Twist2},
};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// How a node was reached.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    pub(super) pose: Se2,
    pub(super) parent: u32,
    /// Number of the motion; none at the start.
    pub(super) motion: u8,
    /// Its successors were told: it stays as it is.
    closed: bool,
}

/// Stands for no motion.
const START: u8 = u8::MAX;

/// Number of the first gate; the motions', of which there are 38 at the most in each length, come before.
const FIRST_GATE: u8 = 128;
const _: () = assert!(GateFinder::MOST < (START - FIRST_GATE) as usize && 38 * LENGTHS.len() < FIRST_GATE as usize);

/// Turning radii from a gate within which every expansion tries a curve to it.
const NEAR_GATE: f64 = 4.0;

impl Default for Arrival {
    fn default() -> Self {
        Self { pose: Se2::default(), parent: u32::MAX, motion: START, closed: false }
    }
}

/// The lattice over a site.
pub(super) struct Lattice<'a> {
    params: &'a HybridAStarParams,
    motions: &'a [Motion],
    site: &'a Site,
    start: Se2,
    /// Places where the search may go on by a curve, and the curves.
    gates: Option<(&'a [Gate], &'a Curves)>,
    width: usize,
    height: usize,
    block: f64,
    nodes: usize,
    /// Whether shorter motions are tried near start and goal where the whole ones are blocked.
    fine: bool,
}

impl<'a> Lattice<'a> {
    /// The lattice for a start.
    ///
    /// # Errors
    /// More nodes than can be numbered, or cells that a step does not leave.
    pub(super) fn new(
        params: &'a HybridAStarParams,
        motions: &'a [Motion],
        site: &'a Site,
        start: Se2,
    ) -> Result<Self, Error> {
        let (width, height, block) = site.coarse_size();
        let least = HybridAStarParams::STEP_PER_CELL * block as f64 * site.layout().resolution() * (1.0 - 1e-9);
        check::in_range("step (the map's cells are too large)", params.step, least, f64::MAX)?;
        let nodes = width.saturating_mul(height).saturating_mul(usize::from(params.headings));
        let max = u32::MAX as usize;
        if nodes >= max {
            return Err(Error::TooMany { name: "cells and headings", len: nodes, max });
        }
        Ok(Self { params, motions, site, start, gates: None, width, height, block: block as f64, nodes, fine: false })
    }

    /// The same lattice, with shorter motions near start and goal.
    pub(super) const fn with_fine(mut self, fine: bool) -> Self {
        self.fine = fine;
        self
    }

    /// The same lattice, with curves to gates.
    pub(super) const fn with_gates(mut self, gates: &'a [Gate], curves: &'a Curves) -> Self {
        self.gates = Some((gates, curves));
        self
    }

    pub(super) const fn params(&self) -> &HybridAStarParams {
        self.params
    }

    /// Node of a pose; none off the map.
    #[inline]
    pub(super) fn node(&self, pose: &Se2) -> Option<u32> {
        let cell = self.cell(&pose.translation())?;
        let headings = i32::from(self.params.headings);
        let heading = (pose.yaw() / TAU * f64::from(headings)).round() as i32;
        Some(cell * headings as u32 + heading.rem_euclid(headings) as u32)
    }

    /// Coarse cell of a point; none off the map.
    #[inline]
    pub(super) fn cell(&self, point: &Vector2<f64>) -> Option<u32> {
        let at = self.site.layout().to_grid(point) / self.block;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.width as f64 && at.y < self.height as f64;
        inside.then(|| at.y as u32 * self.width as u32 + at.x as u32)
    }

    /// Centre of a coarse cell, in the map.
    #[inline]
    pub(super) fn center(&self, cell: u32) -> Vector2<f64> {
        let (x, y) = (cell % self.width as u32, cell / self.width as u32);
        self.site.layout().to_map(&(Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) * self.block))
    }

    /// Pose of a node that was reached.
    #[inline]
    pub(super) fn pose(&self, arrival: &Arrival) -> Se2 {
        if arrival.motion == START { self.start } else { arrival.pose }
    }

    /// The motion by which a node was reached; of a curve through a gate, that through the gate.
    pub(super) fn motion(&self, arrival: &Arrival) -> Option<&Motion> {
        match self.gate(arrival) {
            Some((gate, _)) => Some(&gate.lane),
            None => self.motions.get(usize::from(arrival.motion)),
        }
    }

    fn gate(&self, arrival: &Arrival) -> Option<(&'a Gate, &'a Curves)> {
        let number = arrival.motion.checked_sub(FIRST_GATE)?;
        self.gates.and_then(|(gates, curves)| gates.get(usize::from(number)).map(|gate| (gate, curves)))
    }

    /// Appends the legs from one node to the next.
    pub(super) fn legs_between(&self, from: &Arrival, to: &Arrival, legs: &mut Vec<Leg>) {
        let start = self.pose(from);
        if let Some((gate, curves)) = self.gate(to) {
            if let Some(curve) = curves.cheapest(&start, &gate.entry) {
                legs.extend(curves.legs(&start, &curve));
            }
            legs.push(gate.leg());
        } else if let Some(motion) = self.motion(to) {
            legs.push(Leg { start, twist: motion.twist, length: motion.length });
        }
    }

    /// Tries the cheapest curve to each gate that is near, and through it.
    fn expand_to_gates(&self, at: &Reached<Arrival>, pose: &Se2, frontier: &mut impl Frontier<Arrival>) {
        let Some((gates, curves)) = self.gates else { return };
        let before = self.motion(&at.link).map(|motion| motion.twist);
        for (gate, number) in gates.iter().zip(FIRST_GATE..START) {
            let distance = (gate.entry.translation() - pose.translation()).norm();
            if distance > NEAR_GATE * self.params.turning_radius {
                continue;
            }
            let Some(node) = self.node(&gate.exit) else { continue };
            let known = frontier.known(node);
            let units = |cost: f64| at.cost.saturating_add((cost * UNIT).round() as u32);
            let is_useless = |cost: f64| known.is_some_and(|known| known.link.closed || known.cost <= units(cost));
            // What each look says is less than what the next one does.
            if is_useless(distance + gate.lane.length) {
                continue;
            }
            let Some(curve) = curves.cheapest(pose, &gate.entry) else { continue };
            if is_useless(curve.cost(&self.params.weights()) + gate.lane.length) {
                continue;
            }
            let cost = self.cost_of(before, curves.legs(pose, &curve).chain([gate.leg()]));
            if is_useless(cost)
                || !curves.legs(pose, &curve).all(|leg| self.site.is_free_along(&leg.start, &leg.twist, leg.length))
            {
                continue;
            }
            frontier.reach(
                node,
                units(cost),
                Arrival { pose: gate.exit, parent: at.node, motion: number, closed: false },
            );
        }
    }

    /// Price of a metre on a stretch, as if all of it cost what its middle and end do.
    #[inline]
    fn price(&self, twist: &Twist2, middle: &Se2, end: &Se2) -> f64 {
        let direction = if twist.vx < 0.0 { self.params.reverse_weight } else { 1.0 };
        if self.params.cost_weight == 0.0 {
            return direction;
        }
        direction * (1.0 + self.params.cost_weight * 0.5 * (self.site.cost_at(middle) + self.site.cost_at(end)))
    }

    /// Cost of turning the wheels and changing gear between two motions, in metres.
    #[inline]
    fn change(&self, before: &Twist2, after: &Twist2) -> f64 {
        let turned = Wheels::of(before).change(&Wheels::of(after), self.params.turning_radius);
        self.params.steering_change * turned + if before.vx * after.vx < 0.0 { self.params.gear_change } else { 0.0 }
    }

    /// Cost of legs driven one after another, after a motion, in metres.
    pub(super) fn cost_of(&self, before: Option<Twist2>, legs: impl IntoIterator<Item = Leg>) -> f64 {
        let (mut cost, mut before) = (0.0, before);
        for leg in legs {
            cost += before.map_or(0.0, |before| self.change(&before, &leg.twist));
            before = Some(leg.twist);
            // In stretches of a step, as the search counts.
            let pieces =
                if self.params.cost_weight > 0.0 { (leg.length / self.params.step).ceil().max(1.0) } else { 1.0 };
            let length = leg.length / pieces;
            for i in 0..pieces as u32 {
                let from = f64::from(i) * length;
                cost += length * self.price(&leg.twist, &leg.at(from + 0.5 * length), &leg.at(from + length));
            }
        }
        cost
    }
}

impl SearchSpace for Lattice<'_> {
    type Link = Arrival;

    fn node_count(&self) -> usize {
        self.nodes
    }

    fn max_step(&self) -> u32 {
        let params = self.params;
        let dearest = params.step * params.reverse_weight * (1.0 + params.cost_weight);
        let change = params.gear_change + params.steering_change * 4.0;
        ((dearest + change) * UNIT).min(f64::from(u32::MAX / 4)) as u32
    }

    fn expand(&self, at: Reached<Arrival>, frontier: &mut impl Frontier<Arrival>) {
        let pose = self.pose(&at.link);
        let before = self.motion(&at.link);
        self.expand_to_gates(&at, &pose, frontier);
        // Out of a tight place, and into one, the shorter motions; elsewhere they cost more than they find.
        let tried =
            if self.fine && self.site.is_near_end(&pose, self.params.turning_radius) { LENGTHS.len() } else { 1 };
        for (kind, lengths) in self.motions.chunks_exact(LENGTHS.len()).enumerate() {
            for (number, motion) in lengths.iter().enumerate().take(tried) {
                let end = pose * motion.end;
                let Some(node) = self.node(&end) else { continue };
                if !self.site.coarse().is_passable(node / u32::from(self.params.headings)) {
                    continue;
                }
                let mut cost = motion.length * self.price(&motion.twist, &(pose * motion.middle), &end);
                if let Some(before) = before {
                    cost += if before.gear == motion.gear { 0.0 } else { self.params.gear_change };
                    cost +=
                        self.params.steering_change * before.wheels.change(&motion.wheels, self.params.turning_radius);
                }
                let cost = at.cost.saturating_add((cost * UNIT).round() as u32);
                // What is known to be useless is not checked for collisions; a shorter one may yet be of use.
                let is_useless = |known: Known<Arrival>| known.link.closed || known.cost <= cost;
                if frontier.known(node).is_some_and(is_useless) {
                    continue;
                }
                if self.site.is_free_along(&pose, &motion.twist, motion.length) {
                    let number = (LENGTHS.len() * kind + number) as u8;
                    frontier.reach(node, cost, Arrival { pose: end, parent: at.node, motion: number, closed: false });
                    break;
                }
            }
        }
    }

    fn predecessor(&self, _: u32, link: Arrival) -> Option<u32> {
        (link.motion != START).then_some(link.parent)
    }

    #[inline]
    fn settle(&self, at: Reached<Arrival>, _: &impl NodeStore<Arrival>) -> Option<Known<Arrival>> {
        Some(Known { cost: at.cost, link: Arrival { closed: true, ..at.link } })
    }
}
