//! What leads planners that sample: where to on the path, how fast at the most, and when to give up; and what they do where they do not
//! drive.

use super::{Drive, Guard, NavigationField, Verdict};
use agv_core::{
    geometry::{LieGroup, Twist2},
    kinematics::{Motion, MotionLimits, approach, stopping_speed},
    path::Course,
    roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus},
};
use nalgebra::Vector2;

/// How much farther from the target than the vehicle the field is known, in metres: for backing up.
const BEHIND: f64 = 1.5;

/// Way that counts as progress, in metres.
const PROGRESS: f64 = 0.05;

/// How much closer, in cells, a vehicle that cannot get on may come to what looks like an obstacle.
pub(crate) const RELAXED: f32 = 1.0;

/// Commands that the guard may refuse in one cycle.
pub(crate) const MOST_CHECKED: usize = 64;

/// Where on the path the way of this cycle should lead: `look_ahead` metres on if the vehicle can be there and there is a way, else
/// beyond what closes the path, else nearer; places are tried a cell of the field apart. The distance field is that of the answer.
pub(crate) fn aim(
    field: &mut NavigationField,
    course: &Course,
    drive: &Drive,
    position: &Vector2<f64>,
    look_ahead: f64,
) -> Option<Vector2<f64>> {
    let (from, step) = (drive.projection.arc_length, field.resolution()?);
    let (mut tried, mut tried_last) = (0, f64::NAN);
    let ahead = drive.to_stop().min(look_ahead);
    for share in [1.0, 1.5, 0.6, 0.3] {
        let mut arc_length = (from + share * look_ahead).min(drive.stop);
        let nearest = from + 0.2 * share * ahead;
        while arc_length >= nearest {
            let (point, _) = course.point_at(arc_length)?;
            if field.is_open(&point) {
                // Near the end of the path several shares lead to it.
                if arc_length == tried_last {
                    break;
                }
                (tried, tried_last) = (tried + 1, arc_length);
                if field.compute(&point, position, BEHIND) {
                    return Some(point);
                }
                break;
            }
            arc_length -= step;
        }
        if tried > 2 {
            break;
        }
    }
    None
}

/// The next bend of the path, or its end: the key node that leads the way.
pub(crate) fn key_node(course: &Course, drive: &Drive) -> Option<Vector2<f64>> {
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

/// Greatest speed that the way ahead allows: where it ends, the vehicle must stop, with a share of its deceleration.
pub(crate) fn speed_cap(request: &LocalPlanRequest<'_>, drive: &Drive, stopping_share: f64) -> f64 {
    let position = request.state.map_from_base.translation();
    let ahead = (drive.stop_pose.translation() - position).norm();
    let deceleration = stopping_share * request.limits.twist.deceleration;
    // Never so slow that the last decimetre takes for ever.
    let to_stop = drive.to_stop().max(ahead.min(2.0 * drive.to_stop().max(PROGRESS)));
    stopping_speed(to_stop, deceleration, request.dt).max(0.05)
}

/// How long there has been no progress; on a new path it begins anew.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patience {
    /// Least that remained, in metres, and time of driving since then, in seconds: who stands for somebody does not lose it.
    least: f64,
    waited: f64,
}

impl Default for Patience {
    /// Of a path on which the vehicle has not driven yet.
    fn default() -> Self {
        Self { least: f64::INFINITY, waited: 0.0 }
    }
}

impl Patience {
    /// Looks at what remains of the path, in metres; the time without progress, in seconds.
    pub(crate) fn look(&mut self, remaining: f64) -> f64 {
        if remaining < self.least - PROGRESS {
            *self = Self { least: remaining, waited: 0.0 };
        }
        self.waited
    }

    /// Counts a cycle of driving.
    pub(crate) fn spend(&mut self, dt: f64) {
        self.waited += dt;
    }
}

/// The angle of the steered wheels; zero for a vehicle without.
pub(crate) fn steering_angle(current: &Motion, limits: &MotionLimits) -> f64 {
    limits.steering.map_or(0.0, |steering| {
        let twist = current.twist;
        let read = if twist.vx == 0.0 { 0.0 } else { (steering.wheelbase * twist.yaw_rate / twist.vx).atan() };
        current.steering.unwrap_or(read)
    })
}

