//! The exact pass: an ideal vehicle follows the line of a band, cycle by cycle.
//!
//! Each cycle the vehicle is asked for the curvature that brings it back to the line critically damped over a length `L`,
//!
//! ```text
//! κ = κ_line - e / L² - 2 ε / L        e: to the left of the line, ε: heading off it
//! ```
//!
//! at the speed that the line allows there, and does what [`MotionLimits::step_checked`] makes of that. So every motion is one that the limits allow from the one
//! before, whatever the band was; and every stretch is checked against the obstacles with the footprint swept. The speeds lead to
//! rest at the line's end: a roll-out that touches nothing is a way to brake.

use super::line::{Ground, Line, Place};
use crate::local::moving::{Stretch, touches};
use agv_core::{
    Error,
    geometry::{Se2, Twist2, angle_difference},
    grid::Footprint,
    kinematics::{Motion, MotionLimits, stopping_speed},
    roles::{BlockReason, LocalPlanRequest, VehicleState},
    trajectory::{Trajectory, TrajectoryPoint},
};

/// A motion that was rolled out until the vehicle rests.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rollout {
    trajectory: Trajectory,
    touches: Option<Touch>,
    rests: bool,
}

/// Where a roll-out ended early, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Touch {
    /// How far along its line the vehicle was before the motion that touches something, or where it came to rest; in metres.
    pub(super) arc_length: f64,
    pub(super) reason: BlockReason,
}

/// What a roll-out needs to know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Task<'a> {
    pub(super) request: &'a LocalPlanRequest<'a>,
    pub(super) footprint: &'a Footprint,
    pub(super) ground: Ground<'a>,
}

/// Most cycles of a roll-out before it brakes.
const MOST_STEPS: usize = 1000;

/// Most cycles of a roll-out until rest.
const MOST_CYCLES: usize = 1 << 14;

/// Distance from the end, in metres, and angle, in radians, at which the vehicle stops rather than creep.
const AT_END: f64 = 2e-3;

/// How near obstacles are passed without counting as touched, in cells: as the guard has it.
const MARGIN: f64 = 1.0 / 16.0;

/// Speed below which the wheels are turned before the vehicle drives, in metres per second.
const SLOW: f64 = 0.05;

/// Steering angle that is worth it, in radians.
const STEER_FIRST: f64 = 0.15;

impl Rollout {
    /// The poses of the cycles to come, until rest; its first motion is that of the next cycle.
    pub const fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Why the roll-out ends early, if it does: what the vehicle would touch, or that its limits let it go no farther.
    pub fn blocked(&self) -> Option<BlockReason> {
        self.touches.map(|touch| touch.reason)
    }

    /// Whether it touches nothing and ends at rest.
    pub const fn is_free(&self) -> bool {
        self.rests && self.touches.is_none()
    }

    pub(super) const fn touch(&self) -> Option<Touch> {
        self.touches
    }

    /// The motion of the next cycle.
    pub(super) fn first(&self) -> Option<Motion> {
        self.trajectory.points().first().map(|point| point.motion)
    }

    /// Follows a line whose speeds were planned to its stop, or as far as it comes in some cycles.
    pub(super) fn follow(&mut self, task: &Task<'_>, line: &Line) -> Result<(), Error> {
        let ground = &task.ground;
        let dt = task.request.dt;
        let mut place = line.nearest(&task.request.state.map_from_base.translation(), 0);
        let mut stalled = None;
        self.run(task, |state| {
            let from = place.map_or(0, |place| place.segment);
            place = line.nearest(&state.map_from_base.translation(), from);
            let place = place?;
            let left = line.stop() - place.arc_length;
            let arc_length = place.arc_length;
            if left <= AT_END {
                return None;
            }
            // The speed of the middle of the cycle.
            let half_way = line.place_at(arc_length + 0.5 * dt * state.twist.speed(), place.segment)?;
            let deceleration = ground.params.acceleration_share * ground.limits.twist.deceleration;
            let end = stopping_speed(left, deceleration, dt);
            let speed = line.speed_at(&half_way).min(end);
            if speed <= 1e-3 && state.twist.speed() <= 1e-3 {
                stalled = Some(arc_length);
                return None;
            }
            let target = if ground.limits.is_holonomic() {
                holonomic_target(line, &place, &half_way, state, speed)
            } else {
                arc_target(ground, line, &place, &half_way, state, speed)
            };
            Some((target, arc_length))
        })?;
        // A stop for a reason is told by that reason.
        if let (Some(arc_length), None, None) = (stalled, self.touches, line.stopped()) {
            self.touches = Some(Touch { arc_length, reason: BlockReason::Limits });
        }
        Ok(())
    }

