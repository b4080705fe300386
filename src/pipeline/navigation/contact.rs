//! Motions close to obstacles, and out of contacts: what the map says may be a cell too much.
//!
//! A vehicle may find that it touches something: a cell was drawn larger than what is in it, or the pose moved. It must not stay there
//! for ever, nor run into anything on the way out. So a motion may pass if it touches nothing, or, out of a contact, if no point of the
//! outline goes deeper than it is, or than half as deep as the deepest is.

use super::NavigationRequest;
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, Twist2},
    grid::Footprint,
    nalgebra::Vector2,
};

/// Tolerance of the look at motions, in cells.
pub(super) const MARGIN: f64 = 1.0 / 16.0;
/// Distance between points of the outline, and between looks at a motion, in cells: no obstacle passes between.
const SPACING: f64 = 0.5;
/// Distance from an obstacle's centre at which it is touched, in cells.
const TOUCHING: f64 = 0.5;
/// Interpolation of distances, in metres; granted to each motion.
const ROUNDING: f64 = 0.002;

/// Whether the vehicle may do a motion for `duration` seconds from a pose.
pub(super) fn may_pass(
    request: &NavigationRequest<'_>,
    footprint: &Footprint,
    pose: &Se2,
    twist: &Twist2,
    duration: f64,
) -> Result<bool, Error> {
    let obstacles = request.map.obstacles();
    if !obstacles.collides_along_within(footprint, pose, twist, duration, MARGIN)? {
        return Ok(true);
    }
    if !obstacles.collides_within(footprint, pose, MARGIN)? {
        return Ok(false);
    }
    let resolution = request.map.layout().resolution();
    let room = room(request, footprint, pose);
    let half_as_deep = (0.5 * (room + TOUCHING * resolution)).max(room);
    let way = (twist.speed() + twist.yaw_rate.abs() * footprint.circumscribed_radius()) * duration;
    let looks = (way / (SPACING * resolution)).ceil().clamp(1.0, 1e4) as usize;
    let is_clear = |point: &(Vector2<f64>, f64)| {
        let needed = room_of(request, pose, point).min(half_as_deep) - ROUNDING;
        (1..=looks).all(|look| {
            let at = pose.compose(&twist.integrate(duration * look as f64 / looks as f64));
            room_of(request, &at, point) >= needed
        })
    };
    Ok(outline(footprint, SPACING * resolution).all(|point| is_clear(&point)))
}

/// Least distance of the outline from an obstacle's centre, in metres.
pub(super) fn room(request: &NavigationRequest<'_>, footprint: &Footprint, pose: &Se2) -> f64 {
    let points = outline(footprint, SPACING * request.map.layout().resolution());
    points.map(|point| room_of(request, pose, &point)).fold(f64::INFINITY, f64::min)
}

fn room_of(request: &NavigationRequest<'_>, pose: &Se2, (point, radius): &(Vector2<f64>, f64)) -> f64 {
    let outside = if request.map.obstacles().params().outside_is_obstacle { 0.0 } else { f64::INFINITY };
    request.map.distance_at(&(*pose * *point)).map_or(outside, |(distance, _)| distance) - radius
}

/// Points of the outline, at most `spacing` metres apart, each with a radius around it.
fn outline(footprint: &Footprint, spacing: f64) -> impl Iterator<Item = (Vector2<f64>, f64)> {
    let circles = footprint.circles().map(|(x, radius)| (Vector2::new(x, 0.0), radius));
    let vertices = footprint.vertices().unwrap_or_default();
    let edges = vertices.iter().zip(vertices.iter().cycle().skip(1));
    let points = edges.flat_map(move |(a, b)| {
        let pieces = ((b - a).norm() / spacing).ceil().clamp(1.0, 1e4) as usize;
        (0..pieces).map(move |k| (a + (b - a) * (k as f64 / pieces as f64), 0.0))
    });
    points.chain(circles)
}
