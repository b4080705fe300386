//! Stopping over a code: the vehicle's scanner on the centre of a floor code, with the code's heading (paper 001, section 3.1).
//!
//! ```text
//!              far enough behind                   within tolerance
//!   start ------------------------> Approaching ---------------------> Centred
//!     |                              ^       |
//!     | too near                     |       | off, attempts left
//!     +----------> BackingUp --------+ <-----+               off, none left -----> Failed
//! ```
//!
//! A vehicle that cannot move sideways mends a sideways error by a run-up: tail first along the code's axis, and ahead again.
//! The way is driven by a path tracker, whichever one, on a path of two or three points; this says which path, and when it is good.

use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se2, Twist2},
    kinematics::{Motion, MotionLimits},
    path::{Gear, Path, PathPoint},
    roles::{PathTracker, TrackError, TrackStatus, VehicleState},
};

/// Parameters of a [`Centring`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CentringParams {
    /// Distance behind the goal from which it is approached, in metres: what the tracker needs to come onto the axis.
    pub run_up: f64,
    /// Greatest speed of the approach, in metres per second; the limits of the call count, too.
    pub speed: f64,
    /// Greatest deceleration of the approach, in metres per second squared: drives that lag by τ overshoot by about `a τ²`.
    pub deceleration: f64,
    /// Distance from the goal within which the vehicle is centred, in metres.
    pub position_tolerance: f64,
    /// Heading error within which the vehicle is centred, in radians.
    pub heading_tolerance: f64,
    /// Time at rest before it is judged, in seconds: until drives that lag have come to rest, and the filter has seen it.
    pub settle_time: f64,
    /// Approaches before giving up.
    pub attempts: u32,
}

impl Default for CentringParams {
    /// A bit more than half a metre, which trackers with a look-ahead of 0.4 m need; slow, so that drives that
    /// lag by 0.15 s stop within 5 mm; 1.2 cm and 1.5°, a little more than a code's camera and a good tracker leave; half a
    /// second of rest; three attempts.
    fn default() -> Self {
        Self {
            run_up: 0.6,
            speed: 0.25,
            deceleration: 0.2,
            position_tolerance: 0.012,
            heading_tolerance: 0.026,
            settle_time: 0.5,
            attempts: 3,
        }
    }
}

/// How far a [`Centring`] has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum CentringStatus {
    /// On the way to the goal.
    Approaching,
    /// Tail first, for a run-up.
    BackingUp,
    /// At rest over the code.
    Centred,
    /// At rest, and off after the last attempt.
    Failed,
}

/// What to do for the next cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CentringStep {
    /// Motion for the next cycle, within the limits.
    pub motion: Motion,
    /// How far it has come.
    pub status: CentringStatus,
    /// The vehicle's pose relative to the goal: ahead of it, to its left, turned to its left.
    pub goal_from_base: Se2,
}

/// Drives a vehicle onto a code and says when it is there. Feed it with the pose that a filter makes of codes and odometry.
///
/// ```
/// use agv_nav::{control::track::*, core::kinematics::*, pipeline::*, prelude::*};
///
/// let tracker = Stanley::new(StanleyParams::default())?;
/// let mut centring = Centring::new(Box::new(tracker), CentringParams::default())?;
/// // The camera is 20 cm ahead of the middle: the vehicle is to stop 20 cm before the code.
/// let goal = Centring::base_over(&Se2::new(2.0, 1.0, 0.0), &Se2::new(0.2, 0.0, 0.0));
/// assert!((goal.x() - 1.8).abs() < 1e-12);
/// let (limits, mut state) = (MotionLimits::default(), VehicleState::new(Se2::new(0.8, 1.05, 0.1), Twist2::ZERO));
/// centring.start(&goal, &state)?;
/// let arrived = (0..2000).any(|_| {
///     let step = centring.command(&state, &limits, 0.02).unwrap();
///     state = state.after(&step.motion, 0.02);
///     step.status == CentringStatus::Centred
/// });
/// assert!(arrived && (state.map_from_base.translation() - goal.translation()).norm() < 0.012);
/// # Ok::<(), agv_nav::Error>(())
/// ```
pub struct Centring {
    tracker: Box<dyn PathTracker + Send>,
    params: CentringParams,
    goal: Option<Se2>,
    status: CentringStatus,
    /// Approaches that were begun.
    begun: u32,
    /// Seconds since the end of the approach.
    at_rest: f64,
}

/// Shortest approach that is one, in metres: a path needs a length.
const SHORTEST: f64 = 0.05;

