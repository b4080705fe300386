//! Critics that look at the path and its goal, as Nav2's DWB has them.
//!
//! DWB's align critics look from a point ahead of the nose, which lies in the wall where the vehicle faces one, and so steer into
//! obstacles. Here alignment is an angle.

use super::{Scene, TrajectoryCost, last_free};
use crate::local::Trajectories;
use agv_core::{geometry::LieGroup, path::Gear};
use nalgebra::Vector2;

/// Where trajectory `i` ends, in the map: position, and the direction that it drives in.
fn end(batch: &Trajectories, scene: &Scene<'_>, i: usize) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let view = batch.at_step(last_free(batch, i)?);
    let pose = batch.map_from_local();
    let point = pose.act(&Vector2::new(f64::from(view.x[i]), f64::from(view.y[i])));
    let nose = pose.rotation().act(&Vector2::new(f64::from(view.cos[i]), f64::from(view.sin[i])));
    Some((point, if scene.drive.gear == Gear::Reverse { -nose } else { nose }))
}

/// The point of the path nearest to one near the vehicle, and the direction there: looked for every 0.2 m, from the vehicle's own
/// place on.
fn nearest(scene: &Scene<'_>, point: &Vector2<f64>) -> (f64, Vector2<f64>) {
    let from = scene.drive.projection.arc_length;
    let mut best = (f64::INFINITY, Vector2::x());
    for k in 0..24 {
        let Some((on_path, direction)) = scene.course.point_at((from + 0.2 * f64::from(k)).min(scene.drive.stop))
        else {
            break;
        };
        let direction = Vector2::new(direction.cos(), direction.sin());
        let offset = point - on_path;
        // To the line there, as far as the next place.
        let along = offset.dot(&direction).clamp(-0.1, 0.1);
        let distance = (offset - direction * along).norm();
        if distance < best.0 {
            best = (distance, direction);
        }
    }
    best
}

/// Distance of the end from the path, in metres.
#[derive(Debug, Clone, Copy, Default)]
pub struct PathDistance;

impl TrajectoryCost for PathDistance {
    fn name(&self) -> &'static str {
        "path distance"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        for (i, cost) in costs.iter_mut().enumerate() {
            if let Some((point, _)) = end(batch, scene, i) {
                *cost += nearest(scene, &point).0 as f32;
            }
        }
    }
}

/// Angle at the end between the direction of driving and that of the path where it is nearest, in radians.
#[derive(Debug, Clone, Copy, Default)]
pub struct PathAlign;

impl TrajectoryCost for PathAlign {
    fn name(&self) -> &'static str {
        "path align"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        for (i, cost) in costs.iter_mut().enumerate() {
            if let Some((point, nose)) = end(batch, scene, i) {
                *cost += nose.angle(&nearest(scene, &point).1) as f32;
            }
        }
    }
}

/// Distance of the end from the target, in metres, as the crow flies.
#[derive(Debug, Clone, Copy, Default)]
pub struct GoalDistance;

impl TrajectoryCost for GoalDistance {
    fn name(&self) -> &'static str {
        "goal distance"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        for (i, cost) in costs.iter_mut().enumerate() {
            if let Some((point, _)) = end(batch, scene, i) {
                *cost += (scene.target - point).norm() as f32;
            }
        }
    }
}

/// Angle at the end between the direction of driving and that in which the way to the target leads from there, in radians.
#[derive(Debug, Clone, Copy, Default)]
pub struct GoalAlign;

impl TrajectoryCost for GoalAlign {
    fn name(&self) -> &'static str {
        "goal align"
    }

    fn add_costs(&mut self, batch: &Trajectories, scene: &Scene<'_>, costs: &mut [f32]) {
        for (i, cost) in costs.iter_mut().enumerate() {
            if let Some((point, nose)) = end(batch, scene, i) {
                let way = scene.field.descent(&point).unwrap_or(scene.target - point);
                *cost += nose.angle(&way) as f32;
            }
        }
    }
}
