//! A path by arc length, with a progress that moves along it.

use agv_core::{
    geometry::wrap_angle,
    path::{Gear, Path},
    roles::TrackError,
};
use nalgebra::Vector2;

/// The vehicle's place on the course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the nearest point, in metres from the beginning of the course.
    pub arc_length: f64,
    /// Distance of the vehicle from the nearest point, in metres; positive to the left of the direction of travel.
    pub cross_track: f64,
    /// Direction of travel there, in radians, in the map frame.
    pub direction: f64,
}

/// One stretch that is driven in one gear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Section {
    /// First and last vertex.
    first: usize,
    last: usize,
    gear: Gear,
}

/// How a path bends.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Bend {
    /// Turn per metre, in 1/m, unsigned.
    pub(super) curvature: f64,
    /// Change of the turn per metre, per metre, in 1/m², unsigned.
    pub(super) change: f64,
}

/// A path without repeated points, by arc length, cut at its cusps.
///
/// The progress is searched forward from where it was, so that following a whole path costs one pass over it, and a
/// path that crosses itself is followed in order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Course {
    vertices: Vec<Vector2<f64>>,
    /// Arc length at each vertex, in metres.
    arc_lengths: Vec<f64>,
    /// Turning of the path before each vertex, in radians; one entry more than there are vertices.
    turned: Vec<f64>,
    /// How the path bends at each vertex.
    bends: Vec<Bend>,
    sections: Vec<Section>,
    /// Section that is being driven, and the segment in it that the vehicle is nearest to.
    section: usize,
    segment: usize,
    /// Arc length of the vehicle's last projection, in metres.
    progress: f64,
}

/// Length over which a corner of the polyline is read as a bend, in metres: about what a vehicle cuts off.
pub const BEND_WINDOW: f64 = 0.5;

impl Course {
    /// Takes a path; repeated points are dropped. The memory is reused.
    ///
    /// # Errors
    /// [`TrackError::NoPath`] if there are not two distinct points; the old course is then kept.
    pub fn set(&mut self, path: &Path) -> Result<(), TrackError> {
        let points = path.points();
        let first = points.first().ok_or(TrackError::NoPath)?.pose.translation();
        if points.iter().all(|p| p.pose.translation() == first) {
            return Err(TrackError::NoPath);
        }
        self.vertices.clear();
        self.arc_lengths.clear();
        self.sections.clear();
        (self.section, self.segment, self.progress) = (0, 0, 0.0);
        for point in points {
            let position = point.pose.translation();
            let step = self.vertices.last().map(|last| (position - last).norm());
            if step == Some(0.0) {
                continue;
            }
            let arc_length = self.length() + step.unwrap_or(0.0);
            let index = self.vertices.len();
            self.vertices.push(position);
            self.arc_lengths.push(arc_length);
            if index == 0 {
                continue;
            }
            match self.sections.last_mut() {
                Some(section) if section.gear == point.gear => section.last = index,
                _ => self.sections.push(Section { first: index - 1, last: index, gear: point.gear }),
            }
        }
        self.set_bends();
        Ok(())
    }

    /// Whether there is no course yet.
    pub fn is_empty(&self) -> bool {
        self.sections.is_empty()
    }

    /// Length of the whole course, in metres.
    pub fn length(&self) -> f64 {
        self.arc_lengths.last().copied().unwrap_or(0.0)
    }

    /// Arc length at which the vehicle must stop next: the end, or a cusp; in metres.
    pub fn section_end(&self) -> f64 {
        self.sections.get(self.section).map_or(0.0, |s| self.arc_lengths[s.last])
    }

    /// How the present section is driven.
    pub fn gear(&self) -> Gear {
        self.sections.get(self.section).map_or(Gear::Forward, |s| s.gear)
    }

    /// Goes on with the next section and says whether there is one.
    pub fn next_section(&mut self) -> bool {
        let more = self.section + 1 < self.sections.len();
        if more {
            self.section += 1;
            self.segment = self.sections[self.section].first;
            self.progress = self.arc_lengths[self.segment];
        }
        more
    }

