//! How near a trajectory comes to the goal, around obstacles, and how well it goes on from there.

use super::{Scene, TrajectoryCost};
use crate::local::Trajectories;
use agv_core::path::Gear;

/// The least, over the part of a trajectory that is free, of
///
/// ```text
/// T(x) + turning (1 - cos(angle to -∇T)) + waiting t
/// ```
///
/// plus how near to obstacles it is on the way there. All in metres of way. The least, because whatever follows is decided again
/// before it happens; a trajectory that ends in a wall is as good as the place where it should be left, if one can brake there.
#[derive(Debug, Clone, Default)]
pub struct Progress {
    /// Metres of way that it is worth not to have to turn round by a quarter.
    pub turning: f32,
    /// Metres of way that a second is worth.
    pub waiting: f32,
    /// Metres of way that it is worth not to touch obstacles all the while.
    pub nearness: f32,
    /// Distance from obstacles that is enough, in metres.
    pub room: f32,
    /// Working memory: sum of nearness, and the least cost.
    near: Vec<f32>,
    best: Vec<f32>,
}

impl Progress {
    /// A critic with these prices.
    pub const fn new(turning: f32, waiting: f32, nearness: f32, room: f32) -> Self {
        Self { turning, waiting, nearness, room, near: Vec::new(), best: Vec::new() }
    }
}

/// Every how many steps the field is looked up.
const EVERY: usize = 3;

impl TrajectoryCost for Progress {
    fn name(&self) -> &'static str {
        "progress"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        let Some(local) = scene.field.origin_of(&batch.map_from_local().translation()) else { return };
        let gear = if scene.drive.gear == Gear::Reverse { -1.0 } else { 1.0 };
        let per_room = 1.0 / self.room.max(1e-3);
        let (nearness, best) = (&mut self.near, &mut self.best);
        nearness.clear();
        nearness.resize(batch.len(), 0.0);
        best.clear();
        best.resize(batch.len(), f32::INFINITY);
        for step in 0..batch.steps() {
            let view = batch.at_step(step);
            for (sum, &clearance) in nearness.iter_mut().zip(view.clearance) {
                let near = (1.0 - clearance.max(0.0) * per_room).max(0.0);
                *sum += near * near;
            }
            if (step + 1) % EVERY != 0 && step + 1 != batch.steps() {
                continue;
            }
            let (elapsed, per_step) = ((step + 1) as f32 * batch.dt() as f32, 1.0 / (step + 1) as f32);
            for i in 0..batch.len() {
                if batch.free()[i] as usize <= step || !costs[i].is_finite() {
                    continue;
                }
                let (value, [along, across]) = scene.field.local_value(&local, view.x[i], view.y[i]);
                let floor = value + self.waiting * elapsed + self.nearness * nearness[i] * per_step;
                if floor < best[i] {
                    let aligned = gear * (view.cos[i] * along + view.sin[i] * across);
                    best[i] = best[i].min(floor + self.turning * (1.0 - aligned));
                }
            }
        }
        for (cost, best) in costs.iter_mut().zip(best) {
            *cost += *best;
        }
    }
}
