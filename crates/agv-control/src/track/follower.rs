//! What all trackers share: progress, speed, turns on the spot, limits and arrival.

use super::{
    response::Response,
    steering::{Steering, SteeringInput},
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, So2, Twist2, small_angle},
    kinematics::{Motion, MotionLimits, stopping_speed},
    path::{Course, Gear, Leg, Path, Projection, SpeedProfile},
    roles::{PathTracker, TrackCommand, TrackError, TrackStatus, VehicleState},
};
use std::f64::consts::PI;

/// Where a vehicle that moves to any side faces while it drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Facing {
    /// Along the path, as all others do.
    #[default]
    Travel,
    /// As the path's poses state, whichever way the path leads: no turns on the spot before it drives.
    Path,
}

/// Parameters of a [`Follower`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FollowerParams {
    /// Greatest acceleration to the side in a bend that is planned for, in metres per second squared; the vehicle's own limit counts,
    /// too.
    pub lateral_acceleration: f64,
    /// Length over which a corner of the path is read as a bend, in metres: about what the vehicle may cut off.
    pub bend_window: f64,
    /// Heading error above which a vehicle that can turn on the spot does so before it drives, in radians; π for never.
    pub turn_in_place: f64,
    /// Time constant by which the vehicle's drives lag behind the command, in seconds: the state's twist is then to be what was
    /// commanded last, not what a sensor says, and laws steer by where the vehicle will be.
    pub response_time: f64,
    /// Greatest share by which the vehicle may turn more or less than it is told (slip, worn wheels, a load); the tracker learns
    /// it as it drives, and commands accordingly. Zero for not learning.
    pub max_yaw_slip: f64,
    /// Where a vehicle that moves to any side faces; of no meaning to others.
    pub facing: Facing,
    /// Distance from the end of a section (the path's end, or a cusp), along it, at which the vehicle stops, in metres.
    pub goal_tolerance: f64,
    /// Distance from the end of a section at which a vehicle that stopped there has arrived, in metres: beyond it the tracker
    /// reports [`TrackStatus::OffPath`].
    pub arrival_tolerance: f64,
    /// Heading error at which a turn on the spot ends, in radians.
    pub heading_tolerance: f64,
    /// Heading error at the end of the path with which a vehicle that cannot turn on the spot has arrived all the same, in radians:
    /// beyond it the tracker reports [`TrackStatus::OffPath`].
    pub arrival_heading_tolerance: f64,
    /// Distance from the path beyond which the vehicle stops and reports [`TrackStatus::OffPath`], in metres.
    pub max_cross_track: f64,
}

impl Default for FollowerParams {
    /// An indoor AGV with a load that must not shift: 0.5 m/s² to the side, corners cut off by half a metre, turning on the spot
    /// beyond 45° as Nav2's regulated pure pursuit does, drives that settle within half a second, a tenth of slip, a stop 1 cm
    /// before the end, and 10 cm of room for noise and overshoot; headings to about one degree, and Nav2's 0.25 rad where the vehicle cannot turn.
    fn default() -> Self {
        Self {
            lateral_acceleration: 0.5,
            bend_window: 0.5,
            turn_in_place: PI / 4.0,
            response_time: 0.15,
            max_yaw_slip: 0.1,
            facing: Facing::Travel,
            goal_tolerance: 0.01,
            arrival_tolerance: 0.1,
            heading_tolerance: 0.02,
            arrival_heading_tolerance: 0.25,
            max_cross_track: 1.0,
        }
    }
}

/// A path tracker with the steering law `S`; the [`PathTracker`] role.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower<S> {
    params: FollowerParams,
    course: Course,
    profile: SpeedProfile,
    steering: S,
    /// Whether the vehicle is turning on the spot: it goes on until it is well aligned.
    turning: bool,
    response: Response,
    /// Limits that were checked, and that the profile was made for.
    planned_for: Option<MotionLimits>,
}

/// Share of the deceleration that a stop is planned with: the rest mends what noise and lag make of it. At the full one a
/// vehicle that is late once overshoots.
const STOPPING_SHARE: f64 = 0.8;

/// Share of `turn_in_place` at which turning on the spot ends.
const ALIGNED: f64 = 0.2;

