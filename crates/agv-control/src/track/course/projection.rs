//! Where on its course a vehicle is.

use super::{Course, Leg};
use agv_core::geometry::So2;
use nalgebra::Vector2;

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

impl Course {
    /// Moves the progress to the nearest point of the present section, not searching farther ahead than `reach`
    /// metres nor behind the segment that was nearest before; none if there is no course.
    ///
    /// Near the path a handful of segments is looked at, however short they are: from a vertex at the distance `D` on, no point
    /// nearer than the best, at `d`, comes within the next `D - d` metres of arc length.
    pub fn advance(&mut self, position: &Vector2<f64>, reach: f64) -> Option<Projection> {
        let section = *self.sections.get(self.section)?;
        if let Leg::Turn(yaw) = section.leg {
            let direction = So2::from_angle(yaw);
            let offset = position - self.vertices[section.first];
            let cross_track = offset.norm().copysign(side(direction, offset));
            return Some(Projection { arc_length: self.progress, cross_track, direction });
        }
        let limit = self.progress + reach;
        let mut segment = self.segment.max(section.first);
        let mut best = (f64::INFINITY, segment, 0.0);
        loop {
            let (direction, begin, end) =
                (self.directions[segment], self.arc_lengths[segment], self.arc_lengths[segment + 1]);
            let offset = position - self.vertices[segment];
            let along = direction.cos() * offset.x + direction.sin() * offset.y;
            let ahead = along.clamp(0.0, end - begin);
            let across = side(direction, offset);
            let distance = norm(across, along - ahead);
            if distance < best.0 {
                best = (distance, segment, ahead);
            }
            let to_end = norm(across, along - (end - begin));
            let next = end + (to_end - best.0).max(0.0);
            if segment + 1 >= section.last {
                break;
            }
            let following = self.segment_at(next).max(segment + 1);
            if following >= section.last || self.arc_lengths[following] > limit {
                break;
            }
            segment = following;
        }
        let (distance, segment, ahead) = best;
        self.segment = segment;
        self.progress = self.arc_lengths[segment] + ahead;
        let direction = self.directions[segment];
        let offset = position - self.vertices[segment];
        // The distance to the nearest point, so that beyond a corner or the end nothing is understated.
        let cross_track = distance.copysign(side(direction, offset));
        Some(Projection { arc_length: self.progress, cross_track, direction })
    }
}

/// How far to the left of a direction an offset points, in metres.
#[inline]
fn side(direction: So2, offset: Vector2<f64>) -> f64 {
    direction.cos() * offset.y - direction.sin() * offset.x
}

/// As `hypot`, without its guard against overflow, which takes ten times as long.
#[inline]
fn norm(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}
