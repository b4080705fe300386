//! What the field says at a point: the distance, the way down, and where that leads.

use super::NavigationField;
use agv_core::{geometry::LieGroup, grid::Cell};
use nalgebra::Vector2;

/// Distance from the target within which it is seen as the crow flies, in metres.
const NEAR: f64 = 0.35;

impl NavigationField {
    /// Distance from a point of the map to the target, in weighed metres; infinite where it is not known.
    #[inline]
    pub fn value_at(&self, point: &Vector2<f64>) -> f32 {
        let to_target = (point - self.target).norm();
        if to_target < NEAR {
            return to_target as f32;
        }
        let Some(layout) = &self.layout else { return f32::INFINITY };
        let p = layout.to_grid(point);
        let (u, v) = (p.x - 0.5, p.y - 0.5);
        if !(u > -1.0 && v > -1.0 && u < layout.width() as f64 && v < layout.height() as f64) {
            return f32::INFINITY;
        }
        let (x, y) = (u.floor(), v.floor());
        let (du, dv) = ((u - x) as f32, (v - y) as f32);
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy, weight) in
            [(0, 0, (1.0 - du) * (1.0 - dv)), (1, 0, du * (1.0 - dv)), (0, 1, (1.0 - du) * dv), (1, 1, du * dv)]
        {
            let value = layout.index(Cell::new(x as i32 + dx, y as i32 + dy)).and_then(|i| self.values.get(i));
            if let Some(&value) = value.filter(|value| value.is_finite()) {
                sum += weight * value;
                weights += weight;
            }
        }
        // Where most of what surrounds the point is closed, the vehicle cannot be.
        if weights > 0.2 { sum / weights } else { f32::INFINITY }
    }

    /// Where a local frame with the axes of the map's grid has its origin, counted in cells.
    pub(crate) fn origin_of(&self, position: &Vector2<f64>) -> Option<LocalOrigin> {
        let layout = self.layout.as_ref()?;
        let origin = layout.to_grid(position).cast();
        let target = (layout.to_grid(&self.target) - layout.to_grid(position)) * layout.resolution();
        Some(LocalOrigin { origin, per_metre: (1.0 / layout.resolution()) as f32, target: target.cast() })
    }

    /// Value and direction of steepest descent at a point of a local frame, along the axes of the grid; infinite where it is not known,
    /// and no direction where there is none.
    #[inline]
    pub(crate) fn local_value(&self, local: &LocalOrigin, x: f32, y: f32) -> (f32, [f32; 2]) {
        let (dx, dy) = (local.target.x - x, local.target.y - y);
        let square = dx * dx + dy * dy;
        if square < (NEAR * NEAR) as f32 {
            let distance = square.sqrt();
            let per = 1.0 / distance.max(1e-6);
            return (distance, [dx * per, dy * per]);
        }
        let Some(layout) = &self.layout else { return (f32::INFINITY, [0.0; 2]) };
        let (u, v) = (x * local.per_metre + local.origin.x - 0.5, y * local.per_metre + local.origin.y - 0.5);
        let (width, height) = (layout.width(), layout.height());
        if !(u >= 0.0 && v >= 0.0 && u < (width - 1) as f32 && v < (height - 1) as f32) {
            return (f32::INFINITY, [0.0; 2]);
        }
        // Not negative: the cast is the floor.
        let (column, row) = (u as usize, v as usize);
        let (du, dv) = (u - column as f32, v - row as f32);
        let first = row * width + column;
        let (Some(below), Some(above)) =
            (self.values.get(first..first + 2), self.values.get(first + width..first + width + 2))
        else {
            return (f32::INFINITY, [0.0; 2]);
        };
        let (a, b, c, d) = (below[0], below[1], above[0], above[1]);
        let value = (1.0 - dv) * ((1.0 - du) * a + du * b) + dv * ((1.0 - du) * c + du * d);
        if value.is_finite() {
            let (gx, gy) = ((1.0 - dv) * (b - a) + dv * (d - c), (1.0 - du) * (c - a) + du * (d - b));
            let norm = (gx * gx + gy * gy).sqrt().max(1e-9);
            return (value, [-gx / norm, -gy / norm]);
        }
        // At the edge of what is known: of those that are, the nearest way down.
        let (mut sum, mut weights) = (0.0, 0.0);
        for (value, weight) in [(a, (1.0 - du) * (1.0 - dv)), (b, du * (1.0 - dv)), (c, (1.0 - du) * dv), (d, du * dv)]
        {
            if value.is_finite() {
                (sum, weights) = (sum + weight * value, weights + weight);
            }
        }
        if weights <= 0.2 {
            return (f32::INFINITY, [0.0; 2]);
        }
        let point = layout.to_map(&Vector2::new(f64::from(u) + 0.5, f64::from(v) + 0.5));
        let down = self.descent(&point).unwrap_or_default();
        let axes = layout.map_from_grid().rotation().inverse().act(&down);
        (sum / weights, [axes.x as f32, axes.y as f32])
    }

    /// Direction in which the field falls fastest at a point, of unit length, in the map frame; none where it is not known.
    pub fn descent(&self, point: &Vector2<f64>) -> Option<Vector2<f64>> {
        let to_target = self.target - point;
        if to_target.norm() < NEAR {
            return to_target.try_normalize(1e-9);
        }
        let step = self.layout.as_ref()?.resolution();
        let here = self.value_at(point);
        let slope = |axis: Vector2<f64>| {
            let (ahead, behind) = (self.value_at(&(point + axis * step)), self.value_at(&(point - axis * step)));
            match (ahead.is_finite(), behind.is_finite()) {
                (true, true) => 0.5 * (ahead - behind),
                (true, false) => (ahead - here).min(0.0),
                (false, true) => (here - behind).max(0.0),
                (false, false) => 0.0,
            }
        };
        let gradient = Vector2::new(f64::from(slope(Vector2::x())), f64::from(slope(Vector2::y())));
        if !here.is_finite() {
            return None;
        }
        (-gradient).try_normalize(1e-6)
    }

    /// Walks down from a point and remembers the way.
    pub fn trace(&mut self, from: &Vector2<f64>) {
        let Some(layout) = self.layout else { return };
        let mut way = std::mem::take(&mut self.way);
        way.clear();
        let (mut point, step) = (*from, layout.resolution());
        for _ in 0..MOST_STEPS {
            way.push(point);
            if (self.target - point).norm() < step {
                break;
            }
            let Some(direction) = self.descent(&point) else { break };
            point += direction * step;
        }
        self.way = way;
    }
}

/// A local frame in the field's cells.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalOrigin {
    origin: Vector2<f32>,
    per_metre: f32,
    /// The target in the local frame, in metres.
    target: Vector2<f32>,
}

/// Steps of a way at the most.
const MOST_STEPS: usize = 96;