    /// Turns on the spot to a heading, by the side that `side` says.
    pub(super) fn turn(&mut self, task: &Task<'_>, yaw: f64, side: f64) -> Result<(), Error> {
        let twist = &task.ground.limits.twist;
        let rate = task.ground.params.acceleration_share * twist.yaw_acceleration;
        let mut left = angle_difference(yaw, task.request.state.map_from_base.yaw());
        if left * side < 0.0 && left.abs() > 0.1 {
            left += side * std::f64::consts::TAU;
        }
        let mut before = task.request.state.map_from_base.yaw();
        self.run(task, |state| {
            let now = state.map_from_base.yaw();
            left -= angle_difference(now, before);
            before = now;
            if left.abs() <= AT_END {
                return None;
            }
            let speed = stopping_speed(left.abs(), rate, task.request.dt).min(twist.yaw_rate);
            Some((Twist2::new(0.0, 0.0, speed.copysign(left)).into(), 0.0))
        })
    }

    /// Does a first motion, then brakes to rest.
    pub(super) fn brake_after(&mut self, task: &Task<'_>, motion: &Motion) -> Result<(), Error> {
        let mut first = Some(*motion);
        self.run(task, |_| first.take().map(|motion| (motion, 0.0)))
    }

    /// Steps towards the targets of a policy until it has none, then brakes until rest or until something is touched.
    fn run(
        &mut self,
        task: &Task<'_>,
        mut policy: impl FnMut(&VehicleState) -> Option<(Motion, f64)>,
    ) -> Result<(), Error> {
        self.trajectory.clear();
        (self.touches, self.rests) = (None, false);
        let (dt, limits) = (task.request.dt, task.request.limits);
        let mut state = task.request.state;
        let (mut driving, mut arc_length) = (true, 0.0);
        for step in 0..MOST_CYCLES {
            let time = step as f64 * dt;
            let target = if driving && step < MOST_STEPS { policy(&state) } else { None };
            driving = target.is_some();
            if let Some((_, at)) = target {
                arc_length = at;
            }
            let target = target.map_or(Motion::REST, |(target, _)| target);
            let motion = limits.step_checked(&state.motion(), &target, dt);
            self.trajectory.push(TrajectoryPoint { time, map_from_base: state.map_from_base, motion })?;
            if motion.twist == Twist2::ZERO {
                if !driving {
                    self.rests = true;
                    return Ok(());
                }
            } else if let Some(reason) = task.touched(&state.map_from_base, &motion, time)? {
                self.touches = Some(Touch { arc_length, reason });
                return Ok(());
            }
            state = state.after(&motion, dt);
        }
        self.touches = Some(Touch { arc_length, reason: BlockReason::Limits });
        Ok(())
    }
}

impl Task<'_> {
    /// What the vehicle touches in a cycle.
    fn touched(&self, pose: &Se2, motion: &Motion, time: f64) -> Result<Option<BlockReason>, Error> {
        let dt = self.request.dt;
        let obstacles = self.request.map.obstacles();
        if obstacles.collides_along_within(self.footprint, pose, &motion.twist, dt, MARGIN)? {
            return Ok(Some(BlockReason::Obstacle));
        }
        let stretch = Stretch { map_from_base: *pose, twist: motion.twist, begin: time, duration: dt };
        let hit = self.request.obstacles.iter().any(|obstacle| touches(self.footprint, obstacle, &stretch));
        Ok(hit.then_some(BlockReason::MovingObstacle))
    }
}

/// The arc that leads back to the line.
fn arc_target(
    ground: &Ground<'_>,
    line: &Line,
    place: &Place,
    ahead: &Place,
    state: &VehicleState,
    speed: f64,
) -> Motion {
    let gear = ground.gear;
    let (sin, cos) = place.yaw.sin_cos();
    let offset = state.map_from_base.translation() - place.position;
    // Both in the direction of travel, in which left is right for a vehicle that backs up, and so is its turn.
    let aside = gear * (offset.y * cos - offset.x * sin);
    let askew = angle_difference(state.map_from_base.yaw(), place.yaw);
    let reach = (0.35 * state.twist.speed()).clamp(0.25, 0.7);
    let curvature = line.curvature_at(ahead) - aside / (reach * reach) - 2.0 * askew / reach;
    let limit = ground.limits.max_curvature().min(20.0);
    let curvature = curvature.clamp(-limit, limit);
    let speed = speed.min(ground.limits.speed_in_bend(curvature));
    let twist = Twist2::new(gear * speed, 0.0, speed * curvature);
    let Some(steering) = &ground.limits.steering else { return twist.into() };
    // Where the wheels are far from where they should be, they are turned first.
    let angle = (gear * curvature * steering.wheelbase).atan();
    let now = state.steering.unwrap_or_else(|| steered(ground.limits, &state.twist));
    if state.twist.vx.abs() < SLOW && (angle - now).abs() > STEER_FIRST {
        return Motion { twist: Twist2::ZERO, steering: Some(angle) };
    }
    Motion { twist, steering: Some(angle) }
}

