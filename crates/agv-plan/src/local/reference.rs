//! What a path asks of the vehicle now: to drive, to turn on the spot, or to rest.
//!
//! The path is taken once and followed by arc length; a cycle in which it is the same costs a comparison of its points. Driving ends
//! where the vehicle must stop: at a cusp, before a turn on the spot, at the goal. There it has arrived within the goal's tolerance,
//! turns to the heading that is asked for, if it can, and goes on with the next section.

use super::check_request;
use crate::Error;
use agv_core::{
    check,
    geometry::{Se2, angle_difference},
    path::{Course, Gear, Leg, Path, PathPoint, Projection},
    roles::{LocalPlanError, LocalPlanRequest},
};
use nalgebra::Vector2;
use std::f64::consts::PI;

/// Parameters of a [`Reference`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ReferenceParams {
    /// Distance from the goal, or from a place where the vehicle must stop on the way, at which it has arrived there, in metres.
    pub goal_tolerance: f64,
    /// Heading error at which a turn on the spot ends, in radians; π for any heading.
    pub heading_tolerance: f64,
    /// Distance from the path beyond which the planner should give it up, in metres.
    pub max_cross_track: f64,
    /// How far the vehicle's place on the path may jump ahead in a cycle, in metres: less than what a path takes to come back to
    /// itself.
    pub reach: f64,
    /// Length over which a corner of the path is read as a bend, in metres.
    pub bend_window: f64,
}

impl Default for ReferenceParams {
    /// 10 cm and 0.1 rad: what a local planner that samples or optimises reaches without creeping; a metre and a half beside the path,
    /// as wide as what a vehicle drives around; half a metre of bends, as the trackers have.
    fn default() -> Self {
        Self { goal_tolerance: 0.1, heading_tolerance: 0.1, max_cross_track: 1.5, reach: 2.0, bend_window: 0.5 }
    }
}

/// What the path asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    /// To drive along it.
    Drive(Drive),
    /// To come to rest here, if it moves, and to turn on the spot by this angle, in radians, positive to the left.
    Turn(f64),
    /// To come to rest: this is the goal.
    Arrive,
    /// Nothing: the vehicle is too far away.
    OffPath,
}

/// Where on the path a vehicle drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// The nearest point of the path.
    pub projection: Projection,
    /// Which way the vehicle faces while it drives.
    pub gear: Gear,
    /// Arc length of the next place where it must stop, in metres.
    pub stop: f64,
    /// Pose of the base at that place.
    pub stop_pose: Se2,
    /// Whether that is the goal.
    pub is_last: bool,
    /// Length of the path from the nearest point to the goal, in metres.
    pub remaining: f64,
}

impl Drive {
    /// Length of the path to the next stop, in metres.
    pub fn to_stop(&self) -> f64 {
        self.stop - self.projection.arc_length
    }
}

/// Follows the vehicle along its path.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams};
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::Path;
/// use agv_core::roles::{LocalPlanRequest, VehicleState};
/// use agv_plan::local::{Reference, ReferenceParams, Task};
///
/// let map = Grid::filled(GridLayout::new(100, 40, 0.05, Se2::default())?, CellState::Free);
/// let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default())?;
/// let path = Path::from_positions(&[Vector2::new(1.0, 1.0), Vector2::new(4.0, 1.0)])?;
/// let limits = MotionLimits::default();
/// let at = |x: f64, yaw: f64| LocalPlanRequest {
///     state: VehicleState::new(Se2::new(x, 1.05, yaw), Twist2::ZERO),
///     path: &path,
///     map: &map,
///     obstacles: &[],
///     limits: &limits,
///     dt: 0.1,
/// };
/// let mut reference = Reference::new(ReferenceParams::default())?;
/// let Task::Drive(drive) = reference.update(&at(2.0, 0.0))? else { panic!() };
/// assert_eq!((drive.remaining, drive.is_last), (2.0, true));
/// assert!(matches!(reference.update(&at(3.99, 0.5))?, Task::Turn(angle) if (angle + 0.5).abs() < 1e-9));
/// assert_eq!(reference.update(&at(3.99, 0.0))?, Task::Arrive);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    params: ReferenceParams,
    course: Course,
    /// The path that was taken.
    taken: Vec<PathPoint>,
    /// Whether it was taken in the last cycle.
    is_new: bool,
    /// Whether the vehicle reached the stop of the present section, and only turns or rests there.
    at_stop: bool,
}

/// How much farther than the tolerance a vehicle that arrived may be pushed before it drives again.
const PUSHED: f64 = 2.0;

/// Speed below which a vehicle stands, in metres and radians per second.
const AT_REST: f64 = 0.02;

