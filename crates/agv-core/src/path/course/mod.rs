//! A path by arc length, with a progress that moves along it.

mod bends;
mod projection;

use super::{Gear, Path, SAME_HEADING};
use crate::{
    Error,
    geometry::{So2, angle_difference, small_angle},
};
pub use bends::Bend;
use bends::Knots;
use nalgebra::Vector2;
use projection::Clearance;
pub use projection::Projection;

/// What a stretch of a course asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Leg {
    /// Driving, until the end or a cusp.
    Drive(Gear),
    /// Turning on the spot, to a heading of the base in the map, in radians.
    Turn(f64),
}

/// One leg, from its first vertex to its last; a turn has one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Section {
    first: usize,
    last: usize,
    leg: Leg,
}

/// A path without repeated points, by arc length, cut at its cusps and turns on the spot.
///
/// A last heading that is not that of the last line is a turn on the spot, too. The progress is searched forward from where it
/// was, so that following a whole path costs one pass over it, and a path that crosses itself is followed in order.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::{Course, Path};
///
/// let mut course = Course::new(0.5);
/// course.set(&Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(4.0, 0.0), Vector2::new(4.0, 3.0)])?)?;
/// let place = course.advance(&Vector2::new(1.5, -0.2), 2.0).unwrap();
/// assert_eq!((place.arc_length, place.cross_track), (1.5, -0.2));
/// assert_eq!(course.point_at(5.0).unwrap().0, Vector2::new(4.0, 1.0));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    vertices: Vec<Vector2<f64>>,
    /// Heading of the base on arrival at each vertex and on leaving it, in radians.
    headings: Vec<[f64; 2]>,
    /// Arc length at each vertex, in metres.
    arc_lengths: Vec<f64>,
    /// Direction of travel on each segment between two vertices.
    directions: Vec<So2>,
    knots: Knots,
    sections: Vec<Section>,
    /// Section that is being driven, and the segment in it that the vehicle is nearest to.
    section: usize,
    segment: usize,
    /// Arc length of the vehicle's last projection, in metres.
    progress: f64,
    /// Where the nearest point need not be searched.
    clearance: Option<Clearance>,
}

impl Course {
    /// An empty course, on which corners will be read as bends over `bend_window` metres.
    pub const fn new(bend_window: f64) -> Self {
        Self {
            vertices: Vec::new(),
            headings: Vec::new(),
            arc_lengths: Vec::new(),
            directions: Vec::new(),
            knots: Knots::new(bend_window),
            sections: Vec::new(),
            section: 0,
            segment: 0,
            progress: 0.0,
            clearance: None,
        }
    }

    /// Takes a path; repeated points are dropped. The memory is reused.
    ///
    /// # Errors
    /// [`Error::TooFew`] if there are not two distinct poses; the old course is then kept.
    pub fn set(&mut self, path: &Path) -> Result<(), Error> {
        let points = path.points();
        let position = |i: usize| points[i].pose.translation();
        // The indices run over the points but the first.
        if !(1..points.len()).any(|i| path.is_turn(i) || position(i) != position(i - 1)) {
            return Err(Error::TooFew { name: "distinct poses of the path", min: 2, len: points.len().min(1) });
        }
        self.clear();
        for (i, point) in points.iter().enumerate() {
            let (position, yaw) = (point.pose.translation(), point.pose.yaw());
            let Some(&last) = self.vertices.last() else {
                self.push_vertex(position, yaw, 0.0);
                continue;
            };
            if position != last {
                self.drive_to(position, yaw, point.gear);
            } else if path.is_turn(i) {
                self.turn_to(yaw);
            }
        }
        if let (Some(section), Some(direction), Some([yaw, _])) =
            (self.sections.last(), self.directions.last(), self.headings.last())
        {
            let end = match section.leg {
                Leg::Drive(Gear::Forward) => direction.angle(),
                Leg::Drive(Gear::Reverse) => direction.angle() + std::f64::consts::PI,
                Leg::Turn(yaw) => yaw,
            };
            let yaw = *yaw;
            if matches!(section.leg, Leg::Drive(_)) && angle_difference(yaw, end).abs() > SAME_HEADING {
                self.turn_to(yaw);
            }
        }
        self.set_knots();
        self.set_knot_directions();
        Ok(())
    }

    fn clear(&mut self) {
        self.vertices.clear();
        self.headings.clear();
        self.arc_lengths.clear();
        self.directions.clear();
        self.sections.clear();
        (self.section, self.segment, self.progress, self.clearance) = (0, 0, 0.0, None);
    }

    fn push_vertex(&mut self, position: Vector2<f64>, yaw: f64, arc_length: f64) {
        self.vertices.push(position);
        self.headings.push([yaw, yaw]);
        self.arc_lengths.push(arc_length);
    }

    fn drive_to(&mut self, position: Vector2<f64>, yaw: f64, gear: Gear) {
        let last = self.vertices.len() - 1;
        let along = position - self.vertices[last];
        self.push_vertex(position, yaw, self.arc_lengths[last] + along.norm());
        self.directions.push(So2::from_direction(along.x, along.y));
        let leg = Leg::Drive(gear);
        match self.sections.last_mut() {
            Some(section) if section.leg == leg => section.last = last + 1,
            _ => self.sections.push(Section { first: last, last: last + 1, leg }),
        }
    }