fn steered(limits: &MotionLimits, twist: &Twist2) -> f64 {
    let wheelbase = limits.steering.map_or(0.0, |steering| steering.wheelbase);
    if twist.vx == 0.0 { 0.0 } else { (wheelbase * twist.yaw_rate / twist.vx).atan() }
}

/// The velocity along the line and back to it, in the frame of the base.
fn holonomic_target(line: &Line, place: &Place, ahead: &Place, state: &VehicleState, speed: f64) -> Motion {
    const PER_SECOND: f64 = 1.5;
    let offset = place.position - state.map_from_base.translation();
    let velocity = line.direction(ahead.segment) * speed + offset * PER_SECOND.min(4.0 * speed);
    let (sin, cos) = state.map_from_base.yaw().sin_cos();
    let askew = angle_difference(place.yaw, state.map_from_base.yaw());
    let yaw_rate = line.curvature_at(ahead) * speed + PER_SECOND * askew;
    Twist2::new(velocity.x * cos + velocity.y * sin, velocity.y * cos - velocity.x * sin, yaw_rate).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::teb::TebParams;
    use agv_core::{
        grid::{CellState, Costmap, Grid, GridLayout, LocalMap, LocalMapParams},
        kinematics::TwistLimits,
        path::Path,
    };
    use nalgebra::Vector2;

    /// Follows a straight line of 4 m from rest at its beginning, whose speeds `plan` has set.
    fn follow(limits: &MotionLimits, dt: f64, plan: impl FnOnce(&mut Line, &Ground<'_>)) -> (Line, Rollout) {
        let layout = GridLayout::new(120, 40, 0.05, Se2::default()).unwrap();
        let map = Grid::filled(layout, CellState::Free);
        let map = LocalMap::new(&Costmap::from_map(&map), LocalMapParams::default()).unwrap();
        let footprint = Footprint::circle(0.2).unwrap();
        let params = TebParams::for_footprint(footprint.clone());
        let path = Path::from_positions(&[Vector2::new(1.0, 1.0), Vector2::new(5.0, 1.0)]).unwrap();
        let state = VehicleState::new(Se2::new(1.0, 1.0, 0.0), Twist2::ZERO);
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits, dt };
        let ground = Ground::new(&params, &[], &request, 1.0);
        let band: Vec<_> = (0..=10).map(|i| [1.0 + 0.4 * f64::from(i), 1.0, 0.0, 1.0]).collect();
        let (mut line, mut rollout) = (Line::default(), Rollout::default());
        line.set(&band, &ground, false);
        plan(&mut line, &ground);
        rollout.follow(&Task { request: &request, footprint: &footprint, ground }, &line).unwrap();
        (line, rollout)
    }

    fn end(rollout: &Rollout) -> f64 {
        rollout.trajectory().points().last().unwrap().map_from_base.x()
    }

    /// Between two poses of the band, too; and one who drives more slowly stops at the same place for the same reason.
    #[test]
    fn a_line_is_driven_to_its_stop() {
        for share in [None, Some(0.5), Some(0.15)] {
            let (line, rollout) = follow(&MotionLimits::default(), 0.1, |line, ground| {
                line.stop_at(1.5, Some(BlockReason::MovingObstacle), ground);
                if let Some(share) = share {
                    line.slow_down(share, ground);
                }
            });
            assert!(rollout.is_free() && (end(&rollout) - 2.5).abs() < 5e-3, "{share:?}: {}", end(&rollout));
            assert_eq!(line.stopped(), Some(BlockReason::MovingObstacle));
        }
    }

    #[test]
    fn a_way_longer_than_a_roll_out_is_free_as_far_as_that_leads() {
        let limits = TwistLimits { forward_speed: 0.1, ..TwistLimits::default() }.into();
        let (_, rollout) = follow(&limits, 0.02, |line, ground| line.plan_stop(line.length(), 1.0, ground));
        assert!(rollout.is_free() && rollout.trajectory().len() > MOST_STEPS);
        assert!((2.8..3.1).contains(&end(&rollout)), "{}", end(&rollout));
    }

    #[test]
    fn a_way_that_the_limits_do_not_let_the_vehicle_go_is_not_free() {
        let limits = TwistLimits { forward_speed: 0.0, ..TwistLimits::default() }.into();
        let (_, rollout) = follow(&limits, 0.1, |line, ground| line.plan_stop(line.length(), 1.0, ground));
        assert_eq!((rollout.is_free(), rollout.blocked()), (false, Some(BlockReason::Limits)));
    }
}