impl<S: Steering> Follower<S> {
    /// A tracker that steers by `steering`.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn with_steering(params: FollowerParams, steering: S) -> Result<Self, Error> {
        check::positive("lateral_acceleration", params.lateral_acceleration)?;
        check::positive("bend_window", params.bend_window)?;
        check::in_range("turn_in_place", params.turn_in_place, 0.01, PI)?;
        check::non_negative("response_time", params.response_time)?;
        check::positive("goal_tolerance", params.goal_tolerance)?;
        check::in_range("arrival_tolerance", params.arrival_tolerance, params.goal_tolerance, f64::MAX)?;
        check::positive("heading_tolerance", params.heading_tolerance)?;
        check::in_range("arrival_heading_tolerance", params.arrival_heading_tolerance, params.heading_tolerance, PI)?;
        check::positive("max_cross_track", params.max_cross_track)?;
        check::in_range("max_yaw_slip", params.max_yaw_slip, 0.0, 0.5)?;
        let course = Course::new(params.bend_window);
        let response = Response::new(params.response_time, params.max_yaw_slip);
        Ok(Self {
            params,
            course,
            profile: SpeedProfile::default(),
            steering,
            turning: false,
            response,
            planned_for: None,
        })
    }

    /// The path as the tracker sees it.
    pub const fn course(&self) -> &Course {
        &self.course
    }

    /// The steering law, for what it has to tell.
    pub const fn steering(&self) -> &S {
        &self.steering
    }

    /// The greatest speed along the course, as of the last command.
    pub const fn profile(&self) -> &SpeedProfile {
        &self.profile
    }

    /// The vehicle stands where the present section ends: goes on with the next, if there is one.
    fn next_section(&mut self) -> TrackStatus {
        if !self.course.next_section() {
            return TrackStatus::Arrived;
        }
        self.steering.reset();
        self.turning = false;
        TrackStatus::Tracking
    }

    /// The command on a section that is driven.
    fn drive(&mut self, cycle: &Cycle<'_>, gear: Gear) -> Result<(Motion, TrackStatus), TrackError> {
        let Cycle { state, actual, limits, dt, projection, heading, heading_error } = *cycle;
        let p = &self.params;
        let to_stop = self.course.section_end() - projection.arc_length;
        let at_stop = to_stop <= p.goal_tolerance;
        // At a stop the nearest point is the end of the section, so the error is the distance from it.
        let tolerance = if at_stop { p.arrival_tolerance } else { p.max_cross_track };
        let off_path = projection.cross_track.abs() > tolerance;
        if at_stop || off_path {
            let motion = limits.brake(&state.motion(), dt)?;
            if off_path {
                return Ok((motion, TrackStatus::OffPath));
            }
            let rests = motion.twist == Twist2::ZERO;
            return Ok((motion, if rests { self.next_section() } else { TrackStatus::Tracking }));
        }
        let facing = limits.is_holonomic().then_some(p.facing);
        let threshold = p.turn_in_place * if self.turning { ALIGNED } else { 1.0 };
        let turns = limits.turns_on_the_spot() && p.turn_in_place < PI && facing != Some(Facing::Path);
        self.turning = turns && heading_error.abs() > threshold;
        if self.turning {
            return Ok((self.turn_by(-heading_error, cycle)?, TrackStatus::Tracking));
        }
        let top = top_speed(limits, gear);
        let planned = self.profile.speed_at(projection.arc_length).min(top);
        let speed = able_to_stop(planned, to_stop, limits.twist.deceleration, dt + p.response_time);
        let twist = in_gear(&state.twist, gear);
        let position = state.map_from_base.translation();
        let (course, profile) = (&self.course, &self.profile);
        let input = SteeringInput {
            course,
            profile,
            projection,
            position,
            heading,
            heading_error,
            twist,
            actual: in_gear(&actual, gear),
            response_time: self.response.time(),
            facing,
            speed,
            state,
            gear,
            limits,
            dt,
        };
        let wanted = self.steering.twist(&input)?;
        // Faster than planned is slowed down, so that the curve stays the one that was asked for.
        let fast = wanted.speed();
        let scale = if fast > speed { speed / fast } else { 1.0 };
        // What the wheels will make of it is what was asked for.
        let yaw_rate = wanted.yaw_rate / self.response.yaw_gain();
        let wanted = Twist2::new(scale * wanted.vx, scale * wanted.vy, scale * yaw_rate);
        let wanted = if scale > 0.0 { wanted } else { Twist2::ZERO };
        check::all_finite("steering law", &[wanted.vx, wanted.vy, wanted.yaw_rate])?;
        Ok((limits.step_checked(&state.motion(), &in_gear(&wanted, gear).into(), dt), TrackStatus::Tracking))
    }

    /// The command in a turn on the spot.
    fn turn(&mut self, cycle: &Cycle<'_>) -> Result<(Motion, TrackStatus), TrackError> {
        let Cycle { state, limits, dt, projection, heading_error, .. } = *cycle;
        let p = &self.params;
        let able = limits.turns_on_the_spot();
        let enough = if able { p.heading_tolerance } else { p.arrival_heading_tolerance };
        let strayed = projection.cross_track.abs() > p.max_cross_track;
        if !strayed && able && heading_error.abs() > enough {
            return Ok((self.turn_by(-heading_error, cycle)?, TrackStatus::Tracking));
        }
        let motion = limits.brake(&state.motion(), dt)?;
        if strayed || heading_error.abs() > enough {
            return Ok((motion, TrackStatus::OffPath));
        }
        let rests = motion.twist == Twist2::ZERO;
        Ok((motion, if rests { self.next_section() } else { TrackStatus::Tracking }))
    }

    /// A turn on the spot by an angle in radians, braking in time to end it.
    fn turn_by(&self, angle: f64, cycle: &Cycle<'_>) -> Result<Motion, Error> {
        let Cycle { state, limits, dt, .. } = *cycle;
        let reaction = dt + self.params.response_time;
        let rate = stopping_speed(angle.abs(), limits.twist.yaw_acceleration, reaction).min(limits.twist.yaw_rate);
        limits.step(&state.motion(), &Twist2::new(0.0, 0.0, rate.copysign(angle)).into(), dt)
    }
}

