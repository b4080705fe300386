//! The three critics of the dynamic window approach (Fox, Burgard and Thrun 1997; paper 002, Eq 23).

use super::{Scene, TrajectoryCost, last_free};
use crate::local::Trajectories;
use agv_core::path::Gear;

/// Angle between the nose at the end and the direction to the target, in radians: what Eq 23 subtracts from 180 degrees.
#[derive(Debug, Clone, Copy, Default)]
pub struct Heading;

impl TrajectoryCost for Heading {
    fn name(&self) -> &'static str {
        "heading"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        angles_to(batch, scene, batch.to_local(&scene.target), costs);
    }
}

/// Adds the angle at the end between the nose and the direction to a local point.
pub(super) fn angles_to(batch: &Trajectories, scene: &Scene<'_>, target: nalgebra::Vector2<f32>, costs: &mut [f32]) {
    let gear = if scene.drive.gear == Gear::Reverse { -1.0 } else { 1.0 };
    for (i, cost) in costs.iter_mut().enumerate() {
        let Some(step) = last_free(batch, i) else { continue };
        let view = batch.at_step(step);
        let (dx, dy) = (target.x - view.x[i], target.y - view.y[i]);
        let (cos, sin) = (gear * view.cos[i], gear * view.sin[i]);
        *cost += (cos * dy - sin * dx).atan2(cos * dx + sin * dy).abs();
    }
}

/// What is missing of `enough` metres to the nearest obstacle on the way, in metres.
#[derive(Debug, Clone, Copy)]
pub struct Clearance {
    /// Distance from which on more is not better, in metres.
    pub enough: f32,
}

impl Default for Clearance {
    /// Two metres: Fox's constant for ways without obstacles has to be some number.
    fn default() -> Self {
        Self { enough: 2.0 }
    }
}

impl TrajectoryCost for Clearance {
    fn name(&self) -> &'static str {
        "clearance"
    }

    fn add_costs(&mut self, batch: &Trajectories, _: &Scene<'_>, costs: &mut [f32]) {
        add_least_clearance(batch, costs, |clearance| (self.enough - clearance).max(0.0));
    }
}

/// Adds `price` of the least clearance along the free part of each trajectory.
pub(super) fn add_least_clearance(batch: &Trajectories, costs: &mut [f32], price: impl Fn(f32) -> f32) {
    for (i, cost) in costs.iter_mut().enumerate().filter(|(_, cost)| cost.is_finite()) {
        let free = batch.free()[i] as usize;
        let least = (0..free).map(|step| batch.at_step(step).clearance[i]).fold(f32::INFINITY, f32::min);
        // One that is not free to its end touches something.
        *cost += price(if free < batch.steps() { 0.0 } else { least });
    }
}

/// What is missing of the greatest speed in the gear, in metres per second.
#[derive(Debug, Clone, Copy, Default)]
pub struct Velocity;

impl TrajectoryCost for Velocity {
    fn name(&self) -> &'static str {
        "velocity"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        let limits = &scene.request.limits.twist;
        let (sign, top) = match scene.drive.gear {
            Gear::Forward => (1.0, limits.forward_speed),
            Gear::Reverse => (-1.0, limits.reverse_speed),
        };
        for (i, cost) in costs.iter_mut().enumerate() {
            *cost += (top as f32 - sign * batch.target(i)[0]).max(0.0);
        }
    }
}
