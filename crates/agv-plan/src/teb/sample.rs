//! The path ahead, as bands are made of.

use super::line::Ground;
use agv_core::{
    geometry::angle_difference,
    path::{Course, PathPoint},
    roles::LocalPlanRequest,
};
use nalgebra::Vector2;
use std::f64::consts::PI;

/// A point of the path ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    pub(super) position: Vector2<f64>,
    /// Heading of the base.
    pub(super) yaw: f64,
    /// Direction of travel.
    pub(super) direction: f64,
}

impl Sample {
    /// To the left of the direction of travel, of length one.
    pub(super) fn across(&self) -> Vector2<f64> {
        Vector2::new(-self.direction.sin(), self.direction.cos())
    }
}

/// Distance of a goal nearby, in spacings of the band.
const NEARBY: f64 = 4.0;
/// Most spacings of a horizon, however long the vehicle takes to brake.
const MOST_SAMPLES: f64 = 10_000.0;

/// Samples the present section as far as the horizon; says whether the last one is the section's end, where the vehicle stops.
pub(super) fn sample(
    course: &Course,
    request: &LocalPlanRequest<'_>,
    ground: &Ground<'_>,
    progress: f64,
    points: &[PathPoint],
    samples: &mut Vec<Sample>,
) -> bool {
    let (params, twist) = (ground.params, &ground.limits.twist);
    let holonomic = ground.limits.is_holonomic();
    let end = course.section_end();
    let braking = 0.5 * twist.forward_speed.powi(2) / (params.acceleration_share * twist.deceleration);
    let horizon = params.horizon.max(1.2 * braking).min(MOST_SAMPLES * params.spacing);
    samples.clear();
    let pose = request.state.map_from_base;
    samples.push(Sample { position: pose.translation(), yaw: pose.yaw(), direction: pose.yaw() });
    let at = |arc_length: f64| {
        let (position, _) = course.point_at(arc_length)?;
        let direction = course.direction_at(arc_length)?.angle();
        let yaw = if holonomic {
            course.yaw_at(arc_length)?
        } else if ground.gear < 0.0 {
            direction + PI
        } else {
            direction
        };
        Some(Sample { position, yaw, direction })
    };
    let mut arc_length = progress;
    loop {
        let next = arc_length + params.spacing;
        arc_length = if next + 0.5 * params.spacing > end { end } else { next };
        let Some(mut sample) = at(arc_length) else { break };
        if arc_length >= end && !holonomic {
            let exact = course.point_at(end).map_or(sample.direction, |(_, direction)| direction.angle());
            sample.yaw = if ground.gear < 0.0 { exact + PI } else { exact };
            // A vehicle that cannot turn on the spot arrives with the last heading, if that is about where it goes.
            if let (false, true, Some(last)) =
                (ground.limits.turns_on_the_spot(), end >= course.length(), points.last())
                && angle_difference(last.pose.yaw(), sample.yaw).abs() < 1.0
            {
                sample.yaw = last.pose.yaw();
            }
        }
        let far = arc_length - progress >= horizon;
        // A goal on the way is one where the vehicle can stand, and that who moves has passed or not yet reached.
        let stands = || {
            let pose = [sample.position.x, sample.position.y, sample.yaw];
            let time = (arc_length - progress) / ground.usual_speed();
            let mut movers = request.obstacles.iter().map(|mover| ground.clearance_from(mover, time, pose));
            ground.clearance(pose).is_none_or(|c| c > 0.02) && movers.all(|clearance| clearance > params.clearance)
        };
        samples.push(sample);
        if arc_length >= end || (far && stands()) || arc_length - progress > 2.0 * horizon {
            break;
        }
    }
    let stops = arc_length >= end;
    let turns = ground.limits.turns_on_the_spot() && !holonomic;
    if stops
        && turns
        && is_nearby(samples, params.spacing)
        && let [first, .., last] = &mut samples[..]
    {
        // To a place nearby, from any side: whichever heading leads there.
        let line = last.position - first.position;
        last.yaw = line.y.atan2(line.x) + if ground.gear < 0.0 { PI } else { 0.0 };
    }
    if !stops {
        while samples.len() > 2
            && samples
                .last()
                .is_some_and(|s| ground.clearance([s.position.x, s.position.y, s.yaw]).is_some_and(|c| c < 0.0))
        {
            samples.pop();
        }
    }
    stops
}

/// Whether the last sample is nearby.
pub(super) fn is_nearby(samples: &[Sample], spacing: f64) -> bool {
    let ends = samples.first().zip(samples.last());
    ends.is_some_and(|(first, last)| (last.position - first.position).norm() < NEARBY * spacing)
}