/// The command that leads to what is aimed at: forward and sideways speed, and yaw rate, or curvature for a vehicle that steers.
pub(crate) fn command_towards(request: &LocalPlanRequest<'_>, [vx, vy, turn]: [f64; 3]) -> Motion {
    let &LocalPlanRequest { state, limits, dt, .. } = request;
    let now = state.twist;
    let (up, down) = (limits.twist.acceleration, limits.twist.deceleration);
    let vx = approach(now.vx, vx, up, down, dt);
    let target = if let Some(steering) = &limits.steering {
        let angle = steering_angle(&state.motion(), limits);
        let change = steering.max_rate * dt;
        let angle = (turn * steering.wheelbase).atan().clamp(angle - change, angle + change);
        Motion { twist: Twist2::new(vx, 0.0, vx * steering.curvature(angle)), steering: Some(angle) }
    } else {
        let change = limits.twist.yaw_acceleration;
        Twist2::new(vx, approach(now.vy, vy, up, down, dt), approach(now.yaw_rate, turn, change, change, dt)).into()
    };
    limits.step_checked(&state.motion(), &target, dt)
}

/// Why it is best to stand: for somebody who is within `reach` metres, or as it was.
pub(crate) fn standing_reason(request: &LocalPlanRequest<'_>, reach: f64, otherwise: BlockReason) -> BlockReason {
    let position = request.state.map_from_base.translation();
    let near = request.obstacles.iter().any(|o| (o.position - position).norm() - o.circumscribed_radius() < reach);
    if near { BlockReason::MovingObstacle } else { otherwise }
}

/// Whether a command keeps a vehicle that stands where it is: its wheels do not turn either.
pub(crate) fn stays(request: &LocalPlanRequest<'_>, motion: &Motion) -> bool {
    let turns_wheels = motion.steering.is_some() && motion.steering != request.state.steering;
    motion.twist == Twist2::ZERO && request.state.twist == Twist2::ZERO && !turns_wheels
}

/// Brakes, and says why.
pub(crate) fn blocked(
    guard: &Guard,
    request: &LocalPlanRequest<'_>,
    reason: BlockReason,
) -> Result<LocalCommand, LocalPlanError> {
    let motion = guard.brake(request)?;
    Ok(LocalCommand { motion, status: LocalPlanStatus::Blocked(reason) })
}

/// Turns on the spot: the shorter way, unless that is closed and the other is not. An angle of zero is a stop on the way.
pub(crate) fn turn(guard: &Guard, request: &LocalPlanRequest<'_>, error: f64) -> Result<LocalCommand, LocalPlanError> {
    if error == 0.0 {
        let motion = guard.brake(request)?;
        return Ok(LocalCommand { motion, status: LocalPlanStatus::Following });
    }
    let (limits, pose) = (request.limits, request.state.map_from_base);
    // All of the turn, not the next cycle: the way is chosen once, and not again at the obstacle.
    let closed = |angle: f64| {
        let twist = Twist2::new(0.0, 0.0, 1.0_f64.copysign(angle));
        request.map.obstacles().collides_along_within(
            guard.footprint(),
            &pose,
            &twist,
            angle.abs(),
            guard.params().margin,
        )
    };
    let around = error - std::f64::consts::TAU.copysign(error);
    let angle = if closed(error)? && !closed(around)? { around } else { error };
    let rate = stopping_speed(angle.abs(), limits.twist.yaw_acceleration, request.dt).min(limits.twist.yaw_rate);
    let target = Twist2::new(0.0, 0.0, rate.copysign(angle));
    let motion = limits.step_checked(&request.state.motion(), &target.into(), request.dt);
    match guard.check_trusted(request, &motion)? {
        Verdict::Clear => Ok(LocalCommand { motion, status: LocalPlanStatus::Following }),
        Verdict::Blocked(because) => blocked(guard, request, because),
    }
}
