//! The local planner: bands along the path ahead, the best of them, and what of it is done now.

use super::{
    band::Band,
    edges::Circle,
    lanes::Lanes,
    line::Ground,
    params::TebParams,
    rollout::{Rollout, Task},
    sample::Sample,
    slot::Slot,
    solver::BandReport,
};
use crate::local::{Guard, GuardParams, check_request};
use agv_core::{
    Error, check,
    compute::Par,
    geometry::{Twist2, angle_difference},
    kinematics::Motion,
    path::{Course, Gear, Leg, Path, PathPoint},
    roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState},
    trajectory::Trajectory,
};
use nalgebra::Vector2;

/// A timed elastic band that plays [`LocalPlanner`].
///
/// It follows the path as far as its horizon, on the quickest side of what blocks it, and stays on that side while it can. The
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
    pub(super) params: TebParams,
    pub(super) par: Par,
    pub(super) circles: Vec<Circle>,
    pub(super) course: Course,
    /// The path that the course was made of.
    pub(super) points: Vec<PathPoint>,
    /// The way to a path of one place.
    pub(super) straight: Path,
    pub(super) via: Vec<Vector2<f64>>,
    pub(super) rotation: f64,
    pub(super) samples: Vec<Sample>,
    pub(super) lanes: Lanes,
    pub(super) offsets: Vec<f64>,
    pub(super) scratch: Vec<[f64; 4]>,
    /// The way of the last cycle, that along the path, and those around what blocks it.
    pub(super) slots: Vec<Slot>,
    /// The band that was followed last, if any.
    pub(super) last: Band,
    /// What is done instead of following a band: turns and stops.
    pub(super) hold: Rollout,
    pub(super) guard: Guard,
    pub(super) turning: Option<f64>,
    /// Cycles in which the present way was blocked, one after the other; and all.
    pub(super) blocked: u32,
    pub(super) cycle: u32,
}

/// Turn from which on the other side is at most twice as long, in radians.
const EITHER_SIDE: f64 = 2.0 * std::f64::consts::FRAC_PI_3;

/// What was planned in a cycle, as [`Teb::plan`] says it.
#[derive(Debug, Clone, Copy)]
pub struct TebPlan<'a> {
    /// What to do, and why.
    pub command: LocalCommand,
    /// The motion that begins with the command and ends at rest.
    pub trajectory: &'a Trajectory,
    /// Whether that touches nothing and leads all the way, or as far as a thousand cycles do.
    pub is_free: bool,
    /// The band that it follows; none while the vehicle turns or stops.
    pub band: Option<&'a Band>,
    /// How that was optimised.
    pub report: BandReport,
    /// Ways that were explored in this cycle.
    pub ways: usize,
}

/// What is done in a cycle.
#[derive(Debug, Clone, Copy)]
pub(super) enum Choice {
    Follow(usize),
    Hold,
}

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
        let slots = vec![Slot::new(); 2 + params.max_ways];
        Ok(Self {
            params,
            par: Par::Seq,
            circles,
            course: Course::new(0.5),
            points: Vec::new(),
            straight: Path::new(),
            via: Vec::new(),
            rotation: 0.0,
            samples: Vec::new(),
            lanes: Lanes::default(),
            offsets: Vec::new(),
            scratch: Vec::new(),
            slots,
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

    /// Prefers to turn left (positive) or right (negative), at the beginning of each band and where that takes at most twice as long
    /// on the spot; zero for either.
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
        let (rollout, band, report, is_free) = match choice {
            Choice::Follow(i) => {
                let slot = &self.slots[i];
                (&slot.rollout, Some(&slot.band), slot.report, slot.is_passable() && slot.rollout.is_free())
            }
            Choice::Hold => (&self.hold, None, BandReport::default(), self.hold.is_free()),
        };
        let motion = match rollout.first() {
            Some(motion) => motion,
            None => request.limits.brake(&request.state.motion(), request.dt)?,
        };
        let command = LocalCommand { motion, status };
        Ok(TebPlan { command, trajectory: rollout.trajectory(), is_free, band, report, ways })
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
            let straight = &mut self.straight;
            straight.clear();
            if let Some(goal) = path.points().last() {
                let from = PathPoint { pose: state.map_from_base, gear: Gear::Forward };
                straight.push(from)?;
                straight.push(*goal)?;
                if self.course.set(straight).is_err() {
                    straight.clear();
                    straight.push(*goal)?;
                    straight.push_turn(goal.pose.yaw() + 0.5 * self.params.yaw_tolerance.min(1.0))?;
                    self.course.set(straight)?;
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
        // An estimate of a vehicle at rest is hardly ever zero: it rests if it can within the cycle.
        let braked = request.limits.step_checked(&state.motion(), &Motion::REST, request.dt).twist;
        let (stands, rests) = (braked.speed() == 0.0, braked == Twist2::ZERO);
        // Every round but the last goes on to the next section.
        loop {
            match self.course.leg() {
                Leg::Turn(yaw) => {
                    let left = angle_difference(yaw, state.map_from_base.yaw()).abs();
                    let turns = request.limits.turns_on_the_spot();
                    let there = !turns || left <= 0.5 * self.params.yaw_tolerance;
                    if there && rests {
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
                    if near && rests && self.course.next_section() {
                        self.last.clear();
                        continue;
                    }
                    if near && stands && self.course.is_last_section() {
                        self.last.clear();
                        // It may have come from aside, and may be turning already.
                        let last = self.points.last().map_or(0.0, |point| point.pose.yaw());
                        let left = angle_difference(last, state.map_from_base.yaw()).abs();
                        if request.limits.turns_on_the_spot() && left > 0.8 * self.params.yaw_tolerance {
                            return self.turn_to(request, last, LocalPlanStatus::Following);
                        }
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

    pub(super) fn brake(&mut self, request: &LocalPlanRequest<'_>) -> Result<(), LocalPlanError> {
        let motion = self.guard.brake(request)?;
        let ground = Ground::new(&self.params, &self.circles, request, 1.0);
        Ok(self.hold.brake_after(&Task { request, footprint: &self.params.footprint, ground }, &motion)?)
    }

    /// Turns on the spot by the free side, the shorter one first.
    pub(super) fn turn_to(
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

    pub(super) fn try_turn(&mut self, request: &LocalPlanRequest<'_>, yaw: f64) -> Result<bool, LocalPlanError> {
        let task = Task {
            request,
            footprint: &self.params.footprint,
            ground: Ground::new(&self.params, &self.circles, request, 1.0),
        };
        let turn = angle_difference(yaw, request.state.map_from_base.yaw());
        let wished = self.rotation != 0.0 && turn.abs() > EITHER_SIDE;
        let shorter = if wished { self.rotation } else { 1.0_f64.copysign(turn) };
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
}

impl LocalPlanner for Teb {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        self.plan(request).map(|plan| plan.command)
    }
}