impl Centring {
    /// A centring that is driven by this tracker.
    ///
    /// # Errors
    /// A length or a tolerance that is not positive, or no attempt.
    pub fn new(tracker: Box<dyn PathTracker + Send>, params: CentringParams) -> Result<Self, Error> {
        check::in_range("run_up", params.run_up, SHORTEST, 1e3)?;
        check::positive("speed", params.speed)?;
        check::positive("deceleration", params.deceleration)?;
        check::positive("position_tolerance", params.position_tolerance)?;
        check::positive("heading_tolerance", params.heading_tolerance)?;
        check::non_negative("settle_time", params.settle_time)?;
        check::at_least("attempts", params.attempts as usize, 1)?;
        Ok(Self { tracker, params, goal: None, status: CentringStatus::Failed, begun: 0, at_rest: 0.0 })
    }

    /// Where the vehicle stands when its scanner at `base_from_scanner` is over the code, and turned as the code.
    pub fn base_over(map_from_code: &Se2, base_from_scanner: &Se2) -> Se2 {
        *map_from_code * base_from_scanner.inverse()
    }

    /// Sets out for `map_from_base`, the pose to stop at.
    ///
    /// # Errors
    /// A goal or a state that is not finite; a path that the tracker refuses.
    pub fn start(&mut self, map_from_base: &Se2, state: &VehicleState) -> Result<(), Error> {
        check::all_finite("goal", &[map_from_base.x(), map_from_base.y(), map_from_base.yaw()])?;
        state.validate()?;
        self.set_out(map_from_base, &state.map_from_base)?;
        (self.goal, self.begun) = (Some(*map_from_base), 1);
        Ok(())
    }

    /// How far it has come.
    pub const fn status(&self) -> CentringStatus {
        self.status
    }

    /// The motion for the next `dt` seconds; brakes once it is centred or has failed.
    ///
    /// # Errors
    /// [`TrackError::NoPath`] before [`start`](Self::start), or what the tracker refuses.
    pub fn command(&mut self, state: &VehicleState, limits: &MotionLimits, dt: f64) -> Result<CentringStep, Error> {
        let goal = self.goal.ok_or(TrackError::NoPath)?;
        let command = self.tracker.command(state, &self.gentle(state, limits), dt)?;
        let goal_from_base = goal.between(&state.map_from_base);
        // Off the path the tracker brakes, which takes a while.
        let is_over = match command.status {
            TrackStatus::Arrived => true,
            TrackStatus::OffPath => command.motion.twist == Twist2::ZERO,
            _ => false,
        };
        let under_way = matches!(self.status, CentringStatus::Approaching | CentringStatus::BackingUp);
        self.at_rest = if is_over { self.at_rest + dt } else { 0.0 };
        if under_way && is_over && self.at_rest >= self.params.settle_time {
            let is_centred = goal_from_base.translation().norm() <= self.params.position_tolerance
                && goal_from_base.yaw().abs() <= self.params.heading_tolerance;
            if is_centred {
                self.status = CentringStatus::Centred;
            } else if self.begun < self.params.attempts {
                self.set_out(&goal, &state.map_from_base)?;
                self.begun += 1;
            } else {
                self.status = CentringStatus::Failed;
            }
        } else if self.status == CentringStatus::BackingUp && -goal_from_base.x() >= self.params.run_up - SHORTEST {
            self.status = CentringStatus::Approaching;
        }
        Ok(CentringStep { motion: command.motion, status: self.status, goal_from_base })
    }

    /// The limits of the approach; a vehicle that comes in faster brakes as it can.
    fn gentle(&self, state: &VehicleState, limits: &MotionLimits) -> MotionLimits {
        let mut gentle = *limits;
        let twist = &mut gentle.twist;
        twist.forward_speed = twist.forward_speed.min(self.params.speed);
        twist.reverse_speed = twist.reverse_speed.min(self.params.speed);
        if state.twist.vx.abs() <= self.params.speed {
            twist.deceleration = twist.deceleration.min(self.params.deceleration);
        }
        gentle
    }

    /// Lays the path along the goal's axis, level with the vehicle: straight on, or back first if it is too near.
    fn set_out(&mut self, goal: &Se2, map_from_base: &Se2) -> Result<(), Error> {
        let behind = -goal.between(map_from_base).x();
        let mut path = Path::new();
        let mut push = |behind: f64, gear| path.push(PathPoint { pose: *goal * Se2::new(-behind, 0.0, 0.0), gear });
        let backs_up = behind < self.params.run_up;
        if backs_up {
            push(behind.min(self.params.run_up - SHORTEST), Gear::Reverse)?;
            push(self.params.run_up, Gear::Reverse)?;
        } else {
            push(behind, Gear::Forward)?;
        }
        push(0.0, Gear::Forward)?;
        self.tracker.set_path(&path)?;
        self.at_rest = 0.0;
        self.status = if backs_up { CentringStatus::BackingUp } else { CentringStatus::Approaching };
        Ok(())
    }
}
