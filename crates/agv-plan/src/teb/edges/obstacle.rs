//! Clearance from what stands and from what moves, and speed by clearance.

use super::{BandEdge, Direction, Residuals, Term, Window, segment::Segment};
use agv_core::{
    grid::LocalMap,
    obstacle::{Hull, MovingObstacle},
};
use nalgebra::Vector2;

/// A part of the vehicle: a circle of the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Its centre in the base frame, in metres.
    pub center: Vector2<f64>,
    /// Its radius, in metres.
    pub radius: f64,
}

impl Circle {
    /// Where its centre is in the map at a pose, and by how much that moves per radian of heading.
    #[inline]
    fn place(&self, x: f64, y: f64, Direction { sin, cos }: Direction) -> (Vector2<f64>, Vector2<f64>) {
        let c = self.center;
        let arm = Vector2::new(cos * c.x - sin * c.y, sin * c.x + cos * c.y);
        (Vector2::new(x + arm.x, y + arm.y), Vector2::new(-arm.y, arm.x))
    }
}

/// Clearance of a circle on the field of distances, from the edge of the nearest blocked cell; none off the map.
#[inline]
fn clearance<const K: usize>(map: &LocalMap, circle: &Circle, window: &Window<K>) -> Option<Term<3>> {
    let (point, by_yaw) = circle.place(window.unknowns[0], window.unknowns[1], window.headings[0]);
    let (distance, slope) = map.distance_at(&point)?;
    let value = distance - circle.radius - 0.5 * map.layout().resolution();
    Some(Term { value, gradient: [slope.x, slope.y, slope.dot(&by_yaw)] })
}

/// The vehicle keeps clear of what stands: `√w (clearance wanted - clearance)` for each of its circles where that is positive, and
/// the same with another weight for a greater clearance that is wished; on the field of distances, as fast for a thousand obstacles
/// as for one.
#[derive(Debug, Clone, Copy)]
pub struct Clearance<'a> {
    /// Where the obstacles are.
    pub map: &'a LocalMap,
    /// What the vehicle is made of.
    pub circles: &'a [Circle],
    /// Clearance that is wanted, in metres.
    pub clearance: f64,
    /// Weight, in 1/m².
    pub weight: f64,
    /// Clearance that is wished, in metres; no more than what is wanted for none.
    pub inflation: f64,
    /// Weight of what is missing to that, in 1/m².
    pub inflation_weight: f64,
}

impl BandEdge<3> for Clearance<'_> {
    #[inline]
    fn residuals(&self, window: &Window<3>, out: &mut impl Residuals) {
        let (root, wish) = (self.weight.sqrt(), self.inflation_weight.sqrt());
        for circle in self.circles {
            if let Some(term) = clearance(self.map, circle, window) {
                let term = term.negated();
                term.at_most(-self.clearance, root, out);
                if self.inflation > self.clearance {
                    term.at_most(-self.inflation, wish, out);
                }
            }
        }
    }
}

/// The nearer to obstacles, the slower: `√w (|v| - speed - per metre · clearance)` where that is positive.
#[derive(Debug, Clone, Copy)]
pub struct CautiousSpeed<'a> {
    /// Where the obstacles are.
    pub map: &'a LocalMap,
    /// What the vehicle is made of.
    pub circles: &'a [Circle],
    /// Speed at no clearance, in metres per second.
    pub speed: f64,
    /// Clearance from which on the speed is not bounded, in metres.
    pub caution: f64,
    /// By how much the speed grows per metre of clearance, in 1/s.
    pub per_metre: f64,
    /// Weight.
    pub weight: f64,
}

impl BandEdge<7> for CautiousSpeed<'_> {
    #[inline]
    fn residuals(&self, window: &Window<7>, out: &mut impl Residuals) {
        let segment = Segment::new(window);
        let speed = segment.rate(&segment.along);
        // Slow enough anywhere.
        if speed.value.abs() <= self.speed {
            return;
        }
        let near = |best: Option<Term<3>>, circle: &Circle| match (best, clearance(self.map, circle, window)) {
            (Some(a), Some(b)) => Some(if b.value < a.value { b } else { a }),
            (a, b) => a.or(b),
        };
        let Some(nearest) = self.circles.iter().fold(None, near) else { return };
        if nearest.value >= self.caution {
            return;
        }
        let sign = speed.value.signum();
        let mut gradient = speed.gradient.map(|g| sign * g);
        let room = nearest.value.max(0.0);
        if nearest.value > 0.0 {
            for (to, from) in gradient.iter_mut().zip(nearest.gradient) {
                *to -= self.per_metre * from;
            }
        }
        Term { value: speed.value.abs() - self.per_metre * room, gradient }.at_most(
            self.speed,
            self.weight.sqrt(),
            out,
        );
    }
}

/// The vehicle keeps clear of something that moves, where that will be when the vehicle is there.
///
/// The time is taken as given within a step of the solver, as by Rösmann et al.: that it depends on all intervals before would fill
/// the band.
#[derive(Debug, Clone, Copy)]
pub struct MovingClearance<'a> {
    /// What moves.
    pub obstacle: &'a MovingObstacle,
    /// What the vehicle is made of.
    pub circles: &'a [Circle],
    /// When the vehicle is at the pose, in seconds from now.
    pub time: f64,
    /// Clearance that is wanted, in metres.
    pub clearance: f64,
    /// Weight, in 1/m².
    pub weight: f64,
}

impl BandEdge<3> for MovingClearance<'_> {
    #[inline]
    fn residuals(&self, window: &Window<3>, out: &mut impl Residuals) {
        let root = self.weight.sqrt();
        let center = self.obstacle.position_after(self.time);
        for circle in self.circles {
            let (point, by_yaw) = circle.place(window.unknowns[0], window.unknowns[1], window.headings[0]);
            let reach = self.obstacle.circumscribed_radius() + circle.radius + self.clearance;
            let offset = point - center;
            if offset.norm_squared() > reach * reach {
                continue;
            }
            let (distance, slope) = distance_and_slope(&self.obstacle.hull, &offset);
            let value = distance - self.obstacle.radius - circle.radius;
            let term = Term { value, gradient: [slope.x, slope.y, slope.dot(&by_yaw)] };
            term.negated().at_most(-self.clearance, root, out);
        }
    }
}

/// Distance of a point from an outline, negative inside, and its gradient.
fn distance_and_slope(hull: &Hull, point: &Vector2<f64>) -> (f64, Vector2<f64>) {
    let vertices = hull.vertices();
    let mut nearest = (f64::INFINITY, Vector2::zeros());
    let mut inside = vertices.len() > 2;
    for (i, a) in vertices.iter().enumerate() {
        let b = vertices.get(i + 1).unwrap_or(&vertices[0]);
        let (edge, offset) = (b - a, point - a);
        let square = edge.norm_squared();
        let share = if square > 0.0 { (offset.dot(&edge) / square).clamp(0.0, 1.0) } else { 0.0 };
        let away = offset - edge * share;
        if away.norm_squared() < nearest.0 {
            nearest = (away.norm_squared(), away);
        }
        inside &= edge.x * offset.y - edge.y * offset.x >= 0.0;
    }
    let distance = nearest.0.sqrt();
    let slope = if distance > 0.0 { nearest.1 / distance } else { Vector2::zeros() };
    if inside { (-distance, -slope) } else { (distance, slope) }
}
