//! The samples of the window, and the command with which a vehicle begins to drive towards one of them.

use super::{
    Dwa,
    window::{Window, samples, steering_angle},
};
use crate::local::Drive;
use agv_core::{
    geometry::Twist2,
    kinematics::{Motion, rise},
    roles::LocalPlanRequest,
};

impl Dwa {
    pub(super) fn sample(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive) {
        let &LocalPlanRequest { state, map, limits, dt, .. } = request;
        let params = &self.params;
        let time = self.window_time(request);
        let window = Window::new(&state.motion(), limits, time.max(dt), drive.gear, self.speed_cap(request, drive));
        let steering = steering_angle(&state.motion(), limits);
        let turn = limits.steering.map_or(state.twist.yaw_rate, |steered| steered.curvature(steering));
        self.batch.begin(&state, map, params.steps, params.horizon / params.steps as f64);
        self.speeds.clear();
        samples(window.forward, params.speeds, state.twist.vx, |value| self.speeds.push(value));
        self.turns.clear();
        samples(window.turn, params.turns, turn, |value| self.turns.push(value));
        let batch = &mut self.batch;
        for &vx in &self.speeds {
            for &turn in &self.turns {
                if window.lateral == (0.0, 0.0) {
                    batch.push([vx as f32, 0.0, turn as f32]);
                } else {
                    let each = |vy: f64| batch.push([vx as f32, vy as f32, turn as f32]);
                    samples(window.lateral, params.lateral_speeds, 0.0, each);
                }
            }
        }
    }

    /// Time of the window: as it is, or by speed and room.
    pub(super) fn window_time(&self, request: &LocalPlanRequest<'_>) -> f64 {
        let Some(adaptive) = self.params.adaptive else { return self.params.window };
        let pose = request.state.map_from_base;
        let distance = request.map.distance_at(&pose.translation()).map_or(0.0, |(distance, _)| distance);
        let room = (distance - self.params.footprint.circumscribed_radius()) / adaptive.room;
        let fast = request.state.twist.speed() / request.limits.twist.forward_speed.max(1e-9);
        let share = room.min(0.5 + 0.5 * fast).clamp(adaptive.least, 1.0);
        self.params.window * share
    }

    /// The command that leads to what trajectory `i` aims at.
    pub(super) fn command_towards(&self, request: &LocalPlanRequest<'_>, i: usize) -> Motion {
        let &LocalPlanRequest { state, limits, dt, .. } = request;
        let [vx, vy, turn] = self.batch.target(i).map(f64::from);
        let now = state.twist;
        let (up, down) = (limits.twist.acceleration, limits.twist.deceleration);
        let vx = towards(now.vx, vx, up, down, dt);
        let target = if let Some(steering) = &limits.steering {
            let angle = steering_angle(&state.motion(), limits);
            let change = steering.max_rate * dt;
            let angle = (turn * steering.wheelbase).atan().clamp(angle - change, angle + change);
            Motion { twist: Twist2::new(vx, 0.0, vx * steering.curvature(angle)), steering: Some(angle) }
        } else {
            let change = limits.twist.yaw_acceleration;
            Twist2::new(vx, towards(now.vy, vy, up, down, dt), towards(now.yaw_rate, turn, change, change, dt)).into()
        };
        limits.step_checked(&state.motion(), &target, dt)
    }
}

/// A component after a step towards its target.
fn towards(now: f64, target: f64, acceleration: f64, deceleration: f64, dt: f64) -> f64 {
    let (lowest, highest) = (-rise(-now, acceleration, deceleration, dt), rise(now, acceleration, deceleration, dt));
    target.max(lowest).min(highest)
}
