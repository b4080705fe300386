//! One way among several: a band, what it takes to optimise it, and what it is worth.

use super::{
    band::Band,
    line::{Ground, Line},
    problem::Problem,
    rollout::{Rollout, Task},
    sample::Sample,
    signature::Signature,
    solver::{BandReport, BandSolver},
};
use agv_core::Error;
use nalgebra::Vector2;
use std::f64::consts::PI;

/// Cycles after which a way that is blocked is given up for another.
const PATIENCE: u32 = 8;
/// How much farther another way must lead to be taken instead of one that is blocked, in metres.
const LEAST_GAIN: f64 = 0.3;
/// Cost, in seconds, of ways that are blocked; less by what of them is free, in metres.
const BLOCKED: f64 = 1e5;

/// One way, and the memory to find it.
#[derive(Debug, Clone)]
pub(super) struct Slot {
    pub(super) active: bool,
    pub(super) band: Band,
    pub(super) solver: BandSolver,
    pub(super) report: BandReport,
    pub(super) line: Line,
    pub(super) rollout: Rollout,
    pub(super) scratch: Vec<[f64; 4]>,
    pub(super) cost: f64,
    /// On which sides it passes the obstacles beside the path, in a cycle that explores.
    pub(super) signature: Signature,
}

impl Slot {
    pub(super) fn new() -> Self {
        Self {
            active: false,
            band: Band::new(),
            solver: BandSolver::default(),
            report: BandReport::default(),
            line: Line::default(),
            rollout: Rollout::default(),
            scratch: Vec::new(),
            cost: f64::INFINITY,
            signature: Signature::default(),
        }
    }
}

/// A band that is new: along the path, moved to the left of it where that is given.
pub(super) fn begin(
    slot: &mut Slot,
    samples: &[Sample],
    aside: Option<&[f64]>,
    ground: &Ground<'_>,
    scratch: &mut Vec<[f64; 4]>,
) {
    slot.active = true;
    slot.band.clear();
    let speed = ground.usual_speed();
    let place = |i: usize| {
        samples.get(i).map(|sample| {
            let offset = aside.and_then(|offsets| offsets.get(i)).copied().unwrap_or(0.0);
            sample.position + sample.across() * offset
        })
    };
    let last = samples.len().saturating_sub(1);
    for (i, sample) in samples.iter().enumerate() {
        let Some(position) = place(i) else { return };
        let length = place(i + 1).map_or(0.0, |next| (next - position).norm());
        // Along its own line, if that is not the path; the ends as they are given.
        let line = place(i + 1).zip(i.checked_sub(1).and_then(place)).map(|(b, a)| b - a);
        let yaw = match line {
            Some(line) if aside.is_some() && i < last && !ground.limits.is_holonomic() && line.norm() > 1e-6 => {
                line.y.atan2(line.x) + if ground.gear < 0.0 { PI } else { 0.0 }
            }
            _ => sample.yaw,
        };
        slot.band.push(position, yaw, (length / speed).max(0.02));
    }
    slot.band.resize(ground.params.spacing, ground.params.turn, scratch);
}

/// Optimises a band, in several rounds with resizing between them, and rolls it out.
pub(super) fn improve(
    slot: &mut Slot,
    problem: &Problem<'_>,
    task: &Task<'_>,
    iterations: usize,
    rounds: usize,
) -> Result<(), Error> {
    let params = problem.params;
    let mut report = BandReport::default();
    for round in 0..rounds {
        slot.band.resize(params.spacing, params.turn, &mut slot.scratch);
        let part = slot.solver.solve(problem, &mut slot.band, iterations.div_ceil(rounds));
        let first = if round == 0 { part.cost[0] } else { report.cost[0] };
        report = BandReport { cost: [first, part.cost[1]], iterations: report.iterations + part.iterations, ..part };
    }
    slot.report = report;
    slot.line.set(slot.band.nodes(), &task.ground, !problem.obstacles.is_empty());
    let length = slot.line.length();
    let mut touch = None;
    for share in [1.0, 0.5] {
        slot.line.plan_stop(length, share, &task.ground);
        slot.rollout.follow(task, &slot.line)?;
        if slot.rollout.is_free() {
            slot.cost = slot.rollout.trajectory().duration();
            return Ok(());
        }
        touch = slot.rollout.touch();
    }
    // As far as it goes.
    let mut stop = touch.map_or(0.0, |touch| touch.arc_length);
    slot.cost = 2.0 * BLOCKED - stop;
    for _ in 0..3 {
        stop -= 0.08;
        slot.line.stop_at(stop, touch.map(|touch| touch.reason), &task.ground);
        slot.rollout.follow(task, &slot.line)?;
        match slot.rollout.touch() {
            Some(touch) if stop > 0.0 => stop = stop.min(touch.arc_length),
            _ => break,
        }
    }
    Ok(())
}

/// The best way: the present one, unless it is blocked for long or another is much better.
pub(super) fn choose(slots: &[Slot], current: Option<usize>, switch_share: f64, blocked: u32) -> Option<usize> {
    let others = || slots.iter().enumerate().filter(|(i, slot)| slot.active && Some(*i) != current);
    let cheapest = |a: &(usize, &Slot), b: &(usize, &Slot)| a.1.cost.total_cmp(&b.1.cost);
    let Some(now) = current else { return others().min_by(cheapest).map(|(i, _)| i) };
    let present = &slots[now];
    let is_same = |slot: &Slot| present.signature == slot.signature;
    if present.is_passable() {
        let enough = switch_share * present.cost;
        let better = others().filter(|(_, slot)| slot.cost < enough && !is_same(slot)).min_by(cheapest);
        return Some(better.map_or(now, |(i, _)| i));
    }
    // The same way found anew is taken at once.
    let anew = others().filter(|(_, slot)| slot.is_passable() && is_same(slot)).min_by(cheapest);
    if let Some((again, _)) = anew {
        return Some(again);
    }
    let better = others().filter(|(_, slot)| slot.cost < present.cost - LEAST_GAIN).min_by(cheapest);
    Some(better.filter(|_| blocked >= PATIENCE).map_or(now, |(i, _)| i))
}

impl Slot {
    /// Says on which sides of some obstacles the band passes, on its way to `end`.
    pub(super) fn sign(&mut self, end: &Vector2<f64>, obstacles: &[Vector2<f64>]) {
        self.signature.set(self.band.nodes(), end, obstacles);
    }

    /// Whether the whole way can be driven.
    pub(super) fn is_passable(&self) -> bool {
        self.cost < BLOCKED
    }
}
