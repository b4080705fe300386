//! A path tracker as a local planner: it keeps to the path, slows for what is ahead, and stops before it.
//!
//! The vehicle does not swerve. Each cycle looks along the path for the first place at which its outline touches something, and
//! allows the speed from which it can stop before:
//!
//! ```text
//! v² / (2 d) + v dt = s - margin
//! ```
//!
//! What the tracker says is scaled to that, on its own curvature; a command is returned only if it can be driven, and braked from,
//! without a contact. It is the yardstick of local planners: what it reaches is what the global planner is worth alone.

use super::{Guard, GuardParams, check_request};
use crate::Error;
use agv_core::{
    check,
    geometry::{LieGroup, Se2, Twist2, nearest_on_segment},
    grid::Footprint,
    kinematics::{Motion, stopping_speed},
    path::{Gear, Path},
    roles::{
        BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner, PathTracker,
        TrackError, TrackStatus,
    },
};

/// Parameters of a [`Tracked`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TrackedParams {
    /// Length that is kept free before an obstacle on the path, in metres.
    pub margin: f64,
    /// How far ahead on the path it looks, in metres.
    pub look_ahead: f64,
    /// Distance between two looks, in metres.
    pub spacing: f64,
    /// Share of the deceleration that stops are planned with, from above 0 to 1.
    pub stopping_share: f64,
}

impl Default for TrackedParams {
    /// A few centimetres for what tracking errs by; four metres, the way to stop from 2 m/s at half a m/s²; looks a cell apart.
    fn default() -> Self {
        Self { margin: 0.05, look_ahead: 4.0, spacing: 0.05, stopping_share: 0.7 }
    }
}

/// Follows a path by a tracker and minds obstacles on it; plays [`LocalPlanner`].
#[derive(Debug, Clone)]
pub struct Tracked<T> {
    tracker: T,
    guard: Guard,
    params: TrackedParams,
    path: Path,
    /// Whether the tracker took the path; if not, it has no length.
    has_length: bool,
    /// Index of the path's point that comes next.
    next: usize,
}

impl<T: PathTracker> Tracked<T> {
    /// A local planner from a tracker, for a vehicle of this outline.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(tracker: T, footprint: Footprint, params: TrackedParams) -> Result<Self, Error> {
        check::non_negative("margin", params.margin)?;
        check::positive("look_ahead", params.look_ahead)?;
        check::positive("spacing", params.spacing)?;
        check::in_range("stopping_share", params.stopping_share, 0.01, 1.0)?;
        let guard = Guard::new(footprint, GuardParams::default())?;
        Ok(Self { tracker, guard, params, path: Path::new(), has_length: false, next: 0 })
    }

    /// Hands a new path to the tracker.
    fn take(&mut self, path: &Path) -> Result<(), LocalPlanError> {
        if path.is_empty() {
            return Err(LocalPlanError::EmptyPath);
        }
        if self.path == *path {
            return Ok(());
        }
        self.has_length = match self.tracker.set_path(path) {
            Ok(()) => true,
            Err(TrackError::Invalid(error)) => return Err(error.into()),
            // Too short to be one.
            Err(_) => false,
        };
        self.path.clone_from(path);
        self.next = 0;
        Ok(())
    }

    /// Length of the path from the vehicle to the first place where its outline touches something, in metres, and whether that
    /// moves; at most the look-ahead.
    fn free_length(&mut self, request: &LocalPlanRequest<'_>) -> Result<(f64, Option<BlockReason>), LocalPlanError> {
        let here = request.state.map_from_base.translation();
        let points = self.path.points();
        // On from the segment that was nearest, as far as it gets nearer.
        let distance = |index: usize| {
            let (from, to) = (points[index.saturating_sub(1)].pose.translation(), points[index].pose.translation());
            (nearest_on_segment(here, from, to) - here).norm()
        };
        let window = self.next..points.len().min(self.next + 60);
        self.next = window.min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap_or(self.next);
        let mut from = here;
        let mut far = 0.0;
        let speed = request.state.twist.speed().max(0.3);
        for point in points.iter().skip(self.next) {
            let to = point.pose.translation();
            let way = to - from;
            let length = way.norm();
            let count = (length / self.params.spacing).ceil();
            let yaw = match point.gear {
                _ if length == 0.0 => point.pose.yaw(),
                Gear::Forward => way.y.atan2(way.x),
                Gear::Reverse => (-way.y).atan2(-way.x),
            };
            for k in 1..=count as usize {
                let share = k as f64 / count;
                let place = from + way * share;
                let pose = Se2::new(place.x, place.y, yaw);
                let at = far + length * share;
                if at > self.params.look_ahead {
                    return Ok((self.params.look_ahead, None));
                }
                // Within its own outline the vehicle turns as the tracker sees fit; the check of the command minds that.
                if at < self.params.spacing {
                    continue;
                }
                if request.map.collides(self.guard.footprint(), &pose)? {
                    return Ok((at, Some(BlockReason::Obstacle)));
                }
                if self.meets(request, &pose, at / speed) {
                    return Ok((at, Some(BlockReason::MovingObstacle)));
                }
            }
            far += length;
            from = to;
        }
        Ok((self.params.look_ahead, None))
    }

    fn brake(&self, request: &LocalPlanRequest<'_>, status: LocalPlanStatus) -> Result<LocalCommand, LocalPlanError> {
        Ok(LocalCommand { motion: self.guard.brake(request)?, status })
    }

    /// Whether a moving obstacle is within the outline's circle after so many seconds.
    fn meets(&self, request: &LocalPlanRequest<'_>, pose: &Se2, after: f64) -> bool {
        let reach = self.guard.footprint().circumscribed_radius();
        let place = pose.translation();
        request.obstacles.iter().any(|obstacle| obstacle.distance_after(after, &place) < reach)
    }
}