impl Reference {
    /// A reference without a path.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: ReferenceParams) -> Result<Self, Error> {
        check::positive("goal_tolerance", params.goal_tolerance)?;
        check::in_range("heading_tolerance", params.heading_tolerance, 1e-6, PI)?;
        check::positive("max_cross_track", params.max_cross_track)?;
        check::positive("reach", params.reach)?;
        check::positive("bend_window", params.bend_window)?;
        let course = Course::new(params.bend_window);
        Ok(Self { params, course, taken: Vec::new(), is_new: false, at_stop: false })
    }

    /// The parameters.
    pub const fn params(&self) -> &ReferenceParams {
        &self.params
    }

    /// The path by arc length.
    pub const fn course(&self) -> &Course {
        &self.course
    }

    /// Whether the last update took another path.
    pub const fn is_new(&self) -> bool {
        self.is_new
    }

    /// Forgets the path.
    pub fn reset(&mut self) {
        self.taken.clear();
        self.at_stop = false;
    }

    /// Follows the vehicle, and says what the path asks for. O(points) to compare the path, amortised O(1) else.
    ///
    /// A path of one pose is the straight way there from where the vehicle is when the path is taken.
    ///
    /// # Errors
    /// An empty path, or a value of the request that is refused.
    pub fn update(&mut self, request: &LocalPlanRequest<'_>) -> Result<Task, LocalPlanError> {
        check_request(request)?;
        Ok(self.update_trusted(request))
    }

    /// [`update`](Self::update) with a request that was checked.
    pub(crate) fn update_trusted(&mut self, request: &LocalPlanRequest<'_>) -> Task {
        let pose = request.state.map_from_base;
        // A way that was too short to be one may have become longer.
        let pushed = self.course.is_empty() && self.is_away(&pose);
        self.is_new = pushed || self.taken != request.path.points();
        if self.is_new {
            self.take(request.path, &pose);
        }
        let Some(goal) = self.taken.last().map(|point| point.pose) else { return Task::Arrive };
        // A path without any way on it: what is left is the heading.
        if self.course.is_empty() {
            return self.at_goal(request, &goal);
        }
        let can_turn = request.limits.turns_on_the_spot();
        // Every pass but the last goes on with another section.
        loop {
            match self.course.leg() {
                Leg::Turn(yaw) if can_turn && !self.course.is_last_section() => {
                    let error = angle_difference(yaw, pose.yaw());
                    if error.abs() > self.params.heading_tolerance {
                        return Task::Turn(error);
                    }
                }
                Leg::Turn(_) => {}
                Leg::Drive(gear) => {
                    if let Some(task) = self.drive(request, gear, &goal) {
                        return task;
                    }
                }
            }
            self.at_stop = false;
            if !self.course.next_section() {
                return self.at_goal(request, &goal);
            }
        }
    }

    /// The task on a section that is driven; none if it is done.
    fn drive(&mut self, request: &LocalPlanRequest<'_>, gear: Gear, goal: &Se2) -> Option<Task> {
        let position = request.state.map_from_base.translation();
        let first = if self.is_new { self.first_reach(&position) } else { self.params.reach };
        let projection = self.course.advance(&position, first)?;
        let stop = self.course.section_end();
        let (end, direction) = self.course.point_at(stop)?;
        let is_last = self.is_last_drive();
        let tolerance = self.params.goal_tolerance * if self.at_stop { PUSHED } else { 1.0 };
        // Near the end of the section along the path, too: a path may pass its own end before.
        let near = stop - projection.arc_length <= tolerance.max(projection.cross_track.abs());
        self.at_stop = near && (position - end).norm() <= tolerance;
        if self.at_stop {
            if is_last {
                return Some(self.at_goal(request, goal));
            }
            let twist = request.state.twist;
            let rests = twist.speed() <= AT_REST && twist.yaw_rate.abs() <= AT_REST;
            return (!rests).then_some(Task::Turn(0.0));
        }
        if projection.cross_track.abs() > self.params.max_cross_track {
            return Some(Task::OffPath);
        }
        let facing = if gear == Gear::Reverse { direction.angle() + PI } else { direction.angle() };
        let yaw = if is_last { goal.yaw() } else { facing };
        let stop_pose = Se2::new(end.x, end.y, yaw);
        let remaining = self.course.length() - projection.arc_length;
        Some(Task::Drive(Drive { projection, gear, stop, stop_pose, is_last, remaining }))
    }

    /// Whether nothing but a turn on the spot follows the present section.
    fn is_last_drive(&self) -> bool {
        self.course.is_last_section() || self.course.section_end() >= self.course.length()
    }

    /// The vehicle is where the path ends.
    fn at_goal(&self, request: &LocalPlanRequest<'_>, goal: &Se2) -> Task {
        let error = angle_difference(goal.yaw(), request.state.map_from_base.yaw());
        let turns = request.limits.turns_on_the_spot() && error.abs() > self.params.heading_tolerance;
        if turns { Task::Turn(error) } else { Task::Arrive }
    }

    /// How far to look for the vehicle on a path that it did not follow before: nearby if it is at the beginning, else anywhere.
    fn first_reach(&self, position: &Vector2<f64>) -> f64 {
        let begin = self.taken.first().map_or(f64::INFINITY, |point| (point.pose.translation() - position).norm());
        if begin <= 0.5 * self.params.reach { self.params.reach } else { f64::INFINITY }
    }

    fn is_away(&self, pose: &Se2) -> bool {
        let distance = |goal: &PathPoint| (goal.pose.translation() - pose.translation()).norm();
        self.taken.last().is_some_and(|goal| distance(goal) > PUSHED * self.params.goal_tolerance)
    }

    fn take(&mut self, path: &Path, pose: &Se2) {
        self.taken.clear();
        self.taken.extend_from_slice(path.points());
        self.at_stop = false;
        if self.course.set(path).is_err() {
            self.take_one(path, pose);
        }
    }

    /// All points are one: the straight way there.
    fn take_one(&mut self, path: &Path, pose: &Se2) {
        self.course = Course::new(self.params.bend_window);
        let Some(goal) = path.points().last() else { return };
        let ahead = goal.pose.translation() - pose.translation();
        if ahead.norm() <= self.params.goal_tolerance {
            return;
        }
        let start = Se2::new(pose.x(), pose.y(), ahead.y.atan2(ahead.x));
        let points = [PathPoint { pose: start, gear: goal.gear }, *goal];
        let mut way = Path::new();
        // Both were finite before, and a course of two places exists.
        if points.into_iter().try_for_each(|point| way.push(point)).is_ok() {
            let _ = self.course.set(&way);
        }
    }
}

#[cfg(test)]
mod tests;
