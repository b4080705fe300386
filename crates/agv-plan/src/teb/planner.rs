//! The local planner: bands along the path ahead, the best of them, and what of it is done now.

use super::{
    band::Band,
    classes::{Sample, detour, same_way},
    edges::Circle,
    line::{Ground, Line},
    params::TebParams,
    problem::Problem,
    rollout::{Rollout, Task},
    solver::{BandReport, BandSolver},
};
use crate::local::{Guard, GuardParams, Verdict, check_request};
use agv_core::{
    Error, check,
    compute::Par,
    geometry::{Twist2, angle_difference},
    path::{Course, Gear, Leg, Path, PathPoint},
    roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState},
    trajectory::Trajectory,
};
use nalgebra::Vector2;
use std::f64::consts::PI;

/// A timed elastic band that plays [`LocalPlanner`].
///
/// It follows the path as far as its horizon, on the shortest side of what blocks it, and stays on that side while it can. The
/// band of a cycle goes on from the last one's. A vehicle that turns on the spot does so where the path leads away behind it, and
/// at turns of the path; one that steers keeps its turning circle, and drives backwards where the path says so.
///
/// The costs of the map are not looked at, only its obstacles.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{Cell, CellState, Costmap, Footprint, Grid, GridLayout, LocalMap, LocalMapParams, cost};
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_core::roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState};
/// use agv_plan::teb::{Teb, TebParams};
///
/// // A post in the middle of the path.
/// let layout = GridLayout::new(160, 100, 0.05, Se2::default())?;
/// let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
/// costmap.set(Cell::new(80, 50), cost::LETHAL);
/// let map = LocalMap::new(&costmap, LocalMapParams::default())?;
/// let path = Path::from_positions(&[Vector2::new(1.0, 2.5), Vector2::new(7.0, 2.5)])?;
/// let mut teb = Teb::new(TebParams::for_footprint(Footprint::rectangle(-0.25, 0.25, 0.4)?))?;
/// let limits = MotionLimits::default();
/// let mut state = VehicleState::new(Se2::new(1.0, 2.5, 0.0), Twist2::ZERO);
/// let mut cycles = 0;
/// loop {
///     let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
///     let command = teb.command(request)?;
///     assert!(limits.allows_step(&state.motion(), &command.motion, 0.05));
///     state = state.after(&command.motion, 0.05);
///     cycles += 1;
///     if command.status == LocalPlanStatus::Arrived && state.twist == Twist2::ZERO || cycles > 1000 {
///         break;
///     }
/// }
/// assert!((state.map_from_base.x() - 7.0).abs() < 0.1 && cycles < 300, "{cycles} {state:?}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Teb {
    params: TebParams,
    par: Par,
    circles: Vec<Circle>,
    course: Course,
    /// The path that the course was made of.
    points: Vec<PathPoint>,
    via: Vec<Vector2<f64>>,
    rotation: f64,
    samples: Vec<Sample>,
    offsets: Vec<f64>,
    scratch: Vec<[f64; 4]>,
    /// The way of the last cycle, that along the path, and those to the left and to the right of it.
    slots: Vec<Slot>,
    /// The band that was followed last, if any.
    last: Band,
    /// What is done instead of following a band: turns and stops.
    hold: Rollout,
    guard: Guard,
    turning: Option<f64>,
    /// Cycles in which the present way was blocked, one after the other; and all.
    blocked: u32,
    cycle: u32,
}

/// One way, and the memory to find it.
#[derive(Debug, Clone)]
struct Slot {
    active: bool,
    band: Band,
    solver: BandSolver,
    report: BandReport,
    line: Line,
    rollout: Rollout,
    scratch: Vec<[f64; 4]>,
    cost: f64,
}

impl Slot {
    fn new() -> Self {
        Self {
            active: false,
            band: Band::new(),
            solver: BandSolver::default(),
            report: BandReport::default(),
            line: Line::default(),
            rollout: Rollout::default(),
            scratch: Vec::new(),
            cost: f64::INFINITY,
        }
    }
}