    /// Moves the progress to the nearest point of the present section, not searching farther ahead than `reach`
    /// metres nor behind the segment that was nearest before; none if there is no course.
    pub fn advance(&mut self, position: &Vector2<f64>, reach: f64) -> Option<Projection> {
        let section = *self.sections.get(self.section)?;
        let begin = self.segment.max(section.first);
        let limit = self.progress + reach;
        let mut best: Option<(f64, usize, f64)> = None;
        for segment in begin..section.last {
            if segment > begin && self.arc_lengths[segment] > limit {
                break;
            }
            let (from, to) = (self.vertices[segment], self.vertices[segment + 1]);
            let along = to - from;
            let fraction = ((position - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            let distance = (position - (from + along * fraction)).norm_squared();
            if best.is_none_or(|(least, _, _)| distance < least) {
                best = Some((distance, segment, fraction));
            }
        }
        let (_, segment, fraction) = best?;
        self.segment = segment;
        let along = self.vertices[segment + 1] - self.vertices[segment];
        let length = along.norm();
        self.progress = self.arc_lengths[segment] + fraction * length;
        let offset = position - self.vertices[segment];
        let side = along.x * offset.y - along.y * offset.x;
        Some(Projection {
            arc_length: self.progress,
            // The distance to the nearest point, so that beyond a corner or the end nothing is understated.
            cross_track: (offset - along * fraction).norm().copysign(side),
            direction: along.y.atan2(along.x),
        })
    }

    /// The point of the present section at an arc length, and the direction of travel there; beyond the section's ends
    /// its first and last segments go on straight.
    pub fn point_at(&self, arc_length: f64) -> Option<(Vector2<f64>, f64)> {
        let section = self.sections.get(self.section)?;
        let inner = &self.arc_lengths[section.first + 1..section.last];
        let segment = section.first + inner.partition_point(|&at| at <= arc_length);
        let along = self.vertices[segment + 1] - self.vertices[segment];
        let fraction = (arc_length - self.arc_lengths[segment]) / along.norm();
        Some((self.vertices[segment] + along * fraction, along.y.atan2(along.x)))
    }

    /// Direction of travel at an arc length with corners rounded off: that of the chord over [`BEND_WINDOW`], in radians.
    pub fn direction_at(&self, arc_length: f64) -> Option<f64> {
        let (behind, _) = self.point_at(arc_length - 0.5 * BEND_WINDOW)?;
        let (ahead, direction) = self.point_at(arc_length + 0.5 * BEND_WINDOW)?;
        let chord = ahead - behind;
        // A hairpin narrower than the window has no chord to speak of.
        Some(if chord.norm() > 0.1 * BEND_WINDOW { chord.y.atan2(chord.x) } else { direction })
    }

    /// Turn per metre at an arc length with corners rounded off over [`BEND_WINDOW`], in 1/m, positive to the left.
    pub fn curvature_at(&self, arc_length: f64) -> f64 {
        let vertices_before = |s: f64| self.arc_lengths.partition_point(|&at| at < s);
        let (from, to) = (arc_length - 0.5 * BEND_WINDOW, arc_length + 0.5 * BEND_WINDOW);
        (self.turned[vertices_before(to)] - self.turned[vertices_before(from)]) / BEND_WINDOW
    }

    /// The bends of the present section that the vehicle is in or has before it, in order: distance to where each
    /// begins (zero inside it), in metres, and the bend.
    pub(super) fn bends_ahead(&self) -> impl Iterator<Item = (f64, Bend)> + '_ {
        let section = self.sections.get(self.section);
        let range = section.map_or(0..0, |s| self.segment.max(s.first)..s.last + 1);
        range.filter_map(|i| {
            let to_vertex = self.arc_lengths[i] - self.progress;
            let ahead = (to_vertex - 0.5 * BEND_WINDOW).max(0.0);
            (to_vertex >= -0.5 * BEND_WINDOW).then_some((ahead, self.bends[i]))
        })
    }

    /// Reads the corners of the polyline as bends: turning within half a window of each vertex, per metre, and how far
    /// that differs from the windows before and behind.
    fn set_bends(&mut self) {
        self.turned.clear();
        self.turned.extend([0.0, 0.0]);
        let mut sum = 0.0;
        for w in self.vertices.windows(3) {
            sum += turn(w[0], w[1], w[2]);
            self.turned.push(sum);
        }
        self.turned.push(sum);
        let mut bends = std::mem::take(&mut self.bends);
        bends.clear();
        bends.extend(self.arc_lengths.iter().map(|&s| {
            let (before, here, after) =
                (self.curvature_at(s - BEND_WINDOW), self.curvature_at(s), self.curvature_at(s + BEND_WINDOW));
            let change = f64::max((here - before).abs(), (here - after).abs()) / (0.5 * BEND_WINDOW);
            Bend { curvature: here.abs(), change }
        }));
        self.bends = bends;
    }
}

/// Signed turn at `b` on the way from `a` to `c`, in radians.
fn turn(a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>) -> f64 {
    let (u, v) = (b - a, c - b);
    wrap_angle(v.y.atan2(v.x) - u.y.atan2(u.x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{geometry::Se2, path::PathPoint};
    use proptest::prelude::*;

    fn course(points: &[(f64, f64)]) -> Course {
        let positions: Vec<_> = points.iter().map(|&(x, y)| Vector2::new(x, y)).collect();
        let mut course = Course::default();
        course.set(&Path::from_positions(&positions).unwrap()).unwrap();
        course
    }

    #[test]
    fn a_path_that_crosses_itself_is_followed_in_order() {
        // A loop whose end crosses its beginning: at the crossing the progress must not jump.
        let mut course = course(&[(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, -2.0)]);
        let at_crossing = course.advance(&Vector2::new(2.0, 0.01), 1.0).unwrap();
        assert!((at_crossing.arc_length - 2.0).abs() < 1e-12);
        assert!((at_crossing.cross_track - 0.01).abs() < 1e-12);
    }

    #[test]
    fn long_segments_are_left_at_their_end() {
        let mut course = course(&[(0.0, 0.0), (9.0, 0.0), (9.0, 9.0)]);
        for x in [0.0, 4.0, 8.5] {
            course.advance(&Vector2::new(x, 0.0), 5.0);
        }
        let turned = course.advance(&Vector2::new(9.0, 0.5), 1.5).unwrap();
        assert!((turned.arc_length - 9.5).abs() < 1e-12 && turned.cross_track.abs() < 1e-12);
    }

    #[test]
    fn cusps_cut_the_course() {
        let mut path = Path::new();
        for (x, gear) in [(0.0, Gear::Forward), (1.0, Gear::Forward), (0.5, Gear::Reverse)] {
            path.push(PathPoint { pose: Se2::new(x, 0.0, 0.0), gear }).unwrap();
        }
        let mut course = Course::default();
        course.set(&path).unwrap();
        assert_eq!((course.gear(), course.section_end()), (Gear::Forward, 1.0));
        assert!(course.next_section());
        assert_eq!((course.gear(), course.section_end()), (Gear::Reverse, 1.5));
        let back = course.advance(&Vector2::new(0.75, 0.1), 1.0).unwrap();
        // Travelling towards -x, a point at +y lies to the right.
        assert!((back.arc_length - 1.25).abs() < 1e-12 && (back.cross_track + 0.1).abs() < 1e-12);
        assert!(!course.next_section());
    }

    #[test]
    fn a_refused_path_leaves_the_course() {
        let mut c = course(&[(0.0, 0.0), (1.0, 0.0)]);
        let before = c.clone();
        assert_eq!(c.set(&Path::from_positions(&[Vector2::x(); 4]).unwrap()), Err(TrackError::NoPath));
        assert_eq!(c, before);
    }

    #[test]
    fn a_corner_bends_over_the_window() {
        let course = course(&[(0.0, 0.0), (3.0, 0.0), (3.0, 3.0)]);
        let (ahead, bend) = course.bends_ahead().nth(1).unwrap();
        let curvature = std::f64::consts::FRAC_PI_2 / BEND_WINDOW;
        assert!((ahead - (3.0 - 0.5 * BEND_WINDOW)).abs() < 1e-12);
        assert!((bend.curvature - curvature).abs() < 1e-12);
        assert!((bend.change - curvature / (0.5 * BEND_WINDOW)).abs() < 1e-12);
    }

    proptest! {
        /// On a circle of many chords the curvature is that of the circle.
        #[test]
        fn curvature_of_a_circle(radius in 0.5..5.0_f64) {
            let positions: Vec<_> = (0..2000).map(|i| {
                let angle = f64::from(i) * 0.0025;
                Vector2::new(radius * angle.cos(), radius * angle.sin())
            }).collect();
            let mut course = Course::default();
            course.set(&Path::from_positions(&positions).unwrap()).unwrap();
            let (_, middle) = course.bends_ahead().nth(1000).unwrap();
            prop_assert!((middle.curvature * radius - 1.0).abs() < 0.05 && middle.change * radius < 0.2);
        }

        /// The error is the distance to the nearest point of the section, also beyond corners and ends.
        #[test]
        fn cross_track_is_the_distance(x in -2.0..8.0_f64, y in -3.0..6.0_f64) {
            let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (7.0, 3.0)];
            let mut course = course(&corners);
            let position = Vector2::new(x, y);
            let projection = course.advance(&position, 100.0).unwrap();
            // Brute force: ten thousand points along the corners.
            let nearest = corners.windows(2).flat_map(|w| (0..=5000).map(move |i| {
                let f = f64::from(i) / 5000.0;
                Vector2::new(w[0].0 + f * (w[1].0 - w[0].0), w[0].1 + f * (w[1].1 - w[0].1))
            })).map(|p| (p - position).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!((projection.cross_track.abs() - nearest).abs() < 1e-3);
        }

        /// Walking along the path, the projection moves with the walker.
        #[test]
        fn progress_follows_the_walker(offset in -0.2..0.2_f64) {
            let mut course = course(&[(0.0, 0.0), (5.0, 0.0), (5.0, 5.0)]);
            for i in 0..80 {
                let s = f64::from(i) * 0.05;
                let projection = course.advance(&Vector2::new(s, offset), 2.0).unwrap();
                prop_assert!((projection.arc_length - s).abs() < 1e-9 && (projection.cross_track - offset).abs() < 1e-9);
            }
        }
    }
}
