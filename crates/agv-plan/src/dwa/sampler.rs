//! The samples of the window.

use super::Dwa;
use crate::local::{Drive, Window, lead, window::samples};
use agv_core::roles::LocalPlanRequest;

impl Dwa {
    pub(super) fn sample(&mut self, request: &LocalPlanRequest<'_>, drive: &Drive) {
        let &LocalPlanRequest { state, map, limits, dt, .. } = request;
        let params = &self.params;
        let time = self.window_time(request);
        let cap = lead::speed_cap(request, drive, params.stopping_share);
        let window = Window::new(&state.motion(), limits, time.max(dt), drive.gear, cap);
        let steering = lead::steering_angle(&state.motion(), limits);
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
}
