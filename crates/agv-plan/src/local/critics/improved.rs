//! The critics of the improved dynamic window approach of paper 002: obstacles count only near, and key nodes lead the way.

use super::{
    Scene, TrajectoryCost,
    classic::{add_least_clearance, angles_to},
    last_free,
};
use crate::local::Trajectories;

/// Eq 24, whose middle case is `R < dist <= 2 R`: the distance to obstacles is worth nothing below `R`, itself up to twice that,
/// and no more than that beyond; here what is missing of the most, in metres.
#[derive(Debug, Clone, Copy)]
pub struct BoundedObstacle {
    /// `R`, in metres.
    pub radius: f32,
}

impl Default for BoundedObstacle {
    /// `√2 / 4` m: half the diagonal of half a cell of paper 002's grid.
    fn default() -> Self {
        Self { radius: std::f32::consts::SQRT_2 / 4.0 }
    }
}

impl TrajectoryCost for BoundedObstacle {
    fn name(&self) -> &'static str {
        "bounded obstacle"
    }

    fn add_costs(&mut self, batch: &Trajectories, _: &Scene<'_>, costs: &mut [f32]) {
        let most = 2.0 * self.radius;
        add_least_clearance(batch, costs, |distance| {
            most - if distance < self.radius { 0.0 } else { distance.min(most) }
        });
    }
}

/// Eq 25: how far the end is from the next key node, in metres (`sgdist` is a constant less that); the goal is the last key node.
#[derive(Debug, Clone, Copy, Default)]
pub struct KeyNodeDistance;

impl TrajectoryCost for KeyNodeDistance {
    fn name(&self) -> &'static str {
        "key node distance"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        let node = batch.to_local(&scene.key_node);
        for (i, cost) in costs.iter_mut().enumerate() {
            let Some(step) = last_free(batch, i) else { continue };
            let view = batch.at_step(step);
            *cost += (node.x - view.x[i]).hypot(node.y - view.y[i]);
        }
    }
}

/// Angle between the nose at the end and the direction to the next key node, in radians: `Iheading` of Eq 26.
#[derive(Debug, Clone, Copy, Default)]
pub struct KeyNodeHeading;

impl TrajectoryCost for KeyNodeHeading {
    fn name(&self) -> &'static str {
        "key node heading"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        angles_to(batch, scene, batch.to_local(&scene.key_node), costs);
    }
}