/// What was planned in a cycle, as [`Teb::plan`] says it.
#[derive(Debug, Clone, Copy)]
pub struct TebPlan<'a> {
    /// What to do, and why.
    pub command: LocalCommand,
    /// The motion that begins with the command and ends at rest.
    pub trajectory: &'a Trajectory,
    /// Whether that touches nothing.
    pub is_free: bool,
    /// The band that it follows; none while the vehicle turns or stops.
    pub band: Option<&'a Band>,
    /// How that was optimised.
    pub report: BandReport,
    /// Ways that were explored in this cycle.
    pub ways: usize,
}

/// What is done in a cycle.
enum Choice {
    Follow(usize),
    Hold,
}

/// Length of road, in metres, over which the direction to set out in is read.
const SET_OUT: f64 = 0.5;
/// Angles between heading and path from which on the vehicle turns on the spot, and to which it then does, in radians.
const TURN_FROM: f64 = 1.2;
const TURN_TO: f64 = 0.2;
/// Cycles after which a way that is blocked is given up for another.
const PATIENCE: u32 = 4;
/// Cycles between explorations of other ways while the present one is free.
const EXPLORE_EVERY: u32 = 10;
/// Cost, in seconds, of ways that are blocked; less by what of them is free, in metres.
const BLOCKED: f64 = 1e5;
/// Distance of a goal nearby, in spacings of the band.
const NEARBY: f64 = 4.0;
/// Shares of the speed that are tried, if the whole leads into something.
const SPEED_SHARES: [f64; 4] = [1.0, 0.6, 0.35, 0.2];
/// How far from the band a vehicle may be for the band to go on, in metres.
const REACH: f64 = 0.5;

impl Teb {
    /// A planner with these parameters.
    ///
    /// # Errors
    /// What [`TebParams::validate`] says.
    pub fn new(params: TebParams) -> Result<Self, crate::Error> {
        params.validate()?;
        let guard = Guard::new(params.footprint.clone(), GuardParams::default())?;
        let footprint = &params.footprint;
        let cover = footprint.cover().iter().map(|&(center, radius)| Circle { center, radius });
        let mut circles: Vec<_> = cover.collect();
        if circles.is_empty() {
            circles.push(Circle { center: Vector2::zeros(), radius: footprint.circumscribed_radius() });
        }
        Ok(Self {
            params,
            par: Par::Seq,
            circles,
            course: Course::new(0.5),
            points: Vec::new(),
            via: Vec::new(),
            rotation: 0.0,
            samples: Vec::new(),
            offsets: Vec::new(),
            scratch: Vec::new(),
            slots: vec![Slot::new(); 4],
            last: Band::new(),
            hold: Rollout::default(),
            guard,
            turning: None,
            blocked: 0,
            cycle: 0,
        })
    }

    /// The same planner, exploring ways on several threads; the bits do not depend on it.
    #[must_use]
    pub const fn with_parallelism(mut self, par: Par) -> Self {
        self.par = par;
        self
    }

    /// Parameters as they were given.
    pub const fn params(&self) -> &TebParams {
        &self.params
    }

    /// Points of the map that the band should pass near to, until others are set.
    ///
    /// # Errors
    /// A point that is not finite; those that were set stay.
    pub fn set_via_points(&mut self, points: &[Vector2<f64>]) -> Result<(), Error> {
        check::all_finite("via points", points.iter().flatten())?;
        self.via.clear();
        self.via.extend_from_slice(points);
        Ok(())
    }

