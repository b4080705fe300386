//! From a goal to motions among obstacles that no map knows: plan, look, swerve, plan again, and say when it is no use.
//!
//! ```text
//! goal ----> GlobalPlanner (on what is seen) --> Route: path, key nodes --+
//! pose, twist, LocalMap, moving obstacles --------------------------------+--> LocalPlanner --> motion
//!                 ^                                                       |
//!                 |    blocked, or a much better way: plan again  <-------+
//!                 +--- no progress: Recovery: look again, rotate, back off, ... give up, with a reason
//! ```

mod contact;
mod evasion;
mod manoeuvre;
mod params;
mod progress;
mod recovery;
mod route;
mod search;
mod status;

use crate::Error;
use agv_core::{
    check,
    geometry::{Se2, Twist2},
    grid::{Footprint, LocalMap},
    kinematics::{Motion, MotionLimits},
    obstacle::MovingObstacle,
    path::Path,
    roles::{
        BlockReason, GlobalPlanner, LocalPlanRequest, LocalPlanStatus, LocalPlanner, NoPathReason, PlanError,
        PlanOutcome, VehicleState,
    },
};
use evasion::Evasion;
pub use params::NavigationParams;
use progress::Progress;
use recovery::Behaviour;
pub use recovery::Recovery;
use route::Route;
pub use status::{GiveUpReason, NavigationCommand, NavigationStatus};

/// All that a navigation may know in one cycle.
#[derive(Debug, Clone, Copy)]
pub struct NavigationRequest<'a> {
    /// The vehicle now, in the frame of the map: that of a localizer, or of an odometry that hardly drifts on the way to a goal.
    pub state: VehicleState,
    /// What is known of the surroundings, inflated for the vehicle.
    pub map: &'a LocalMap,
    /// Obstacles that move, in the map frame, at the time of `state`.
    pub obstacles: &'a [MovingObstacle],
    /// What the vehicle can do.
    pub limits: &'a MotionLimits,
    /// Time until the next cycle, in seconds.
    pub dt: f64,
}

/// Drives to goals through surroundings that are seen on the way.
///
/// Each cycle takes the pose from wherever it comes, and the costs around the vehicle, as a
/// [`RollingCostmap`](agv_core::grid::RollingCostmap) has them. A goal beyond that map is made for through a place at its border. The path
/// is planned anew every so often and as soon as something stands in it; another way is taken if it is better by a
/// clear margin, or the one that is followed is blocked. Where the local planner gets nowhere, recovery behaviours follow each
/// other, and after as many as the parameters allow the navigation gives up and says why. Until it has arrived or given up, and unless it touches
/// the map, the vehicle gets out of the way of what moves, where standing would not keep it clear. No clock is read: time is what
/// the cycles' `dt` add up to.
///
/// The fusions of papers 000, 002 and 003 are this type with their planners: A* and DWA, improved ants and improved DWA, A* or Dijkstra
/// and TEB.
pub struct Navigation {
    planner: Box<dyn GlobalPlanner + Send>,
    local: Box<dyn LocalPlanner + Send>,
    footprint: Footprint,
    params: NavigationParams,
    goal: Option<Se2>,
    route: Route,
    candidate: Path,
    progress: Progress,
    behaviour: Option<Behaviour>,
    evasion: Evasion,
    /// Where the vehicle was when the first of the recoveries was begun.
    stuck_at: Option<Se2>,
    /// Recovery behaviours that were begun since it got stuck there.
    recoveries: u32,
    /// Escapes among them: these go first, and are counted apart.
    escapes: u32,
    /// Seconds since the last plan.
    since_plan: f64,
    /// Seconds for which a moving obstacle has been in the way.
    waited: f64,
    /// Seconds in which it got out of the way of something, since the last progress.
    evaded: f64,
    /// Why the last attempt to plan found nothing.
    no_path: Option<NoPathReason>,
    /// What the local planner met last.
    blocked: Option<BlockReason>,
    ended: Option<NavigationStatus>,
}

