//! The planner: sample, roll out, score, and take the best that the guard lets pass.

use super::{
    DwaParams,
    window::{Window, samples, steering_angle},
};
use crate::{
    Error,
    local::{
        Drive, Guard, NavigationField, Reference, Task, Trajectories, Verdict, check_request,
        critics::{Critic, Oscillation, PreferForward, Progress, Scene, score},
    },
};
use agv_core::{
    geometry::{LieGroup, Twist2},
    kinematics::{Motion, rise, stopping_speed},
    roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner},
};
use nalgebra::Vector2;

/// The dynamic window approach; plays [`LocalPlanner`].
///
/// It needs no inflation: the map's lethal cells are what it keeps away from.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams};
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_core::roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState};
/// use agv_plan::dwa::{Dwa, DwaParams};
///
/// // A pallet stands on the path.
/// let mut map = Grid::filled(GridLayout::new(160, 80, 0.05, Se2::default())?, CellState::Free);
/// (36..46).for_each(|y| (70..80).for_each(|x| drop(map.set(Cell::new(x, y), CellState::Occupied))));
/// let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default())?;
/// let path = Path::from_positions(&[Vector2::new(1.0, 2.0), Vector2::new(7.0, 2.0)])?;
/// let limits = MotionLimits::default();
/// let mut dwa = Dwa::new(DwaParams::for_footprint(&Footprint::rectangle(-0.3, 0.3, 0.4)?))?;
/// let mut state = VehicleState::new(Se2::new(1.0, 2.0, 0.0), Twist2::ZERO);
/// for _ in 0..300 {
///     let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.1 };
///     let command = dwa.command(request)?;
///     state = state.after(&command.motion, 0.1);
///     if command.status == LocalPlanStatus::Arrived {
///         break;
///     }
/// }
/// assert!((state.map_from_base.translation() - Vector2::new(7.0, 2.0)).norm() < 0.2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Dwa {
    params: DwaParams,
    guard: Guard,
    reference: Reference,
    field: NavigationField,
    batch: Trajectories,
    critics: Vec<Critic>,
    totals: Vec<f32>,
    scratch: Vec<f32>,
    order: Vec<u32>,
    /// Commands that the guard refused in this cycle.
    refused: Vec<Motion>,
    /// Why the last one was refused.
    reason: BlockReason,
    speeds: Vec<f64>,
    turns: Vec<f64>,
    /// What was aimed at last.
    last: Twist2,
    progress: Patience,
}

/// How long there has been no progress.
#[derive(Debug, Clone, Copy, Default)]
struct Patience {
    /// Least that remained, in metres, and time of driving since then, in seconds: who stands for somebody does not lose it.
    least: f64,
    waited: f64,
}

/// How much farther from the target than the vehicle the field is known, in metres: for backing up.
const BEHIND: f64 = 1.5;

/// Way that counts as progress, in metres.
const PROGRESS: f64 = 0.05;

/// How much closer, in cells, a vehicle that cannot get on may come to what looks like an obstacle.
const RELAXED: f32 = 1.0;

/// Commands that the guard may refuse in one cycle.
const MOST_CHECKED: usize = 64;

