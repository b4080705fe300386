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

/// How far ahead of a vehicle that is off the path its nearest point is searched, as a multiple of its distance from the path:
/// around a corner of 30° the way along the path is so much longer.
const DETOUR: f64 = 4.0;

impl Course {
    /// Moves the progress to the nearest point of the present section, not searching farther ahead than `reach`
    /// metres nor behind the segment that was nearest before; none if there is no course.
    pub fn advance(&mut self, position: &Vector2<f64>, reach: f64) -> Option<Projection> {
        self.advance_within(position, reach, reach)
    }

    /// As [`advance`](Self::advance), `stride` metres ahead (at least what the vehicle may have driven), and farther only if the
    /// vehicle is off the path: four times its distance, up to `reach` metres in all. So a path that comes back to where it was
    /// does not catch a vehicle that is on it.
    ///
    /// Near the path a handful of segments is looked at, however short they are: from a vertex at the distance `D` on, no point
    /// nearer than the best, at `d`, comes within the next `D - d` metres of arc length.
    pub fn advance_within(&mut self, position: &Vector2<f64>, stride: f64, reach: f64) -> Option<Projection> {
        let section = *self.sections.get(self.section)?;
        if let Leg::Turn(yaw) = section.leg {
            let direction = So2::from_angle(yaw);
            let offset = position - self.vertices[section.first];
            let cross_track = offset.norm().copysign(side(direction, offset));
            return Some(Projection { arc_length: self.progress, cross_track, direction });
        }
        let mut segment = self.segment.max(section.first);
        let mut best = Nearest { square: f64::INFINITY, distance: f64::INFINITY, segment, ahead: 0.0, across: 0.0 };
        loop {
            let (direction, begin, end) =
                (self.directions[segment], self.arc_lengths[segment], self.arc_lengths[segment + 1]);
            let offset = position - self.vertices[segment];
            let along = direction.cos() * offset.x + direction.sin() * offset.y;
            let across = side(direction, offset);
            let ahead = along.clamp(0.0, end - begin);
            let (beyond, left) = (along - ahead, along - (end - begin));
            let square = across * across + beyond * beyond;
            if square < best.square {
                best = Nearest { square, distance: square.sqrt(), segment, ahead, across };
            }
            if segment + 1 >= section.last {
                break;
            }
            let to_end = (across * across + left * left).sqrt();
            let following = self.segment_from(segment + 1, end + to_end - best.distance);
            let limit = self.progress + reach.min(stride + DETOUR * best.distance);
            if following >= section.last || self.arc_lengths[following] > limit {
                break;
            }
            segment = following;
        }
        self.segment = best.segment;
        self.progress = self.arc_lengths[best.segment] + best.ahead;
        // The distance to the nearest point, so that beyond a corner or the end nothing is understated.
        let cross_track = best.distance.copysign(best.across);
        Some(Projection { arc_length: self.progress, cross_track, direction: self.directions[best.segment] })
    }

    /// The segment from `first` on that holds an arc length; one after the last if none does.
    #[inline]
    fn segment_from(&self, first: usize, arc_length: f64) -> usize {
        let mut segment = first;
        while segment < self.directions.len() && self.arc_lengths[segment + 1] <= arc_length {
            segment += 1;
            if segment == first + NEAR {
                return segment.max(self.segment_at(arc_length));
            }
        }
        segment
    }
}

/// Segments that are counted one by one before they are looked up.
const NEAR: usize = 4;

/// The nearest point so far.
struct Nearest {
    square: f64,
    distance: f64,
    segment: usize,
    /// How far ahead of the segment's beginning it is.
    ahead: f64,
    /// How far to the left of the segment the vehicle is.
    across: f64,
}

/// How far to the left of a direction an offset points, in metres.
#[inline]
fn side(direction: So2, offset: Vector2<f64>) -> f64 {
    direction.cos() * offset.y - direction.sin() * offset.x
}
