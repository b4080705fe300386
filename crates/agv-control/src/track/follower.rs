//! What all trackers share: progress, speed, limits and arrival.

use super::{
    course::{Course, Projection},
    speed,
};
use agv_core::{
    Error, check,
    geometry::{Twist2, angle_difference},
    kinematics::{TwistLimits, stopping_speed},
    path::{Gear, Path},
    roles::{PathTracker, TrackCommand, TrackError, TrackStatus, VehicleState},
};
use std::f64::consts::PI;

/// What a steering law knows in one cycle.
///
/// Everything is in the direction of travel: on a reverse section the vehicle's tail leads, and `heading` is the tail's.
#[derive(Debug, Clone, Copy)]
pub struct SteeringInput<'a> {
    /// The path, with [`Course::point_at`] for points ahead.
    pub course: &'a Course,
    /// The vehicle's place on it.
    pub projection: Projection,
    /// The vehicle's position in the map, in metres.
    pub position: nalgebra::Vector2<f64>,
    /// Direction that the vehicle's leading end points to, in radians.
    pub heading: f64,
    /// Heading of the leading end relative to the path, in radians.
    pub heading_error: f64,
    /// Speed that is planned for this cycle, in metres per second, not negative.
    pub speed: f64,
    /// What the vehicle can do.
    pub limits: &'a TwistLimits,
    /// Time until the next cycle, in seconds.
    pub dt: f64,
}

/// How to turn: the part in which trackers differ.
pub trait Steering {
    /// Turn rate for the next cycle, in radians per second.
    ///
    /// # Errors
    /// Whatever the law's parts refuse; the follower then commands nothing.
    fn yaw_rate(&mut self, input: &SteeringInput<'_>) -> Result<f64, TrackError>;

    /// Forgets the past: there is a new path, or a new section of it.
    fn reset(&mut self);
}

/// Parameters of a [`Follower`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FollowerParams {
    /// Greatest acceleration to the side in a bend, in metres per second squared.
    pub lateral_acceleration: f64,
    /// Heading error above which the vehicle turns on the spot before it drives, in radians; π for vehicles that
    /// cannot turn on the spot.
    pub turn_in_place: f64,
    /// Time by which the vehicle's speed lags behind the command, in seconds: it rolls on for so long when it stops.
    pub response_time: f64,
    /// Distance from the end of the path, along it, at which the vehicle stops, in metres.
    pub goal_tolerance: f64,
    /// Distance from the end of the path at which a vehicle that stopped has arrived, in metres: beyond it the tracker
    /// reports [`TrackStatus::OffPath`].
    pub arrival_tolerance: f64,
    /// Distance from the path beyond which the vehicle stops and reports [`TrackStatus::OffPath`], in metres.
    pub max_cross_track: f64,
}

impl Default for FollowerParams {
    /// An indoor AGV with a load that must not shift: 0.5 m/s² to the side, turning on the spot beyond 45° as Nav2's
    /// regulated pure pursuit does, drives that settle within half a second, a stop 1 cm before the end, and 10 cm of
    /// room for noise and overshoot.
    fn default() -> Self {
        Self {
            lateral_acceleration: 0.5,
            turn_in_place: PI / 4.0,
            response_time: 0.15,
            goal_tolerance: 0.01,
            arrival_tolerance: 0.1,
            max_cross_track: 1.0,
        }
    }
}

/// A path tracker with the steering law `S`; the [`PathTracker`] role.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower<S> {
    params: FollowerParams,
    course: Course,
    steering: S,
    /// Whether the vehicle is turning on the spot: it goes on until it is well aligned.
    turning: bool,
}

/// Share of `turn_in_place` at which turning on the spot ends.
const ALIGNED: f64 = 0.2;

