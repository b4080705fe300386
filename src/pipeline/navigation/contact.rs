//! Motions close to obstacles, and out of contacts: what the map says may be a cell too much.
//!
//! A vehicle may find that it touches something: a cell was drawn larger than what is in it, or the pose moved. It must not stay there
//! for ever, nor run into anything on the way out. So a motion may pass if it touches nothing, or, out of a contact, if no obstacle
//! comes deeper into the outline than it is, or than half as deep as the deepest is.

use super::NavigationRequest;
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, Twist2},
    grid::{Cell, Footprint},
    nalgebra::Vector2,
};

/// Tolerance of the look at motions, in cells.
pub(super) const MARGIN: f64 = 1.0 / 16.0;
/// Distance between looks at a motion, in cells: no obstacle passes between.
const SPACING: f64 = 0.5;
/// Distance from an obstacle's centre at which it is touched, in cells.
const TOUCHING: f64 = 0.5;
/// Granted to each motion, in metres: what moves along an outline that is turned by a rounding.
const ROUNDING: f64 = 0.002;
/// Room from which on more is worth no more, in metres.
const ENOUGH: f64 = 0.6;

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
    let reach = footprint.circumscribed_radius() + way + resolution;
    Ok(obstacles_within(request, pose, reach).all(|obstacle| {
        let needed = room_of(footprint, pose, &obstacle).min(half_as_deep) - ROUNDING;
        (1..=looks).all(|look| {
            let at = pose.compose(&twist.integrate(duration * look as f64 / looks as f64));
            room_of(footprint, &at, &obstacle) >= needed
        })
    }))
}

/// Least distance of the outline from an obstacle's centre, in metres, below zero for one within it; [`ENOUGH`] at the most.
pub(super) fn room(request: &NavigationRequest<'_>, footprint: &Footprint, pose: &Se2) -> f64 {
    let near = obstacles_within(request, pose, footprint.circumscribed_radius() + ENOUGH);
    near.map(|obstacle| room_of(footprint, pose, &obstacle)).fold(ENOUGH, f64::min)
}

fn room_of(footprint: &Footprint, pose: &Se2, obstacle: &Vector2<f64>) -> f64 {
    footprint.signed_distance(&pose.inverse().act(obstacle))
}

/// Centres of the cells that are obstacles within a square around a pose, in the map frame.
fn obstacles_within<'a>(
    request: &NavigationRequest<'a>,
    pose: &Se2,
    reach: f64,
) -> impl Iterator<Item = Vector2<f64>> + use<'a> {
    let (layout, obstacles) = (*request.map.layout(), request.map.obstacles());
    let (distances, outside) = (obstacles.distance().values(), obstacles.params().outside_is_obstacle);
    let middle = layout.to_grid(&pose.translation());
    let cells = (reach / layout.resolution()).ceil().clamp(0.0, 1e4) as i32;
    let span = move |at: f64| (at.floor() as i32).saturating_sub(cells)..=(at.floor() as i32).saturating_add(cells);
    let around = span(middle.y).flat_map(move |y| span(middle.x).map(move |x| Cell::new(x, y)));
    let is_obstacle = move |cell: &Cell| layout.index(*cell).map_or(outside, |i| distances.get(i) == Some(&0.0));
    around.filter(is_obstacle).map(move |cell| layout.center(cell))
}
