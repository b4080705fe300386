//! Following a section of the path: which bands there are, which is followed, and what of it may be done.

use super::{
    line::Ground,
    planner::{Choice, Teb},
    problem::Problem,
    rollout::Task,
    sample::{Sample, is_nearby, sample},
    slot::{begin, choose, improve},
};
use crate::local::Verdict;
use agv_core::{
    geometry::{Twist2, angle_difference},
    roles::{BlockReason, LocalPlanError, LocalPlanRequest, LocalPlanStatus},
};
use nalgebra::Vector2;
use std::f64::consts::PI;

/// Length of road, in metres, over which the direction to set out in is read.
const SET_OUT: f64 = 0.5;
/// Angles between heading and path from which on the vehicle turns on the spot, and to which it then does, in radians.
const TURN_FROM: f64 = 1.2;
const TURN_TO: f64 = 0.2;
/// Cycles between explorations of other ways while the present one is free.
const EXPLORE_EVERY: u32 = 10;
/// Shares of the greatest speeds that are tried, if what was rolled out may not be begun.
const SPEED_SHARES: [f64; 3] = [0.5, 0.3, 0.15];
/// How far from the band a vehicle may be for the band to go on, in metres.
const REACH: f64 = 0.5;

impl Teb {
    /// Follows the best band along the present section.
    pub(super) fn drive(
        &mut self,
        request: &LocalPlanRequest<'_>,
        progress: f64,
        gear: f64,
        changed: bool,
    ) -> Result<(Choice, LocalPlanStatus), LocalPlanError> {
        let params = &self.params;
        let ground = Ground::new(params, &self.circles, request, gear);
        let holonomic = ground.limits.is_holonomic();
        let stops = sample(&self.course, request, &ground, progress, &self.points, &mut self.samples);
        if self.samples.len() < 2 {
            self.brake(request)?;
            return Ok((Choice::Hold, LocalPlanStatus::Blocked(BlockReason::Obstacle)));
        }
        // The band of the last cycle, its end moved along.
        let warm = !self.last.is_empty() && self.take_last(request);
        if !warm {
            self.last.clear();
        }
        let turns = request.limits.turns_on_the_spot() && !holonomic;
        if let (true, Some(heading)) = (turns, self.must_turn(request, gear, warm))
            && self.try_turn(request, heading)?
        {
            self.turning = Some(heading);
            self.last.clear();
            return Ok((Choice::Hold, LocalPlanStatus::Following));
        }
        self.turning = None;
        let Self { params, circles, samples, lanes, offsets, scratch, slots, last, .. } = self;
        let ground = Ground::new(params, circles, request, gear);
        let task = Task { request, footprint: &params.footprint, ground };
        let problem = Problem {
            params,
            limits: request.limits,
            map: request.map,
            circles,
            obstacles: request.obstacles,
            gear: if holonomic { 0.0 } else { gear },
            start: request.state.twist,
            stops,
            // From nearby a vehicle that turns on the spot need not arrive with the heading.
            goal_heading: (stops && !(request.limits.turns_on_the_spot() && is_nearby(samples, params.spacing)))
                || holonomic,
            via: &self.via,
            rotation: self.rotation,
        };
        let mut current = None;
        if warm {
            let slot = &mut slots[0];
            slot.band.copy_from(last);
            slot.active = true;
            improve(slot, &problem, &task, params.warm_iterations, 1)?;
            current = Some(0);
        }
        let current_is_free = current.is_some_and(|i| slots[i].is_passable());
        self.blocked = if current_is_free { 0 } else { self.blocked + 1 };
        if !current_is_free || changed || self.cycle.is_multiple_of(EXPLORE_EVERY) {
            begin(&mut slots[1], samples, None, &ground, scratch);
            lanes.search(samples, &ground, request.obstacles, params.max_ways);
            let ways = if lanes.is_path_free() { 0 } else { lanes.count() };
            for (way, slot) in slots[2..].iter_mut().enumerate().take(ways) {
                lanes.offsets(way, params.spacing, offsets);
                begin(slot, samples, Some(offsets), &ground, scratch);
            }
            let goal = samples.last().map_or_else(Vector2::zeros, |sample| sample.position);
            for slot in slots.iter_mut().filter(|slot| slot.active) {
                slot.sign(&goal, lanes.obstacles());
            }
            // What would come to the same way again need not be optimised.
            if current_is_free {
                let (now, others) = slots.split_at_mut(1);
                for slot in others {
                    slot.active &= now.iter().all(|now| now.signature != slot.signature);
                }
            }
            let obstacles = lanes.obstacles();
            let iterations = params.cold_iterations;
            self.par.for_each_chunk(&mut slots[1..], 1, |_, chunk| {
                for slot in chunk.iter_mut().filter(|slot| slot.active) {
                    if improve(slot, &problem, &task, iterations, 2).is_err() {
                        slot.cost = f64::INFINITY;
                    }
                    slot.sign(&goal, obstacles);
                }
            });
        }
        let best = choose(slots, current, params.switch_share, self.blocked);
        let Some(best) = best else {
            self.brake(request)?;
            return Ok((Choice::Hold, LocalPlanStatus::Blocked(BlockReason::Obstacle)));
        };
        last.copy_from(&slots[best].band);
        self.release(request, gear, best)
    }