impl Dwa {
    /// The planner with the critics that measured best: [`Progress`] on the navigation field, a little faithfulness to the side that was
    /// chosen, and a dislike of backing up.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: DwaParams) -> Result<Self, Error> {
        let critics = vec![
            Critic::new(1.0, Progress::new(0.6, 0.1, 0.5, 0.3)),
            Critic::new(0.05, Oscillation),
            Critic::new(0.5, PreferForward),
        ];
        Self::with_critics(params, critics)
    }

    /// The planner with critics of one's own.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn with_critics(params: DwaParams, critics: Vec<Critic>) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            guard: Guard::new(params.footprint.clone(), params.guard)?,
            reference: Reference::new(params.reference)?,
            field: NavigationField::new(params.field)?,
            batch: Trajectories::default(),
            critics,
            totals: Vec::new(),
            scratch: Vec::new(),
            order: Vec::new(),
            refused: Vec::with_capacity(MOST_CHECKED),
            reason: BlockReason::Obstacle,
            speeds: Vec::new(),
            turns: Vec::new(),
            last: Twist2::ZERO,
            progress: Patience::default(),
            params,
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &DwaParams {
        &self.params
    }

    /// The trajectories of the last cycle.
    pub const fn trajectories(&self) -> &Trajectories {
        &self.batch
    }

    /// What they cost, in the same order; infinite for those that were ruled out.
    pub fn costs(&self) -> &[f32] {
        &self.totals
    }

    /// The distances to the target, and the way to it, of the last cycle.
    pub const fn field(&self) -> &NavigationField {
        &self.field
    }

    /// Forgets the path and all that was chosen on it.
    pub fn reset(&mut self) {
        self.reference.reset();
        self.field.forget();
        self.last = Twist2::ZERO;
    }

    /// Where on the path the way of this cycle should lead: as far as planned if the vehicle can be there and there is a way, else
    /// nearer. The distance field is that of the answer.
    fn aim(&mut self, drive: &Drive, position: &Vector2<f64>) -> Option<(Vector2<f64>, bool)> {
        let from = drive.projection.arc_length;
        let mut tried = 0;
        let ahead = drive.to_stop().min(self.params.look_ahead);
        // Then beyond what closes the path, then nearer.
        for share in [1.0, 1.5, 0.6, 0.3] {
            let mut arc_length = (from + share * self.params.look_ahead).min(drive.stop);
            let nearest = from + 0.2 * share * ahead;
            while arc_length >= nearest {
                let (point, _) = self.reference.course().point_at(arc_length)?;
                if self.field.is_open(&point) {
                    tried += 1;
                    if self.field.compute(&point, position, BEHIND) {
                        return Some((point, arc_length >= drive.stop));
                    }
                    break;
                }
                arc_length -= self.params.field.resolution;
            }
            if tried > 2 {
                break;
            }
        }
        None
    }

    /// The next bend of the path, or its end: the key node that leads the way.
    fn key_node(&self, drive: &Drive) -> Option<Vector2<f64>> {
        let course = self.reference.course();
        let (mut arc_length, step) = (drive.projection.arc_length + 0.2, 0.1);
        let (mut point, mut direction) = course.point_at(arc_length.min(drive.stop))?;
        for _ in 0..200 {
            arc_length += step;
            if arc_length >= drive.stop {
                break;
            }
            let (next, ahead) = course.point_at(arc_length)?;
            if direction.inverse().compose(&ahead).angle().abs() > 0.17 {
                return Some(point);
            }
            (point, direction) = (next, ahead);
        }
        course.point_at(arc_length.min(drive.stop)).map(|(point, _)| point)
    }

    /// Greatest speed that the way ahead allows: where it ends, the vehicle must stop.
    fn speed_cap(&self, request: &LocalPlanRequest<'_>, drive: &Drive) -> f64 {
        let position = request.state.map_from_base.translation();
        let ahead = (drive.stop_pose.translation() - position).norm();
        let deceleration = self.params.stopping_share * request.limits.twist.deceleration;
        // Never so slow that the last decimetre takes for ever.
        let to_stop = drive.to_stop().max(ahead.min(2.0 * drive.to_stop().max(PROGRESS)));
        stopping_speed(to_stop, deceleration, request.dt).max(0.05)
    }

    fn sample(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive) {
        let &LocalPlanRequest { state, map, limits, dt, .. } = request;
        let params = &self.params;
        let time = self.window_time(request);
        let window = Window::new(&state.motion(), limits, time.max(dt), drive.gear, self.speed_cap(request, drive));
        let steering = steering_angle(&state.motion(), limits);
        let turn = limits.steering.map_or(state.twist.yaw_rate, |steered| steered.curvature(steering));
        self.batch.begin(&state, map, params.steps, params.horizon / params.steps as f64);
        self.speeds.clear();
        samples(window.forward, params.speeds, state.twist.vx, |value| self.speeds.push(value));
        self.turns.clear();
        samples(window.turn, params.turns, turn, |value| self.turns.push(value));
        let batch = &mut self.batch;
        for &vx in &self.speeds {
            for &turn in &self.turns {
                if window.lateral == (0.0, 0.0) {
                    batch.push([vx as f32, 0.0, turn as f32]);
                } else {
                    let each = |vy: f64| batch.push([vx as f32, vy as f32, turn as f32]);
                    samples(window.lateral, params.lateral_speeds, 0.0, each);
                }
            }
        }
    }

    /// Time of the window: as it is, or by speed and room.
    fn window_time(&self, request: &LocalPlanRequest<'_>) -> f64 {
        let Some(adaptive) = self.params.adaptive else { return self.params.window };
        let pose = request.state.map_from_base;
        let distance = request.map.distance_at(&pose.translation()).map_or(0.0, |(distance, _)| distance);
        let room = (distance - self.params.footprint.circumscribed_radius()) / adaptive.room;
        let fast = request.state.twist.speed() / request.limits.twist.forward_speed.max(1e-9);
        let share = room.min(0.5 + 0.5 * fast).clamp(adaptive.least, 1.0);
        self.params.window * share
    }

    /// The command that leads to what trajectory `i` aims at.
    fn command_towards(&self, request: &LocalPlanRequest<'_>, i: usize) -> Motion {
        let &LocalPlanRequest { state, limits, dt, .. } = request;
        let [vx, vy, turn] = self.batch.target(i).map(f64::from);
        let now = state.twist;
        let (up, down) = (limits.twist.acceleration, limits.twist.deceleration);
        let vx = towards(now.vx, vx, up, down, dt);
        let target = if let Some(steering) = &limits.steering {
            let angle = steering_angle(&state.motion(), limits);
            let change = steering.max_rate * dt;
            let angle = (turn * steering.wheelbase).atan().clamp(angle - change, angle + change);
            Motion { twist: Twist2::new(vx, 0.0, vx * steering.curvature(angle)), steering: Some(angle) }
        } else {
            let change = limits.twist.yaw_acceleration;
            Twist2::new(vx, towards(now.vy, vy, up, down, dt), towards(now.yaw_rate, turn, change, change, dt)).into()
        };
        limits.step_checked(&state.motion(), &target, dt)
    }

    fn drive(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive) -> Result<LocalCommand, LocalPlanError> {
        let pose = request.state.map_from_base;
        let position = pose.translation();
        self.field.set_map(request.map, self.params.footprint.inscribed_radius());
        let Some((target, _)) = self.aim(drive, &position) else {
            self.last = Twist2::ZERO;
            return self.blocked(request, BlockReason::Obstacle);
        };
        self.field.trace(&position);
        if self.gives_up(drive) {
            return self.blocked(request, BlockReason::Limits);
        }
        self.sample(request, drive);
        self.batch.roll_out(&request.state, request.limits, request.map, &self.params.footprint);
        self.batch.meet(request.obstacles);
        self.judge(request, drive, target);
        if let Some(command) = self.best(request)? {
            return Ok(command);
        }
        // Who stands may look more closely: what only seems to touch may be free.
        if request.state.twist == Twist2::ZERO {
            self.batch.relax(request.map, RELAXED);
            self.judge(request, drive, target);
            if let Some(command) = self.best(request)? {
                return Ok(command);
            }
        }
        self.last = Twist2::ZERO;
        self.blocked(request, self.reason)
    }

    /// Lets the critics score the batch.
    fn judge(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive, target: Vector2<f64>) {
        let scene = Scene {
            request,
            drive,
            course: self.reference.course(),
            field: &self.field,
            key_node: self.key_node(drive).unwrap_or(target),
            target,
            last: self.last,
        };
        score(&mut self.critics, &self.batch, &scene, &mut self.totals, &mut self.scratch);
    }

    /// The best command that the guard lets pass, if any.
    fn best(&mut self, request: &LocalPlanRequest<'_>) -> Result<Option<LocalCommand>, LocalPlanError> {
        let totals = &self.totals;
        self.order.clear();
        self.order.extend((0..totals.len() as u32).filter(|&i| totals[i as usize].is_finite()));
        let by_cost = |a: &u32, b: &u32| totals[*a as usize].total_cmp(&totals[*b as usize]).then(a.cmp(b));
        self.order.sort_unstable_by(by_cost);
        self.refused.clear();
        self.reason = BlockReason::Obstacle;
        for k in 0..self.order.len() {
            let i = self.order[k] as usize;
            let motion = self.command_towards(request, i);
            // Different aims often begin alike.
            if self.refused.contains(&motion) {
                continue;
            }
            if self.refused.len() >= MOST_CHECKED {
                break;
            }
            match self.guard.check_trusted(request, &motion)? {
                Verdict::Clear => {
                    self.last = self.batch.target_twist(i, request.limits.steering.is_some());
                    let stands = motion.twist == Twist2::ZERO && request.state.twist == Twist2::ZERO;
                    let turns_wheels = motion.steering != request.state.steering && motion.steering.is_some();
                    let status = if stands && !turns_wheels {
                        LocalPlanStatus::Blocked(self.standing_reason(request))
                    } else {
                        self.progress.waited += request.dt;
                        LocalPlanStatus::Following
                    };
                    return Ok(Some(LocalCommand { motion, status }));
                }
                Verdict::Blocked(because) => {
                    self.reason = because;
                    self.refused.push(motion);
                }
            }
        }
        Ok(None)
    }

    /// Why it is best to stand.
    fn standing_reason(&self, request: &LocalPlanRequest<'_>) -> BlockReason {
        let reach = self.params.look_ahead;
        let position = request.state.map_from_base.translation();
        let near = request.obstacles.iter().any(|o| (o.position - position).norm() - o.circumscribed_radius() < reach);
        if near { BlockReason::MovingObstacle } else { self.reason }
    }

    fn blocked(&self, request: &LocalPlanRequest<'_>, reason: BlockReason) -> Result<LocalCommand, LocalPlanError> {
        let motion = self.guard.brake(request)?;
        Ok(LocalCommand { motion, status: LocalPlanStatus::Blocked(reason) })
    }

    /// Whether it drove without progress for too long.
    fn gives_up(&mut self, drive: &Drive) -> bool {
        let patience = &mut self.progress;
        if self.reference.is_new() || drive.remaining < patience.least - PROGRESS {
            *patience = Patience { least: drive.remaining, waited: 0.0 };
        }
        patience.waited > self.params.patience
    }

    /// Turns on the spot: the shorter way, unless that is closed and the other is not. An angle of zero is a stop on the way.
    fn turn(&mut self, request: &LocalPlanRequest<'_>, error: f64) -> Result<LocalCommand, LocalPlanError> {
        self.last = Twist2::ZERO;
        if error == 0.0 {
            let motion = self.guard.brake(request)?;
            return Ok(LocalCommand { motion, status: LocalPlanStatus::Following });
        }
        let (limits, pose) = (request.limits, request.state.map_from_base);
        // All of the turn, not the next cycle: the way is chosen once, and not again at the obstacle.
        let closed = |angle: f64| {
            let (twist, margin) = (Twist2::new(0.0, 0.0, 1.0_f64.copysign(angle)), self.params.guard.margin);
            let obstacles = request.map.obstacles();
            obstacles.collides_along_within(&self.params.footprint, &pose, &twist, angle.abs(), margin)
        };
        let around = error - std::f64::consts::TAU.copysign(error);
        let angle = if closed(error)? && !closed(around)? { around } else { error };
        let rate = stopping_speed(angle.abs(), limits.twist.yaw_acceleration, request.dt).min(limits.twist.yaw_rate);
        let target = Twist2::new(0.0, 0.0, rate.copysign(angle));
        let motion = limits.step_checked(&request.state.motion(), &target.into(), request.dt);
        match self.guard.check_trusted(request, &motion)? {
            Verdict::Clear => Ok(LocalCommand { motion, status: LocalPlanStatus::Following }),
            Verdict::Blocked(because) => self.blocked(request, because),
        }
    }
}

impl LocalPlanner for Dwa {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        check_request(&request)?;
        if self.guard.touches(&request)? {
            self.last = Twist2::ZERO;
            let motion = self.guard.brake(&request)?;
            return Ok(LocalCommand { motion, status: LocalPlanStatus::InCollision });
        }
        match self.reference.update_trusted(&request) {
            Task::Drive(drive) => self.drive(&request, &drive),
            Task::Turn(error) => self.turn(&request, error),
            Task::Arrive => {
                let motion = self.guard.brake(&request)?;
                Ok(LocalCommand { motion, status: LocalPlanStatus::Arrived })
            }
            Task::OffPath => self.blocked(&request, BlockReason::OffPath),
        }
    }
}

/// A component after a step towards its target.
fn towards(now: f64, target: f64, acceleration: f64, deceleration: f64, dt: f64) -> f64 {
    let (lowest, highest) = (-rise(-now, acceleration, deceleration, dt), rise(now, acceleration, deceleration, dt));
    target.max(lowest).min(highest)
}

#[cfg(test)]
mod tests;