impl Navigation {
    /// A navigation with these planners, for a vehicle of this outline.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(
        planner: Box<dyn GlobalPlanner + Send>,
        local: Box<dyn LocalPlanner + Send>,
        footprint: Footprint,
        params: NavigationParams,
    ) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            planner,
            local,
            footprint,
            params,
            goal: None,
            route: Route::default(),
            candidate: Path::new(),
            progress: Progress::new(),
            behaviour: None,
            evasion: Evasion::default(),
            stuck_at: None,
            recoveries: 0,
            escapes: 0,
            since_plan: f64::INFINITY,
            waited: 0.0,
            evaded: 0.0,
            no_path: None,
            blocked: None,
            ended: None,
        })
    }

    /// Sets out for a goal, from the next cycle on.
    ///
    /// # Errors
    /// A goal that is not finite; the old one is kept.
    pub fn go_to(&mut self, goal: &Se2) -> Result<(), Error> {
        check::all_finite("goal", &[goal.x(), goal.y(), goal.yaw()])?;
        self.goal = Some(*goal);
        self.route.clear();
        self.progress.reset();
        self.evasion.reset();
        (self.behaviour, self.stuck_at, self.ended, self.blocked, self.no_path) = (None, None, None, None, None);
        (self.recoveries, self.escapes, self.since_plan) = (0, 0, f64::INFINITY);
        (self.waited, self.evaded) = (0.0, 0.0);
        Ok(())
    }

    /// Forgets the goal: the next cycles brake.
    pub fn cancel(&mut self) {
        self.goal = None;
        self.route.clear();
    }

    /// The path that is being followed; empty where there is none.
    pub const fn path(&self) -> &Path {
        self.route.path()
    }

    /// The goal, from [`go_to`](Self::go_to) on.
    pub const fn goal(&self) -> Option<&Se2> {
        self.goal.as_ref()
    }

    /// The motion for the next `request.dt` seconds.
    ///
    /// # Errors
    /// A state, limit or `dt` that cannot be one, or what a planner refuses.
    pub fn cycle(&mut self, request: NavigationRequest<'_>) -> Result<NavigationCommand, Error> {
        request.state.validate()?;
        request.limits.validate()?;
        check::positive("dt", request.dt)?;
        let Some(goal) = self.goal else { return stop(&request, NavigationStatus::Idle) };
        if let Some(ended) = self.ended {
            return stop(&request, ended);
        }
        self.since_plan += request.dt;
        let moved_on = self.progress.update(&request.state.map_from_base, request.dt, self.params.progress_distance);
        if moved_on {
            self.evaded = 0.0;
        }
        if moved_on && self.behaviour.is_none() && self.is_away(&request.state.map_from_base) {
            (self.stuck_at, self.recoveries, self.escapes) = (None, 0, 0);
        }
        let command = self.advance(&request, &goal)?;
        self.evade(&request, command)
    }

    /// What to do, whatever comes.
    fn advance(&mut self, request: &NavigationRequest<'_>, goal: &Se2) -> Result<NavigationCommand, Error> {
        if let Some(command) = self.recover(request)? {
            return Ok(command);
        }
        self.plan(request, goal)?;
        if self.route.is_empty() {
            return self.get_nowhere(request);
        }
        self.follow(request)
    }

    /// The same, unless something comes that the vehicle has to get out of the way of.
    fn evade(
        &mut self,
        request: &NavigationRequest<'_>,
        command: NavigationCommand,
    ) -> Result<NavigationCommand, Error> {
        if request.obstacles.is_empty() || self.params.foresight == 0.0 || self.ended.is_some() {
            return Ok(command);
        }
        let target = self.route.place_ahead(request.limits.twist.forward_speed * self.params.foresight);
        let target = target.unwrap_or_else(|| request.state.map_from_base.translation());
        let foresight = self.params.foresight;
        let instead = self.evasion.instead_of(&command.motion, request, &self.footprint, &target, foresight)?;
        if instead.is_some() {
            // Neither getting on, nor standing still for nothing: not for ever, though.
            self.stuck_at = self.stuck_at.and(Some(request.state.map_from_base));
            self.evaded += request.dt;
            if self.evaded < self.params.patience {
                self.progress.pause(request.dt);
            }
        }
        Ok(instead.map_or(command, |motion| NavigationCommand { motion, status: NavigationStatus::Evading, ..command }))
    }

    /// Goes on with the recovery behaviour, if there is one.
    fn recover(&mut self, request: &NavigationRequest<'_>) -> Result<Option<NavigationCommand>, Error> {
        let Some(behaviour) = &mut self.behaviour else { return Ok(None) };
        let kind = behaviour.kind();
        if let Some(motion) = behaviour.motion(request, &self.footprint)? {
            let forget_map = behaviour.forgets_map();
            let status = NavigationStatus::Recovering(kind);
            return Ok(Some(NavigationCommand { motion, status, forget_map, planned: false }));
        }
        self.behaviour = None;
        (self.since_plan, self.waited) = (f64::INFINITY, 0.0);
        if kind != Recovery::Escape {
            self.progress.reset();
        }
        Ok(None)
    }

    /// Plans if it is time, or if the path is blocked.
    fn plan(&mut self, request: &NavigationRequest<'_>, goal: &Se2) -> Result<(), Error> {
        let here = &request.state.map_from_base;
        let costmap = request.map.costmap();
        self.route.advance(here);
        let old_cost = self.route.cost(costmap, &self.params);
        let is_due = self.since_plan >= self.params.plan_period;
        let may_retry = self.since_plan >= self.params.retry_period;
        if !(is_due || ((old_cost.is_none() || self.blocked.is_some()) && may_retry)) {
            return Ok(());
        }
        self.since_plan = 0.0;
        let target = route::target_in(costmap.layout(), here, goal, self.params.border);
        match self.planner.plan_into(costmap, here, &target, &mut self.candidate) {
            Ok(PlanOutcome::Found { .. }) => {
                self.no_path = None;
                // What the way costs that the map does not hold yet.
                let beyond = |path: &Path| {
                    path.points().last().map_or(0.0, |end| (goal.translation() - end.pose.translation()).norm())
                };
                let rest = beyond(self.route.path());
                let new_cost = route::cost_of(&self.candidate, costmap, &self.params) + beyond(&self.candidate);
                let is_better = old_cost.is_none_or(|old| new_cost < (old + rest) * (1.0 - self.params.hysteresis));
                let leads_farther = rest > self.params.border && beyond(&self.candidate) + self.params.border < rest;
                if is_better || leads_farther || self.blocked.is_some() {
                    self.route.set(&self.candidate, here)?;
                }
            }
            Ok(PlanOutcome::NoPath { reason, .. }) => {
                self.no_path = Some(reason);
                if old_cost.is_none() {
                    self.route.clear();
                }
            }
            Err(PlanError::StartOutside { .. } | PlanError::GoalOutside { .. }) => {
                self.no_path = Some(NoPathReason::Disconnected);
                self.route.clear();
            }
            Err(error) => return Err(error.into()),
            _ => {}
        }
        Ok(())
    }

    /// Lets the local planner follow the path, and looks what becomes of it.
    fn follow(&mut self, request: &NavigationRequest<'_>) -> Result<NavigationCommand, Error> {
        let path = self.route.ahead(self.params.reach);
        let command = self.local.command(LocalPlanRequest {
            state: request.state,
            path,
            map: request.map,
            obstacles: request.obstacles,
            limits: request.limits,
            dt: request.dt,
        })?;
        let planned = self.since_plan == 0.0;
        let answer = |status| Ok(NavigationCommand { motion: command.motion, status, forget_map: false, planned });
        self.blocked = None;
        match command.status {
            LocalPlanStatus::Arrived if self.is_at_goal(&request.state.map_from_base) => {
                self.ended = Some(NavigationStatus::Arrived);
                return answer(NavigationStatus::Arrived);
            }
            LocalPlanStatus::Blocked(BlockReason::MovingObstacle) if self.waited < self.params.patience => {
                self.waited += request.dt;
                self.progress.pause(request.dt);
                return answer(NavigationStatus::Waiting(BlockReason::MovingObstacle));
            }
            LocalPlanStatus::Blocked(reason) => self.blocked = Some(reason),
            LocalPlanStatus::InCollision => {
                self.blocked = Some(BlockReason::Obstacle);
                let rest = request.limits.brake(&request.state.motion(), request.dt)?;
                if rest.twist == Twist2::ZERO && self.escapes < self.params.recoveries {
                    self.escapes += 1;
                    self.stuck_at.get_or_insert(request.state.map_from_base);
                    self.behaviour = Some(Behaviour::escape(request, self.route.path()));
                    return answer(NavigationStatus::Recovering(Recovery::Escape));
                }
            }
            _ => self.waited = 0.0,
        }
        let patience = if self.blocked.is_some() { self.params.blocked_time } else { self.params.progress_time };
        if self.progress.standing() > patience {
            return self.get_nowhere(request);
        }
        answer(self.blocked.map_or(NavigationStatus::Following, NavigationStatus::Waiting))
    }

    fn is_at_goal(&self, here: &Se2) -> bool {
        self.goal.is_some_and(|goal| (goal.translation() - here.translation()).norm() <= self.params.goal_tolerance)
    }

    /// Whether the vehicle has left the place where it got stuck behind: farther than by backing off and coming again.
    fn is_away(&self, here: &Se2) -> bool {
        let far = (2.0 * self.params.progress_distance).max(1.0);
        self.stuck_at.is_some_and(|stuck_at| (here.translation() - stuck_at.translation()).norm() > far)
    }

    /// No path, or no progress on it: the next recovery behaviour, or the end.
    fn get_nowhere(&mut self, request: &NavigationRequest<'_>) -> Result<NavigationCommand, Error> {
        let planned = self.since_plan == 0.0;
        if self.no_path.is_some() && self.progress.standing() < self.params.blocked_time {
            // Another look may show a way.
            let mut command = stop(request, NavigationStatus::Waiting(BlockReason::Obstacle))?;
            command.planned = planned;
            return Ok(command);
        }
        if self.recoveries >= self.params.recoveries {
            let reason = match (self.no_path, self.blocked) {
                (Some(reason), _) => GiveUpReason::NoPath(reason),
                (None, Some(reason)) => GiveUpReason::Blocked(reason),
                (None, None) => GiveUpReason::NoProgress,
            };
            self.ended = Some(NavigationStatus::GaveUp(reason));
            return stop(request, NavigationStatus::GaveUp(reason));
        }
        let behaviour = Behaviour::new(self.recoveries, request, self.route.path(), self.params.look_again);
        self.recoveries += 1;
        self.stuck_at.get_or_insert(request.state.map_from_base);
        let (kind, forget_map) = (behaviour.kind(), behaviour.forgets_map());
        self.behaviour = Some(behaviour);
        let mut command = stop(request, NavigationStatus::Recovering(kind))?;
        (command.forget_map, command.planned) = (forget_map, planned);
        Ok(command)
    }
}

/// Brakes.
fn stop(request: &NavigationRequest<'_>, status: NavigationStatus) -> Result<NavigationCommand, Error> {
    let motion: Motion = request.limits.brake(&request.state.motion(), request.dt)?;
    Ok(NavigationCommand { motion, status, forget_map: false, planned: false })
}
