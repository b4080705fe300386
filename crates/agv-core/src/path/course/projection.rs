//! Where on its course a vehicle is.

use super::{Course, Leg, Section};
use crate::geometry::So2;
use nalgebra::Vector2;
use std::ops::Range;

/// The vehicle's place on the course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the nearest point, in metres from the beginning of the course.
    pub arc_length: f64,
    /// Distance of the vehicle from the nearest point, in metres; positive to the left of the direction of travel.
    pub cross_track: f64,
    /// Direction of travel there, in the map frame; in a turn on the spot the heading to turn to.
    pub direction: So2,
}

/// What is known of the course beyond the segments next to the vehicle: how far it is from there, so that the nearest point need not be
/// searched in it while the vehicle has moved less than that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Clearance {
    /// Where the vehicle was.
    position: Vector2<f64>,
    /// First segment that is known, and arc length up to which they are.
    first: usize,
    end: f64,
    /// No point of them is nearer to the position than this, in metres.
    distance: f64,
}

/// Segments that are looked at one by one in every cycle.
const NEXT: usize = 12;

/// How much farther than asked for the clearance is known, in metres: the way on which it need not be renewed.
const FARTHER: f64 = 0.5;

impl Course {
    /// Moves the progress to the nearest point of the present section, not searching farther ahead than `reach`
    /// metres nor behind the segment that was nearest before; none if there is no course.
    ///
    /// Amortised over a drive a dozen segments are looked at in a cycle.
    pub fn advance(&mut self, position: &Vector2<f64>, reach: f64) -> Option<Projection> {
        let section = *self.sections.get(self.section)?;
        if let Leg::Turn(yaw) = section.leg {
            let direction = So2::from_angle(yaw);
            let offset = position - self.vertices[section.first];
            let cross_track = offset.norm().copysign(side(direction, offset));
            return Some(Projection { arc_length: self.progress, cross_track, direction });
        }
        let limit = self.progress + reach;
        let start = self.segment.max(section.first);
        let known = self.clearance.filter(|c| {
            c.first >= start
                && c.first <= start + 2 * NEXT
                && (limit <= c.end || c.end >= self.arc_lengths[section.last])
        });
        let (segment, ahead, distance) = match known {
            Some(known) => {
                let (segment, ahead, square) = self.nearest(start..known.first, limit, position);
                let distance = square.sqrt();
                let room = known.distance - distance;
                if room > 0.0 && (position - known.position).norm_squared() < room * room {
                    (segment, ahead, distance)
                } else {
                    self.search(&section, start, limit, position)
                }
            }
            None => self.search(&section, start, limit, position),
        };
        self.segment = segment;
        self.progress = self.arc_lengths[segment] + ahead;
        let direction = self.directions[segment];
        let offset = position - self.vertices[segment];
        // The distance to the nearest point, so that beyond a corner or the end nothing is understated.
        let cross_track = distance.copysign(side(direction, offset));
        Some(Projection { arc_length: self.progress, cross_track, direction })
    }

    /// The nearest point from a segment on to an arc length: its segment, how far along that it lies, and its distance. Renews the
    /// clearance.
    ///
    /// Near the path a handful of segments is looked at, however short they are: from a vertex at the distance `D` on, no point
    /// nearer than the best, at `d`, comes within the next `D - d` metres of arc length.
    fn search(&mut self, section: &Section, start: usize, limit: f64, position: &Vector2<f64>) -> (usize, f64, f64) {
        let mut segment = start;
        let mut best = (segment, 0.0, f64::INFINITY);
        loop {
            let (_, ahead, square) = self.nearest(segment..segment + 1, limit, position);
            let distance = square.sqrt();
            if distance < best.2 {
                best = (segment, ahead, distance);
            }
            if segment + 1 >= section.last {
                break;
            }
            let to_end = self.distance(segment + 1, position);
            let next = self.arc_lengths[segment + 1] + (to_end - best.2).max(0.0);
            let following = self.segment_at(next).max(segment + 1);
            if following >= section.last || self.arc_lengths[following] > limit {
                break;
            }
            segment = following;
        }
        self.clearance =
            Some(self.clearance_from((best.0 + NEXT).min(section.last), section.last, limit + FARTHER, position));
        best
    }

    /// How far the course is from a position, from the vertex `first` to `last` or to an arc length: two vertices at the distances
    /// `D` and `E`, `l` metres of arc length apart, have nothing nearer than `(D + E - l) / 2` between them.
    fn clearance_from(&self, first: usize, last: usize, limit: f64, position: &Vector2<f64>) -> Clearance {
        let (mut vertex, mut from) = (first, self.distance(first, position));
        let mut distance = from;
        while vertex < last && self.arc_lengths[vertex] < limit {
            let next = (self.segment_at(self.arc_lengths[vertex] + from)).clamp(vertex + 1, last);
            let to = self.distance(next, position);
            distance = distance.min(0.5 * (from + to - (self.arc_lengths[next] - self.arc_lengths[vertex])));
            (vertex, from) = (next, to);
        }
        Clearance { position: *position, first, end: self.arc_lengths[vertex], distance }
    }

    /// The nearest of some segments that begin at an arc length of at most `limit` (the first one always counts): its index, how
    /// far along it the nearest point lies, and the squared distance.
    #[inline]
    fn nearest(&self, segments: Range<usize>, limit: f64, position: &Vector2<f64>) -> (usize, f64, f64) {
        let ends = self.arc_lengths[segments.start..=segments.end].windows(2);
        let lines = self.directions[segments.clone()].iter().zip(&self.vertices[segments.clone()]);
        let mut best = (segments.start, 0.0, f64::INFINITY);
        for ((segment, (&direction, vertex)), ends) in segments.clone().zip(lines).zip(ends) {
            if ends[0] > limit && segment > segments.start {
                break;
            }
            let offset = position - vertex;
            let along = direction.cos() * offset.x + direction.sin() * offset.y;
            let ahead = along.max(0.0).min(ends[1] - ends[0]);
            let (beyond, across) = (along - ahead, side(direction, offset));
            let square = beyond * beyond + across * across;
            if square < best.2 {
                best = (segment, ahead, square);
            }
        }
        best
    }

    /// Distance of a vertex, without the guard of `hypot` against overflow.
    #[inline]
    fn distance(&self, vertex: usize, position: &Vector2<f64>) -> f64 {
        (position - self.vertices[vertex]).norm()
    }
}

/// How far to the left of a direction an offset points, in metres.
#[inline]
fn side(direction: So2, offset: Vector2<f64>) -> f64 {
    direction.cos() * offset.y - direction.sin() * offset.x
}