    /// What of a way may be done: after its first motion the vehicle must be able to brake, however the roll-out goes on.
    fn release(
        &mut self,
        request: &LocalPlanRequest<'_>,
        gear: f64,
        best: usize,
    ) -> Result<(Choice, LocalPlanStatus), LocalPlanError> {
        let Self { params, circles, slots, guard, .. } = self;
        let ground = Ground::new(params, circles, request, gear);
        let task = Task { request, footprint: &params.footprint, ground };
        let slot = &mut slots[best];
        let mut verdict = Verdict::Clear;
        for share in std::iter::once(None).chain(SPEED_SHARES.map(Some)) {
            if let Some(share) = share {
                slot.line.slow_down(share, &task.ground);
                slot.rollout.follow(&task, &slot.line)?;
            }
            let Some(motion) = slot.rollout.first() else { break };
            let begins_freely = slot.rollout.touch().is_none_or(|_| slot.rollout.trajectory().len() > 1);
            verdict = guard.check_trusted(request, &motion)?;
            if verdict.is_clear() && begins_freely {
                let reason = slot.rollout.blocked().or(slot.line.stopped());
                // An estimate of a vehicle at rest is hardly ever zero.
                let status = match reason {
                    Some(reason) if motion.twist == Twist2::ZERO => LocalPlanStatus::Blocked(reason),
                    _ => LocalPlanStatus::Following,
                };
                return Ok((Choice::Follow(best), status));
            }
        }
        let reason = match verdict {
            Verdict::Blocked(reason) => reason,
            Verdict::Clear => slot.rollout.blocked().unwrap_or(BlockReason::Obstacle),
        };
        self.brake(request)?;
        Ok((Choice::Hold, LocalPlanStatus::Blocked(reason)))
    }

    /// Moves the band of the last cycle to the vehicle and along the path; false if it is of no use any more.
    fn take_last(&mut self, request: &LocalPlanRequest<'_>) -> bool {
        if !self.last.begin_at(&request.state.map_from_base, REACH) {
            return false;
        }
        let Some(goal) = self.samples.last().copied() else { return false };
        // Where the band joins the path ahead: from its end backwards.
        let square = |node: &[f64; 4], sample: &Sample| {
            (node[0] - sample.position.x).powi(2) + (node[1] - sample.position.y).powi(2)
        };
        let mut len = self.last.len();
        while len > 1 {
            let Some(node) = self.last.nodes().get(len - 1) else { return false };
            let samples = self.samples.iter().enumerate().skip(1);
            let nearest = samples.map(|(i, s)| (i, square(node, s))).min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((join, distance)) = nearest else { return false };
            if distance <= REACH * REACH {
                self.last.truncate(len);
                let interval = self.last.nodes().get(len - 2).map_or(0.1, |node| node[3]);
                let spacing = self.params.spacing;
                // The end itself is replaced: it was tied to where the path was then.
                if join + 1 < self.samples.len() {
                    if let Some(last) = self.last.nodes_mut().last_mut() {
                        last[3] = interval.max(0.02);
                    }
                    for sample in self.samples.iter().skip(join + 1) {
                        let before = self.last.nodes().last().copied().unwrap_or_default();
                        let time = interval * (sample.position - Vector2::new(before[0], before[1])).norm() / spacing;
                        self.last.push(sample.position, sample.yaw, time.max(0.02));
                    }
                }
                self.last.set_last(goal.position, goal.yaw);
                return self.last.len() >= 2;
            }
            len -= 1;
        }
        false
    }

    /// The heading to turn to before driving; none if the vehicle faces about there.
    fn must_turn(&self, request: &LocalPlanRequest<'_>, gear: f64, warm: bool) -> Option<f64> {
        let pose = request.state.map_from_base;
        let at = pose.translation();
        let ahead = if warm {
            let far = |node: &&[f64; 4]| (Vector2::new(node[0], node[1]) - at).norm() >= SET_OUT;
            let node = self.last.nodes().iter().find(far).or(self.last.nodes().last())?;
            Vector2::new(node[0], node[1])
        } else {
            let far = |sample: &&Sample| (sample.position - at).norm() >= SET_OUT;
            self.samples.iter().find(far).or(self.samples.last())?.position
        };
        let line = ahead - at;
        let heading = if gear < 0.0 { line.y.atan2(line.x) + PI } else { line.y.atan2(line.x) };
        let askew = angle_difference(heading, pose.yaw()).abs();
        let limit = if self.turning.is_some() { TURN_TO } else { TURN_FROM };
        (askew > limit).then_some(heading)
    }
}