    /// Prefers to turn left (positive) or right (negative) at the beginning of each band; zero for either.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn prefer_rotation(&mut self, side: f64) -> Result<(), Error> {
        check::finite("side", side)?;
        self.rotation = if side == 0.0 { 0.0 } else { side.signum() };
        Ok(())
    }

    /// Forgets path and band: the next plan is one from the beginning.
    pub fn reset(&mut self) {
        self.points.clear();
        self.last.clear();
        self.turning = None;
        (self.blocked, self.cycle) = (0, 0);
    }

    /// Plans a cycle: as [`command`](LocalPlanner::command), with the whole trajectory.
    ///
    /// # Errors
    /// As [`command`](LocalPlanner::command).
    pub fn plan(&mut self, request: LocalPlanRequest<'_>) -> Result<TebPlan<'_>, LocalPlanError> {
        check_request(&request)?;
        let changed = self.take_path(request.path, &request.state)?;
        self.cycle = self.cycle.wrapping_add(1);
        for slot in &mut self.slots {
            slot.active = false;
        }
        let touching = self.guard.touches(&request)?;
        let (choice, status) = if touching {
            self.last.clear();
            self.brake(&request)?;
            (Choice::Hold, LocalPlanStatus::InCollision)
        } else {
            self.decide(&request, changed)?
        };
        let ways = self.slots.iter().filter(|slot| slot.active).count();
        let (rollout, band, report) = match choice {
            Choice::Follow(i) => (&self.slots[i].rollout, Some(&self.slots[i].band), self.slots[i].report),
            Choice::Hold => (&self.hold, None, BandReport::default()),
        };
        let motion = match rollout.first() {
            Some(motion) => motion,
            None => request.limits.brake(&request.state.motion(), request.dt)?,
        };
        let command = LocalCommand { motion, status };
        Ok(TebPlan { command, trajectory: rollout.trajectory(), is_free: rollout.is_free(), band, report, ways })
    }

    /// Takes the path if it is another one; says whether it was.
    fn take_path(&mut self, path: &Path, state: &VehicleState) -> Result<bool, Error> {
        if self.points == path.points() {
            return Ok(false);
        }
        self.points.clear();
        self.points.extend_from_slice(path.points());
        if self.course.set(path).is_err() {
            // One place only: the way there is straight.
            let mut straight = Path::new();
            if let Some(goal) = path.points().last() {
                let from = PathPoint { pose: state.map_from_base, gear: Gear::Forward };
                straight.push(from)?;
                straight.push(*goal)?;
                if self.course.set(&straight).is_err() {
                    straight.clear();
                    straight.push(*goal)?;
                    straight.push_turn(goal.pose.yaw() + 0.5 * self.params.yaw_tolerance.min(1.0))?;
                    self.course.set(&straight)?;
                }
            }
        }
        self.turning = None;
        Ok(true)
    }

    /// What is done in this cycle.
    fn decide(
        &mut self,
        request: &LocalPlanRequest<'_>,
        changed: bool,
    ) -> Result<(Choice, LocalPlanStatus), LocalPlanError> {
        let state = &request.state;
        let at = state.map_from_base.translation();
        // Every round but the last goes on to the next section.
        loop {
            match self.course.leg() {
                Leg::Turn(yaw) => {
                    let left = angle_difference(yaw, state.map_from_base.yaw()).abs();
                    let turns = request.limits.turns_on_the_spot();
                    let there = !turns || left <= 0.5 * self.params.yaw_tolerance;
                    if there && state.twist == Twist2::ZERO {
                        if self.course.next_section() {
                            continue;
                        }
                        self.brake(request)?;
                        return Ok((Choice::Hold, LocalPlanStatus::Arrived));
                    }
                    if there {
                        self.brake(request)?;
                        return Ok((Choice::Hold, self.stopping_status()));
                    }
                    return self.turn_to(request, yaw, self.stopping_status());
                }
                Leg::Drive(gear) => {
                    let reach = self.params.horizon + 2.0;
                    let Some(place) = self.course.advance(&at, reach) else {
                        self.brake(request)?;
                        return Ok((Choice::Hold, LocalPlanStatus::Blocked(BlockReason::OffPath)));
                    };
                    let end = self.course.section_end();
                    let goal = self.course.point_at(end).map_or(at, |(goal, _)| goal);
                    let (distance, left) = ((goal - at).norm(), end - place.arc_length);
                    let tolerance = self.params.position_tolerance;
                    let near = distance <= 0.1 * tolerance || (left <= 0.2 * tolerance && distance <= 0.9 * tolerance);
                    if near && state.twist == Twist2::ZERO {
                        self.last.clear();
                        if self.course.next_section() {
                            continue;
                        }
                        // It may have come from aside.
                        let last = self.points.last().map_or(0.0, |point| point.pose.yaw());
                        let left = angle_difference(last, state.map_from_base.yaw()).abs();
                        if request.limits.turns_on_the_spot() && left > 0.8 * self.params.yaw_tolerance {
                            return self.turn_to(request, last, LocalPlanStatus::Following);
                        }
                        self.brake(request)?;
                        return Ok((Choice::Hold, LocalPlanStatus::Arrived));
                    }
                    if near {
                        self.brake(request)?;
                        return Ok((Choice::Hold, self.stopping_status()));
                    }
                    let gear = if gear == Gear::Reverse { -1.0 } else { 1.0 };
                    return self.drive(request, place.arc_length, gear, changed);
                }
            }
        }
    }

    /// Of a vehicle that comes to rest where the path lets it.
    const fn stopping_status(&self) -> LocalPlanStatus {
        if self.course.is_last_section() { LocalPlanStatus::Arrived } else { LocalPlanStatus::Following }
    }

    fn brake(&mut self, request: &LocalPlanRequest<'_>) -> Result<(), LocalPlanError> {
        let motion = self.guard.brake(request)?;
        let ground = ground(&self.params, &self.circles, request, 1.0);
        Ok(self.hold.brake_after(&Task { request, footprint: &self.params.footprint, ground }, &motion)?)
    }

    /// Turns on the spot by the free side, the shorter one first.
    fn turn_to(
        &mut self,
        request: &LocalPlanRequest<'_>,
        yaw: f64,
        status: LocalPlanStatus,
    ) -> Result<(Choice, LocalPlanStatus), LocalPlanError> {
        let status = if status == LocalPlanStatus::Arrived { LocalPlanStatus::Following } else { status };
        if self.try_turn(request, yaw)? {
            return Ok((Choice::Hold, status));
        }
        let reason = self.hold.blocked().unwrap_or(BlockReason::Obstacle);
        self.brake(request)?;
        Ok((Choice::Hold, LocalPlanStatus::Blocked(reason)))
    }

    fn try_turn(&mut self, request: &LocalPlanRequest<'_>, yaw: f64) -> Result<bool, LocalPlanError> {
        let task = Task {
            request,
            footprint: &self.params.footprint,
            ground: ground(&self.params, &self.circles, request, 1.0),
        };
        let shorter = 1.0_f64.copysign(angle_difference(yaw, request.state.map_from_base.yaw()));
        let spinning = request.state.twist.yaw_rate;
        let first = if spinning.abs() > 0.05 && self.turning.is_some() { spinning.signum() } else { shorter };
        for side in [first, -first] {
            self.hold.turn(&task, yaw, side)?;
            if let (true, Some(motion)) = (self.hold.is_free(), self.hold.first())
                && self.guard.check_trusted(request, &motion)?.is_clear()
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Follows the best band along the present section.
    fn drive(
        &mut self,
        request: &LocalPlanRequest<'_>,
        progress: f64,
        gear: f64,
        changed: bool,
    ) -> Result<(Choice, LocalPlanStatus), LocalPlanError> {
        let params = &self.params;
        let ground = ground(params, &self.circles, request, gear);
        let holonomic = ground.is_holonomic();
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
        if request.limits.turns_on_the_spot() && !holonomic {
            if let Some(heading) = self.must_turn(request, gear, warm) {
                if self.try_turn(request, heading)? {
                    self.turning = Some(heading);
                    self.last.clear();
                    return Ok((Choice::Hold, LocalPlanStatus::Following));
                }
            }
        }
        self.turning = None;
        let Self { params, circles, samples, offsets, scratch, slots, last, guard, .. } = self;
        let ground = self::ground(params, circles, request, gear);
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
        let current_is_free = current.is_some_and(|i| slots[i].rollout.is_free());
        self.blocked = if current_is_free { 0 } else { self.blocked + 1 };
        if !current_is_free || changed || self.cycle.is_multiple_of(EXPLORE_EVERY) {
            begin(&mut slots[1], samples, None, &ground, scratch);
            for (slot, side) in slots[2..].iter_mut().zip([1.0, -1.0]) {
                if params.max_detour > 0.0 && detour(samples, &ground, side, params.spacing, offsets) {
                    begin(slot, samples, Some((&offsets[..], side)), &ground, scratch);
                }
            }
            let iterations = params.cold_iterations;
            self.par.for_each_chunk(&mut slots[1..], 1, |_, chunk| {
                for slot in chunk.iter_mut().filter(|slot| slot.active) {
                    if improve(slot, &problem, &task, iterations, 2).is_err() {
                        slot.cost = f64::INFINITY;
                    }
                }
            });
        }
        let best = choose(slots, current, params.switch_share, self.blocked, &request.map);
        let Some(best) = best else {
            self.brake(request)?;
            return Ok((Choice::Hold, LocalPlanStatus::Blocked(BlockReason::Obstacle)));
        };
        last.copy_from(&slots[best].band);
        // However the roll-out goes on: after its first motion the vehicle must be able to brake.
        let slot = &mut slots[best];
        let mut verdict = Verdict::Clear;
        for share in SPEED_SHARES {
            let Some(motion) = slot.rollout.first() else { break };
            let begins_freely = slot.rollout.touch().is_none_or(|_| slot.rollout.trajectory().len() > 1);
            verdict = guard.check_trusted(request, &motion)?;
            if verdict.is_clear() && begins_freely {
                let reason = slot.rollout.blocked().or(slot.line.stopped());
                let rests = motion.twist == Twist2::ZERO && request.state.twist == Twist2::ZERO;
                let status = match reason {
                    Some(reason) if rests => LocalPlanStatus::Blocked(reason),
                    _ => LocalPlanStatus::Following,
                };
                return Ok((Choice::Follow(best), status));
            }
            let stop = slot.line.length();
            slot.line.plan_stop(stop, 0.5 * share, &task.ground);
            slot.rollout.follow(&task, &slot.line)?;
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

impl LocalPlanner for Teb {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        self.plan(request).map(|plan| plan.command)
    }
}

fn ground<'a>(params: &'a TebParams, circles: &'a [Circle], request: &LocalPlanRequest<'a>, gear: f64) -> Ground<'a> {
    Ground { params, limits: request.limits, map: request.map, circles, gear }
}

/// Samples the present section as far as the horizon; says whether the last one is the section's end, where the vehicle stops.
fn sample(
    course: &Course,
    request: &LocalPlanRequest<'_>,
    ground: &Ground<'_>,
    progress: f64,
    points: &[PathPoint],
    samples: &mut Vec<Sample>,
) -> bool {
    let (params, twist) = (ground.params, &ground.limits.twist);
    let holonomic = ground.is_holonomic();
    let end = course.section_end();
    let braking = 0.5 * twist.forward_speed.powi(2) / (params.acceleration_share * twist.deceleration);
    let horizon = params.horizon.max(1.2 * braking);
    samples.clear();
    let pose = request.state.map_from_base;
    samples.push(Sample { position: pose.translation(), yaw: pose.yaw(), direction: pose.yaw() });
    let at = |arc_length: f64| {
        let (position, _) = course.point_at(arc_length)?;
        let direction = course.direction_at(arc_length)?.angle();
        let yaw = if holonomic {
            course.yaw_at(arc_length)?
        } else if ground.gear < 0.0 {
            direction + PI
        } else {
            direction
        };
        Some(Sample { position, yaw, direction })
    };
    let mut arc_length = progress;
    loop {
        let next = arc_length + params.spacing;
        arc_length = if next + 0.5 * params.spacing > end { end } else { next };
        let Some(mut sample) = at(arc_length) else { break };
        if arc_length >= end && !holonomic {
            let exact = course.point_at(end).map_or(sample.direction, |(_, direction)| direction.angle());
            sample.yaw = if ground.gear < 0.0 { exact + PI } else { exact };
            // A vehicle that cannot turn on the spot arrives with the last heading, if that is about where it goes.
            if let (false, true, Some(last)) =
                (ground.limits.turns_on_the_spot(), end >= course.length(), points.last())
            {
                if angle_difference(last.pose.yaw(), sample.yaw).abs() < 1.0 {
                    sample.yaw = last.pose.yaw();
                }
            }
        }
        let far = arc_length - progress >= horizon;
        // A goal on the way is one where the vehicle can stand.
        let stands = || ground.clearance([sample.position.x, sample.position.y, sample.yaw]).is_none_or(|c| c > 0.02);
        samples.push(sample);
        if arc_length >= end || (far && stands()) || arc_length - progress > 2.0 * horizon {
            break;
        }
    }
    let stops = arc_length >= end;
    let turns = ground.limits.turns_on_the_spot() && !holonomic;
    if stops
        && turns
        && is_nearby(samples, params.spacing)
        && let [first, .., last] = &mut samples[..]
    {
        // To a place nearby, from any side: whichever heading leads there.
        let line = last.position - first.position;
        last.yaw = line.y.atan2(line.x) + if ground.gear < 0.0 { PI } else { 0.0 };
    }
    if !stops {
        while samples.len() > 2
            && samples
                .last()
                .is_some_and(|s| ground.clearance([s.position.x, s.position.y, s.yaw]).is_some_and(|c| c < 0.0))
        {
            samples.pop();
        }
    }
    stops
}

/// Whether the last sample is nearby.
fn is_nearby(samples: &[Sample], spacing: f64) -> bool {
    let ends = samples.first().zip(samples.last());
    ends.is_some_and(|(first, last)| (last.position - first.position).norm() < NEARBY * spacing)
}

/// A band that is new: along the path, moved to a side where that is given.
fn begin(
    slot: &mut Slot,
    samples: &[Sample],
    aside: Option<(&[f64], f64)>,
    ground: &Ground<'_>,
    scratch: &mut Vec<[f64; 4]>,
) {
    slot.active = true;
    slot.band.clear();
    let speed =
        0.7 * if ground.gear < 0.0 { ground.limits.twist.reverse_speed } else { ground.limits.twist.forward_speed };
    let speed = speed.max(0.05);
    let place = |i: usize| {
        samples.get(i).map(|sample| {
            let (offsets, side) = aside.unwrap_or((&[], 0.0));
            let offset = side * offsets.get(i).copied().unwrap_or(0.0);
            sample.position + Vector2::new(-sample.direction.sin(), sample.direction.cos()) * offset
        })
    };
    let last = samples.len().saturating_sub(1);
    for (i, sample) in samples.iter().enumerate() {
        let Some(position) = place(i) else { return };
        let length = place(i + 1).map_or(0.0, |next| (next - position).norm());
        // Along its own line, if that is not the path; the ends as they are given.
        let line = place(i + 1).zip(i.checked_sub(1).and_then(place)).map(|(b, a)| b - a);
        let yaw = match line {
            Some(line) if aside.is_some() && i < last && !ground.is_holonomic() && line.norm() > 1e-6 => {
                line.y.atan2(line.x) + if ground.gear < 0.0 { PI } else { 0.0 }
            }
            _ => sample.yaw,
        };
        slot.band.push(position, yaw, (length / speed).max(0.02));
    }
    slot.band.resize(ground.params.spacing, ground.params.turn, scratch);
}

/// Optimises a band, in several rounds with resizing between them, and rolls it out.
fn improve(
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
fn choose(
    slots: &[Slot],
    current: Option<usize>,
    switch_share: f64,
    blocked: u32,
    map: &agv_core::grid::LocalMap,
) -> Option<usize> {
    let others = slots.iter().enumerate().filter(|(i, slot)| slot.active && Some(*i) != current);
    let best = others.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost)).map(|(i, _)| i);
    let (Some(now), Some(other)) = (current, best) else { return current.or(best) };
    let (present, best) = (&slots[now], &slots[other]);
    let better = if present.is_passable() {
        best.is_passable() && best.cost < switch_share * present.cost && !same_way(map, &present.band, &best.band)
    } else {
        // The same way found anew may be taken at once.
        best.is_passable() && (blocked >= PATIENCE || same_way(map, &present.band, &best.band))
            || best.cost < present.cost - 0.3 && blocked >= PATIENCE
    };
    Some(if better { other } else { now })
}

impl Slot {
    /// Whether the whole way can be driven.
    fn is_passable(&self) -> bool {
        self.cost < BLOCKED
    }
}
