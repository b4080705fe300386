//! Critics of what the vehicle does, wherever it is.

use super::{Scene, TrajectoryCost};
use crate::local::Trajectories;
use agv_core::path::Gear;

/// Speed against the gear that the path asks for, in metres per second.
#[derive(Debug, Clone, Copy, Default)]
pub struct PreferForward;

impl TrajectoryCost for PreferForward {
    fn name(&self) -> &'static str {
        "prefer forward"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        let gear = if scene.drive.gear == Gear::Reverse { -1.0 } else { 1.0 };
        for (i, cost) in costs.iter_mut().enumerate() {
            *cost += (-gear * batch.target(i)[0]).max(0.0);
        }
    }
}

/// How far a trajectory turns to another side than the last one did: the change of the yaw rate aimed at where that changes its sign, in
/// radians per second. Keeps a vehicle from hesitating between two ways around.
#[derive(Debug, Clone, Copy, Default)]
pub struct Oscillation;

impl TrajectoryCost for Oscillation {
    fn name(&self) -> &'static str {
        "oscillation"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        let steers = scene.request.limits.steering.is_some();
        let last = scene.last.yaw_rate as f32;
        for (i, cost) in costs.iter_mut().enumerate() {
            let turn = batch.target_twist(i, steers).yaw_rate as f32;
            *cost += if turn * last < 0.0 { (turn - last).abs() } else { 0.0 };
        }
    }
}

/// Yaw rate that is aimed at, in radians per second.
#[derive(Debug, Clone, Copy, Default)]
pub struct Twirling;

impl TrajectoryCost for Twirling {
    fn name(&self) -> &'static str {
        "twirling"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        let steers = scene.request.limits.steering.is_some();
        for (i, cost) in costs.iter_mut().enumerate() {
            *cost += batch.target_twist(i, steers).yaw_rate.abs() as f32;
        }
    }
}