impl<T: PathTracker> LocalPlanner for Tracked<T> {
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
        check_request(&request)?;
        self.take(request.path)?;
        let now = request.state.motion();
        let answer = |motion, status| Ok(LocalCommand { motion, status });
        if self.guard.touches(&request)? {
            return self.brake(&request, LocalPlanStatus::InCollision);
        }
        if !self.has_length {
            let end = self.path.points().last().map_or(request.state.map_from_base, |point| point.pose);
            let is_there = end.between(&request.state.map_from_base).translation().norm() < 0.1;
            let status =
                if is_there { LocalPlanStatus::Arrived } else { LocalPlanStatus::Blocked(BlockReason::OffPath) };
            return self.brake(&request, status);
        }
        let track = match self.tracker.command(&request.state, request.limits, request.dt) {
            Ok(track) => track,
            Err(TrackError::Invalid(error)) => return Err(error.into()),
            Err(_) => return self.brake(&request, LocalPlanStatus::Blocked(BlockReason::OffPath)),
        };
        match track.status {
            TrackStatus::Arrived if self.guard.check(&request, &track.motion)?.is_clear() => {
                return answer(track.motion, LocalPlanStatus::Arrived);
            }
            TrackStatus::Arrived => return self.brake(&request, LocalPlanStatus::Arrived),
            TrackStatus::OffPath => return self.brake(&request, LocalPlanStatus::Blocked(BlockReason::OffPath)),
            _ => {}
        }
        let (free, in_the_way) = self.free_length(&request)?;
        let deceleration = self.params.stopping_share * request.limits.twist.deceleration;
        let most = stopping_speed(free - self.params.margin, deceleration, request.dt);
        let speed = track.motion.twist.vx.abs();
        let allowed = if speed > most { most / speed } else { 1.0 };
        for share in [1.0, 0.7, 0.4, 0.2, 0.1] {
            let wish = Motion { twist: scaled(&track.motion.twist, allowed * share), ..track.motion };
            let motion = request.limits.step(&now, &wish, request.dt)?;
            if wish.twist != Twist2::ZERO && self.guard.check(&request, &motion)?.is_clear() {
                return answer(motion, LocalPlanStatus::Following);
            }
        }
        self.brake(&request, LocalPlanStatus::Blocked(in_the_way.unwrap_or(BlockReason::Obstacle)))
    }
}

fn scaled(twist: &Twist2, share: f64) -> Twist2 {
    Twist2::new(twist.vx * share, twist.vy * share, twist.yaw_rate * share)
}