impl<S: Steering> Follower<S> {
    /// A tracker that steers by `steering`.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn with_steering(params: FollowerParams, steering: S) -> Result<Self, Error> {
        check::positive("lateral_acceleration", params.lateral_acceleration)?;
        check::in_range("turn_in_place", params.turn_in_place, 0.01, PI)?;
        check::non_negative("response_time", params.response_time)?;
        check::positive("goal_tolerance", params.goal_tolerance)?;
        check::in_range("arrival_tolerance", params.arrival_tolerance, params.goal_tolerance, f64::MAX)?;
        check::positive("max_cross_track", params.max_cross_track)?;
        Ok(Self { params, course: Course::default(), steering, turning: false })
    }

    /// The path as the tracker sees it.
    pub const fn course(&self) -> &Course {
        &self.course
    }

    /// Speed along the course that bends and the stop ahead allow, in metres per second.
    fn planned_speed(&self, to_stop: f64, limits: &TwistLimits, dt: f64) -> f64 {
        let top = if self.course.gear() == Gear::Forward { limits.forward_speed } else { limits.reverse_speed };
        speed::speed_for_bends(self.course.bends_ahead(), limits, self.params.lateral_acceleration, top)
            .min(stopping_speed(to_stop, limits.deceleration, dt + self.params.response_time))
    }
}

impl<S: Steering> PathTracker for Follower<S> {
    fn set_path(&mut self, path: &Path) -> Result<(), TrackError> {
        self.course.set(path)?;
        self.steering.reset();
        self.turning = false;
        Ok(())
    }

    fn command(&mut self, state: &VehicleState, limits: &TwistLimits, dt: f64) -> Result<TrackCommand, TrackError> {
        let (pose, twist) = (state.map_from_base, state.twist);
        check::all_finite("map_from_base", &[pose.x(), pose.y(), pose.yaw()])?;
        check::all_finite("twist", &[twist.vx, twist.vy, twist.yaw_rate])?;
        limits.validate()?;
        check::positive("dt", dt)?;

        // Far enough ahead that a fast vehicle is found again, near enough that a crossing branch is not.
        let reach = 4.0 * limits.forward_speed.max(limits.reverse_speed) * dt + self.params.max_cross_track;
        let projection = self.course.advance(&pose.translation(), reach).ok_or(TrackError::NoPath)?;
        let to_stop = self.course.section_end() - projection.arc_length;
        let at_stop = to_stop <= self.params.goal_tolerance;
        // At a stop the nearest point is the end of the section, so the error is the distance from it.
        let tolerance = if at_stop { self.params.arrival_tolerance } else { self.params.max_cross_track };
        let off_path = projection.cross_track.abs() > tolerance;

        let sign = if self.course.gear() == Gear::Forward { 1.0 } else { -1.0 };
        let heading = if sign > 0.0 { pose.yaw() } else { pose.yaw() + PI };
        let heading_error = angle_difference(heading, projection.direction);
        let remaining = self.course.length() - projection.arc_length;
        let done = |twist: Twist2, status: TrackStatus| TrackCommand {
            twist,
            status,
            cross_track_error: projection.cross_track,
            heading_error,
            remaining,
        };
        if at_stop || off_path {
            let twist = limits.step(&twist, &Twist2::ZERO, dt)?;
            let rests = twist == Twist2::ZERO;
            if at_stop && rests && !off_path {
                if self.course.next_section() {
                    self.steering.reset();
                    self.turning = false;
                    return Ok(done(twist, TrackStatus::Tracking));
                }
                return Ok(done(twist, TrackStatus::Arrived));
            }
            return Ok(done(twist, if off_path { TrackStatus::OffPath } else { TrackStatus::Tracking }));
        }

        let planned = self.planned_speed(to_stop, limits, dt);
        let input = SteeringInput {
            course: &self.course,
            projection,
            position: pose.translation(),
            heading,
            heading_error,
            speed: planned,
            limits,
            dt,
        };
        let threshold = self.params.turn_in_place * if self.turning { ALIGNED } else { 1.0 };
        let turning = self.params.turn_in_place < PI && heading_error.abs() > threshold;
        let (wanted_speed, wanted_rate) = if turning {
            // On the spot, braking in time to face the path.
            let rate = stopping_speed(heading_error.abs(), limits.yaw_acceleration, dt).min(limits.yaw_rate);
            (0.0, -rate.copysign(heading_error))
        } else {
            let rate = self.steering.yaw_rate(&input)?;
            // A rate beyond the limit slows the vehicle down, so that the curve stays the one that was asked for.
            (planned * (limits.yaw_rate / rate.abs()).min(1.0), rate.clamp(-limits.yaw_rate, limits.yaw_rate))
        };
        self.turning = turning;
        let wanted = Twist2::new(sign * wanted_speed, 0.0, wanted_rate);
        Ok(done(limits.step(&twist, &wanted, dt)?, TrackStatus::Tracking))
    }
}
