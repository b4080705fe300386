//! The path that is followed: what it costs from here, whether it is blocked, and the part that the local planner is given.

use super::NavigationParams;
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se2, nearest_on_segment},
    grid::{Costmap, GridLayout, cost},
    nalgebra::Vector2,
    path::Path,
};

/// A path and the vehicle's place on it.
#[derive(Debug, Clone, Default)]
pub(super) struct Route {
    path: Path,
    /// The part that the local planner is given.
    ahead: Path,
    /// Index of the point that the vehicle is on the way to, and the point of the line there that is nearest to it.
    next: usize,
    place: Vector2<f64>,
    /// Index up to which `ahead` reaches.
    end: usize,
}

impl Route {
    pub(super) const fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn is_empty(&self) -> bool {
        self.path.is_empty()
    }

    pub(super) fn clear(&mut self) {
        self.path.clear();
        self.ahead.clear();
        (self.next, self.end) = (0, 0);
    }

    pub(super) fn set(&mut self, path: &Path, here: &Se2) -> Result<(), Error> {
        self.clear();
        path.points().iter().try_for_each(|point| self.path.push(*point))?;
        self.place = here.translation();
        self.advance(here);
        Ok(())
    }

    /// Moves the place on to the nearest point of the path, not farther than two metres ahead of the last one.
    pub(super) fn advance(&mut self, here: &Se2) {
        const REACH: f64 = 2.0;
        let position = here.translation();
        let points = self.path.points();
        let (mut best, mut found, mut from, mut far) = (f64::INFINITY, None, self.place, 0.0);
        for (index, point) in points.iter().enumerate().skip(self.next.max(1)) {
            let to = point.pose.translation();
            let nearest = nearest_on_segment(position, from, to);
            let distance = (nearest - position).norm();
            if distance < best {
                (best, found) = (distance, Some((index, nearest)));
            }
            far += (to - from).norm();
            from = to;
            if far > REACH {
                break;
            }
        }
        if let Some((next, place)) = found {
            (self.next, self.place) = (next, place);
        }
    }

    /// What the path costs from the vehicle's place on; none if it is blocked within the look-ahead, or there is none.
    pub(super) fn cost(&self, costmap: &Costmap, params: &NavigationParams) -> Option<f64> {
        let rest = self.path.points().get(self.next..).filter(|rest| !rest.is_empty())?;
        let places = std::iter::once(self.place).chain(rest.iter().map(|point| point.pose.translation()));
        let (total, blocked_at) = survey(places, costmap, params);
        (blocked_at > params.look_ahead).then_some(total)
    }

    /// The point of the path so many metres from the vehicle's place, or its end; none without a path.
    pub(super) fn place_ahead(&self, mut distance: f64) -> Option<Vector2<f64>> {
        let mut from = self.place;
        for point in self.path.points().iter().skip(self.next) {
            let to = point.pose.translation();
            let length = (to - from).norm();
            if length >= distance && length > 0.0 {
                return Some(from + (to - from) * (distance / length));
            }
            distance -= length;
            from = to;
        }
        (!self.path.is_empty()).then_some(from)
    }

    /// The path up to the first of its points that lies `reach` metres ahead.
    pub(super) fn ahead(&mut self, reach: f64) -> &Path {
        if reach == f64::INFINITY {
            return &self.path;
        }
        let (mut far, mut from, mut end) = (0.0, self.place, self.path.len().saturating_sub(1));
        for (index, point) in self.path.points().iter().enumerate().skip(self.next) {
            let to = point.pose.translation();
            far += (to - from).norm();
            from = to;
            if far >= reach {
                end = index;
                break;
            }
        }
        if end != self.end || self.ahead.is_empty() {
            self.end = end;
            self.ahead.clear();
            // Poses of a path are finite: nothing is refused.
            for point in self.path.points().iter().take(end + 1) {
                let _ = self.ahead.push(*point);
            }
        }
        &self.ahead
    }
}

/// What a path costs from its beginning, blocked parts at the price of the dearest.
pub(super) fn cost_of(path: &Path, costmap: &Costmap, params: &NavigationParams) -> f64 {
    survey(path.points().iter().map(|point| point.pose.translation()), costmap, params).0
}

/// Cost of a line of places, and how far along it the first obstacle is, past those that the vehicle stands in.
fn survey(places: impl Iterator<Item = Vector2<f64>>, costmap: &Costmap, params: &NavigationParams) -> (f64, f64) {
    let step = costmap.layout().resolution();
    let (mut total, mut far, mut blocked_at, mut is_out) = (0.0, 0.0, f64::INFINITY, false);
    let mut last: Option<Vector2<f64>> = None;
    for place in places {
        let Some(from) = last.replace(place) else { continue };
        let length = (place - from).norm();
        let count = (length / step).ceil().max(1.0);
        for k in 0..count as usize {
            let at = from + (place - from) * ((k as f64 + 0.5) / count);
            let cell = costmap.layout().cell_at(&at).and_then(|cell| costmap.cost(cell)).unwrap_or(cost::FREE);
            let is_blocked = matches!(cell, cost::INSCRIBED | cost::LETHAL);
            is_out |= !is_blocked;
            if is_blocked && is_out {
                blocked_at = blocked_at.min(far + length * (k as f64 + 0.5) / count);
            }
            let price = if cell == cost::UNKNOWN { 0 } else { cell.min(cost::MAX_NON_OBSTACLE) };
            let dearness = f64::from(price) / f64::from(cost::MAX_NON_OBSTACLE);
            total += length / count * (1.0 + params.cost_weight * dearness);
        }
        far += length;
    }
    (total, blocked_at)
}

/// The goal, or where the line to it leaves a map less its border.
pub(super) fn target_in(layout: &GridLayout, here: &Se2, goal: &Se2, border: f64) -> Se2 {
    let grid_from_map = layout.map_from_grid().inverse();
    let (from, to) = (grid_from_map * here.translation(), grid_from_map * goal.translation());
    let size = [layout.width(), layout.height()].map(|cells| cells as f64 * layout.resolution());
    let mut share = 1.0_f64;
    for (axis, size) in size.into_iter().enumerate() {
        let (a, b) = (from[axis], to[axis]);
        // A hair inside, so that rounding does not lead out.
        let (low, high) = (border.min(0.49 * size) + 1e-6, size - border.min(0.49 * size) - 1e-6);
        if b > high && b > a {
            share = share.min((high - a) / (b - a));
        } else if b < low && b < a {
            share = share.min((low - a) / (b - a));
        }
    }
    if share >= 1.0 {
        return *goal;
    }
    let place = here.translation() + (goal.translation() - here.translation()) * share.max(0.0);
    let way = goal.translation() - place;
    Se2::new(place.x, place.y, way.y.atan2(way.x))
}