    fn turn_to(&mut self, yaw: f64) {
        let last = self.vertices.len() - 1;
        self.headings[last][1] = yaw;
        match self.sections.last_mut() {
            // Of several turns in one place only the last matters.
            Some(Section { leg: Leg::Turn(to), .. }) => *to = yaw,
            _ => self.sections.push(Section { first: last, last, leg: Leg::Turn(yaw) }),
        }
    }

    /// Whether there is no course yet.
    pub const fn is_empty(&self) -> bool {
        self.sections.is_empty()
    }

    /// Length of the whole course, in metres.
    pub fn length(&self) -> f64 {
        self.arc_lengths.last().copied().unwrap_or(0.0)
    }

    /// Arc length at which the vehicle must stop next: the end, a cusp or a turn on the spot; in metres.
    pub fn section_end(&self) -> f64 {
        self.sections.get(self.section).map_or(0.0, |s| self.arc_lengths[s.last])
    }

    /// What the present section asks for.
    pub fn leg(&self) -> Leg {
        self.sections.get(self.section).map_or(Leg::Drive(Gear::Forward), |s| s.leg)
    }

    /// Whether the present section is the last.
    pub const fn is_last_section(&self) -> bool {
        self.section + 1 >= self.sections.len()
    }

    /// Goes on with the next section and says whether there is one.
    pub fn next_section(&mut self) -> bool {
        let more = !self.is_last_section();
        if more {
            self.section += 1;
            self.clearance = None;
            let first = self.sections[self.section].first;
            self.segment = first;
            self.progress = self.arc_lengths[first];
        }
        more
    }

    /// The point of the present section at an arc length, and the direction of travel there; beyond the section's ends
    /// its first and last segments go on straight.
    #[inline]
    pub fn point_at(&self, arc_length: f64) -> Option<(Vector2<f64>, So2)> {
        self.point_in(self.section, arc_length)
    }

    #[inline]
    fn point_in(&self, section: usize, arc_length: f64) -> Option<(Vector2<f64>, So2)> {
        let section = self.sections.get(section)?;
        if let Leg::Turn(yaw) = section.leg {
            return Some((self.vertices[section.first], So2::from_angle(yaw)));
        }
        let segment = self.segment_at(arc_length).clamp(section.first, section.last - 1);
        let direction = self.directions[segment];
        let ahead = arc_length - self.arc_lengths[segment];
        Some((self.vertices[segment] + Vector2::new(direction.cos(), direction.sin()) * ahead, direction))
    }

    /// Heading that the path states for the base at an arc length of the present section, in radians: turning evenly from each
    /// point's to the next. For vehicles that may face anywhere while they drive.
    pub fn yaw_at(&self, arc_length: f64) -> Option<f64> {
        let section = self.sections.get(self.section)?;
        if let Leg::Turn(yaw) = section.leg {
            return Some(yaw);
        }
        let segment = self.segment_at(arc_length).clamp(section.first, section.last - 1);
        let ([_, from], [to, _]) = (self.headings[segment], self.headings[segment + 1]);
        let (begin, end) = (self.arc_lengths[segment], self.arc_lengths[segment + 1]);
        let share = ((arc_length - begin) / (end - begin)).clamp(0.0, 1.0);
        Some(from + share * angle_difference(to, from))
    }

    /// Direction of travel at an arc length with corners rounded off: that of the chord over the bend window.
    pub fn direction_at(&self, arc_length: f64) -> Option<So2> {
        self.direction_in(self.section, arc_length)
    }

    fn direction_in(&self, section: usize, arc_length: f64) -> Option<So2> {
        let window = self.bend_window();
        let (behind, _) = self.point_in(section, arc_length - 0.5 * window)?;
        let (ahead, direction) = self.point_in(section, arc_length + 0.5 * window)?;
        let chord = ahead - behind;
        // A hairpin narrower than the window has no chord to speak of.
        Some(if chord.norm() > 0.1 * window { So2::from_direction(chord.x, chord.y) } else { direction })
    }

    /// Angle of a heading relative to [`direction_at`](Self::direction_at), in radians; read between two knots, so cheaper.
    #[inline]
    pub fn angle_from(&self, arc_length: f64, heading: So2) -> Option<f64> {
        let direction = if let Some(direction) = self.knot_direction(arc_length) {
            direction
        } else {
            let direction = self.direction_at(arc_length)?;
            Vector2::new(direction.cos(), direction.sin())
        };
        let (cos, sin) = (heading.cos(), heading.sin());
        Some(small_angle::angle(direction.x * cos + direction.y * sin, direction.x * sin - direction.y * cos))
    }

    /// The segment of the whole course that holds an arc length, the first or last for one beyond. O(1) for points that are
    /// spread evenly.
    #[inline]
    fn segment_at(&self, arc_length: f64) -> usize {
        let mut segment = self.knots.segment_before(arc_length);
        // A segment has an end vertex.
        while segment + 1 < self.directions.len() && self.arc_lengths[segment + 1] <= arc_length {
            segment += 1;
        }
        segment
    }
}

#[cfg(test)]
mod tests;