/// What the parts of a command share.
#[derive(Clone, Copy)]
struct Cycle<'a> {
    state: &'a VehicleState,
    actual: Twist2,
    limits: &'a MotionLimits,
    dt: f64,
    projection: Projection,
    heading: So2,
    heading_error: f64,
}

/// Direction of the end that leads.
pub(super) fn leading_end(rotation: So2, gear: Gear) -> So2 {
    match gear {
        Gear::Forward => rotation,
        Gear::Reverse => rotation.compose(&So2::from_direction(-1.0, 0.0)),
    }
}

/// Greatest speed in a gear, in metres per second.
pub(super) const fn top_speed(limits: &MotionLimits, gear: Gear) -> f64 {
    match gear {
        Gear::Forward => limits.twist.forward_speed,
        Gear::Reverse => limits.twist.reverse_speed,
    }
}

/// A speed, or the greatest below it from which the vehicle stops within a distance, with some of its deceleration in reserve.
pub(super) fn able_to_stop(speed: f64, distance: f64, deceleration: f64, reaction: f64) -> f64 {
    let braking = STOPPING_SHARE * deceleration;
    // Far from the stop there is no need for the root.
    let is_far = 2.0 * braking * (distance - speed * reaction) >= speed * speed;
    if is_far { speed } else { speed.min(stopping_speed(distance, braking, reaction)) }
}

/// From the base frame to that of the leading end, and back.
pub(super) fn in_gear(twist: &Twist2, gear: Gear) -> Twist2 {
    match gear {
        Gear::Forward => *twist,
        Gear::Reverse => Twist2::new(-twist.vx, -twist.vy, twist.yaw_rate),
    }
}

impl<S: Steering> PathTracker for Follower<S> {
    fn set_path(&mut self, path: &Path) -> Result<(), TrackError> {
        self.course.set(path).map_err(|_| TrackError::NoPath)?;
        self.profile.make_room(&self.course);
        self.planned_for = None;
        self.steering.reset();
        self.turning = false;
        Ok(())
    }

    fn command(&mut self, state: &VehicleState, limits: &MotionLimits, dt: f64) -> Result<TrackCommand, TrackError> {
        state.validate()?;
        check::positive("dt", dt)?;
        if self.planned_for.as_ref() != Some(limits) {
            limits.validate()?;
            let lateral = limits.lateral_acceleration.unwrap_or(f64::INFINITY).min(self.params.lateral_acceleration);
            self.profile.update(&self.course, &MotionLimits { lateral_acceleration: Some(lateral), ..*limits });
            self.planned_for = Some(*limits);
        }
        let p = &self.params;
        // Far enough ahead that a fast vehicle is found again, near enough that a crossing branch is not.
        let reach = 4.0 * limits.twist.forward_speed.max(limits.twist.reverse_speed) * dt + p.max_cross_track;
        let pose = state.map_from_base;
        let projection = self.course.advance(&pose.translation(), reach).ok_or(TrackError::NoPath)?;
        let remaining = self.course.length() - projection.arc_length;
        let leg = self.course.leg();
        let gear = if let Leg::Drive(gear) = leg { gear } else { Gear::Forward };
        let heading = leading_end(pose.rotation(), gear);
        let from_path = projection.direction.inverse().compose(&heading);
        let heading_error = small_angle::angle(from_path.cos(), from_path.sin());

        let actual = self.response.update(&state.twist, pose.rotation(), dt);
        self.steering.observe(state, dt);
        let cycle = Cycle { state, actual, limits, dt, projection, heading, heading_error };
        let (motion, status) = match leg {
            Leg::Drive(gear) => self.drive(&cycle, gear)?,
            Leg::Turn(_) => self.turn(&cycle)?,
        };
        Ok(TrackCommand { motion, status, cross_track_error: projection.cross_track, heading_error, remaining })
    }
}
