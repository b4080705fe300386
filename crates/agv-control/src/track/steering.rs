//! How to move: the part in which trackers differ.

use super::{follower::Facing, lateral::LEAST_SPEED};
use agv_core::{
    geometry::{LieGroup, Se2, So2, Twist2, angle_difference, small_angle},
    kinematics::{MotionLimits, stopping_speed},
    path::{Course, Gear, Projection, SpeedProfile},
    roles::{TrackError, VehicleState},
};

/// What a steering law knows in one cycle.
///
/// Everything but `state` is in the direction of travel: on a reverse section the vehicle's tail leads, and `heading` is the
/// tail's.
#[derive(Debug, Clone, Copy)]
pub struct SteeringInput<'a> {
    /// The path, with [`Course::point_at`] for points ahead.
    pub course: &'a Course,
    /// Greatest speed for the bends ahead, by arc length, for laws that look ahead.
    pub profile: &'a SpeedProfile,
    /// The vehicle's place on the path.
    pub projection: Projection,
    /// The vehicle's position in the map, in metres.
    pub position: nalgebra::Vector2<f64>,
    /// Direction that the vehicle's leading end points to, in the map.
    pub heading: So2,
    /// Heading of the leading end relative to the path, in radians.
    pub heading_error: f64,
    /// Velocity in the frame of the leading end, as it was reported.
    pub twist: Twist2,
    /// Velocity that the vehicle is believed to have, in the frame of the leading end: what was reported, late by the lag of the
    /// drives, and with the slip that was learnt.
    pub actual: Twist2,
    /// Time constant of the drives' lag, in seconds.
    pub response_time: f64,
    /// How a vehicle that moves to any side is to face; none for all others.
    pub facing: Option<Facing>,
    /// Speed that is planned for this cycle, in metres per second, not negative: bends, the stop ahead and the limits allow it.
    pub speed: f64,
    /// The vehicle as it is, in its base frame.
    pub state: &'a VehicleState,
    /// How the section is driven.
    pub gear: Gear,
    /// What the vehicle can do.
    pub limits: &'a MotionLimits,
    /// Time until the next cycle, in seconds.
    pub dt: f64,
}

/// Where the vehicle will be on its path when its drives have done what they were told.
///
/// With these in place of the present errors a law is free of the lag: `cross_track' = v sin(heading_error)` and
/// `heading_error' = command - v curvature`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Place on the path, in metres from its beginning.
    pub arc_length: f64,
    /// Distance from the path, in metres; positive to the left of the direction of travel.
    pub cross_track: f64,
    /// Heading of the leading end relative to the path with its corners rounded off, in radians.
    pub heading_error: f64,
    /// Turn of the path per metre at that place, in 1/m.
    pub curvature: f64,
}

impl SteeringInput<'_> {
    /// The errors that a law should mend: those of the moment when the drives have done what they were told, a
    /// [`response_time`](Self::response_time) ahead.
    ///
    /// # Errors
    /// [`TrackError::NoPath`].
    #[inline]
    pub fn predicted(&self) -> Result<Prediction, TrackError> {
        let here = self.projection.arc_length;
        let (v, time) = (self.actual.vx, self.response_time);
        let heading_error = self.course.angle_from(here, self.heading).ok_or(TrackError::NoPath)?;
        let turning = self.actual.yaw_rate - v * self.course.curvature_at(here);
        let (sin, cos) = small_angle::sin_cos(heading_error);
        let sideways = v * sin + self.actual.vy * cos;
        let arc_length = here + (v * time).max(0.0);
        Ok(Prediction {
            arc_length,
            cross_track: self.projection.cross_track + time * sideways,
            heading_error: heading_error + time * turning,
            curvature: self.course.curvature_at(arc_length),
        })
    }

    /// Position and heading of the leading end when the drives have done what they were told: the present ones, coasting for the
    /// [`response_time`](Self::response_time).
    #[inline]
    pub fn predicted_pose(&self) -> Se2 {
        Se2::from_parts(self.position, self.heading).compose(&self.actual.integrate(self.response_time))
    }

    /// The turn rate that mends a heading error (what is wanted less what is) at `gain` per second, but none that the yaw
    /// acceleration cannot end in time: that would swing past the direction. In radians per second.
    #[inline]
    pub fn turn_rate(&self, error: f64, gain: f64) -> f64 {
        let stoppable = stopping_speed(error.abs(), BRAKING_SHARE * self.turning_acceleration(), self.dt);
        // Not a clamp, which panics where the bound is no number.
        (gain * error).max(-stoppable).min(stoppable)
    }

    /// How fast the turn rate can change, in radians per second squared: by the yaw acceleration, or at the present speed by the
    /// steering rate.
    #[inline]
    pub fn turning_acceleration(&self) -> f64 {
        match &self.limits.steering {
            Some(steering) => self.actual.vx.max(LEAST_SPEED) * steering.max_rate / steering.wheelbase,
            None => self.limits.twist.yaw_acceleration,
        }
    }

    /// For a vehicle that moves to any side: the planned speed at `approach` radians to the left of the path, while the vehicle
    /// turns to face as it should.
    ///
    /// # Errors
    /// [`TrackError::NoPath`].
    pub fn sideways(&self, facing: Facing, predicted: &Prediction, approach: f64) -> Result<Twist2, TrackError> {
        let (sin, cos) = (approach - predicted.heading_error).sin_cos();
        let (error, turn) = match facing {
            Facing::Travel => (predicted.heading_error, predicted.curvature),
            Facing::Path => {
                let yaw = |s| self.course.yaw_at(s).ok_or(TrackError::NoPath);
                let half = 0.5 * self.course.bend_window();
                let (behind, ahead) = (yaw(predicted.arc_length - half)?, yaw(predicted.arc_length + half)?);
                let base = self.state.map_from_base.yaw() + self.response_time * self.actual.yaw_rate;
                let turn = angle_difference(ahead, behind) / (2.0 * half);
                (angle_difference(base, behind + half * turn), turn)
            }
        };
        let yaw_rate = self.speed * turn + self.turn_rate(-error, FACING_GAIN);
        Ok(Twist2::new(self.speed * cos, self.speed * sin, yaw_rate))
    }
}

/// Share of the yaw acceleration that ending a turn may take; the rest is there for the lag of the actuators.
pub(super) const BRAKING_SHARE: f64 = 0.5;

/// Turn rate per error of where the vehicle faces, in 1/s, for vehicles whose way does not depend on it.
const FACING_GAIN: f64 = 2.0;

/// How to move along a path: the part in which trackers differ.
pub trait Steering {
    /// Twist that is wanted for the next cycle, in the frame of the leading end.
    ///
    /// The follower slows it down along its curvature to the planned speed, and steps towards it within the limits.
    ///
    /// # Errors
    /// Whatever the law's parts refuse; the follower then commands nothing. The state has been taken in all the same (progress,
    /// lag, slip): brake, and go on with the next cycle's; do not repeat the call.
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError>;

    /// Sees every state before anything is commanded, also in cycles in which the follower stops or turns by itself: for laws that
    /// estimate. The state's twist is what was commanded in the last `dt` seconds.
    fn observe(&mut self, _state: &VehicleState, _dt: f64) {}

    /// Forgets what belongs to the path: there is a new one, or a new section of it.
    fn reset(&mut self);
}
