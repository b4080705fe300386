//! How a course bends: corners of the polyline read as bends, at evenly spaced knots.
//!
//! A corner of a polyline has no curvature. A vehicle cuts it off over some length, the window; the turning within a window
//! around a point, per metre, is taken for the curvature there. Eight knots span a window, so that reading a value is one
//! look-up, however the points of the path are spread.

use super::{Course, Section};
use crate::geometry::{LieGroup, So2};
use nalgebra::Vector2;

/// Knots in a window.
const PER_WINDOW: usize = 8;

/// Most knots of a course: one of 60 km has them closer than a metre.
const MAX_KNOTS: f64 = (1 << 20) as f64;

/// How a course bends at a place.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bend {
    /// Turn per metre, in 1/m, positive to the left.
    pub curvature: f64,
    /// Change of the turn per metre, per metre, in 1/m², unsigned.
    pub change: f64,
}

/// Bends at evenly spaced arc lengths.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Knots {
    window: f64,
    spacing: f64,
    per_metre: f64,
    /// Turning of the path before each knot, in radians.
    turned: Vec<f64>,
    bends: Vec<Bend>,
    /// Direction of travel at each knot, corners rounded off, and the section that it is that of.
    directions: Vec<(Vector2<f64>, u32)>,
    /// Segment that holds each knot.
    segments: Vec<u32>,
}

impl Knots {
    pub(super) const fn new(window: f64) -> Self {
        Self {
            window,
            spacing: 1.0,
            per_metre: 1.0,
            turned: Vec::new(),
            bends: Vec::new(),
            directions: Vec::new(),
            segments: Vec::new(),
        }
    }

    /// A segment that begins at or before an arc length.
    #[inline]
    pub(super) fn segment_before(&self, arc_length: f64) -> usize {
        // The cast saturates, and takes NaN for zero.
        let knot = ((arc_length * self.per_metre) as usize).min(self.segments.len().saturating_sub(1));
        self.segments.get(knot).map_or(0, |&segment| segment as usize)
    }
}

impl Course {
    /// Length over which a corner is read as a bend, in metres.
    pub const fn bend_window(&self) -> f64 {
        self.knots.window
    }

    /// Turn per metre at an arc length with corners rounded off over the bend window, in 1/m, positive to the left. O(1).
    #[inline]
    pub fn curvature_at(&self, arc_length: f64) -> f64 {
        let place = (arc_length * self.knots.per_metre).max(0.0).min(self.knots.bends.len() as f64);
        let knot = place as usize;
        let at = |i: usize| self.knots.bends.get(i).map_or(0.0, |bend| bend.curvature);
        let share = place - knot as f64;
        at(knot) * (1.0 - share) + at(knot + 1) * share
    }

    /// Distance between two knots, in metres.
    pub const fn knot_spacing(&self) -> f64 {
        self.knots.spacing
    }

    /// The bends at the knots, from the beginning of the course to its end.
    pub fn bends(&self) -> &[Bend] {
        &self.knots.bends
    }

    /// Smoothed direction of travel in the present section, not of unit length, between the two knots around an arc length; none
    /// if these are not both in the section.
    #[inline]
    pub(super) fn knot_direction(&self, arc_length: f64) -> Option<Vector2<f64>> {
        let place = arc_length * self.knots.per_metre;
        // The cast saturates, and takes NaN for zero.
        let knot = place as usize;
        let [(behind, first), (ahead, second)] = *self.knots.directions.get(knot..)?.first_chunk()?;
        let inside = place >= 0.0 && first as usize == self.section && second == first;
        inside.then(|| behind + (ahead - behind) * (place - knot as f64))
    }

    /// Stores the smoothed directions at the knots, each in the section that is driven there.
    pub(super) fn set_knot_directions(&mut self) {
        let mut directions = std::mem::take(&mut self.knots.directions);
        directions.clear();
        let mut section = 0;
        for knot in 0..self.knots.bends.len() {
            let here = knot as f64 * self.knots.spacing;
            while section + 1 < self.sections.len() && self.arc_lengths[self.sections[section].last] < here {
                section += 1;
            }
            let direction = self.direction_in(section, here).unwrap_or_default();
            directions.push((Vector2::new(direction.cos(), direction.sin()), section as u32));
        }
        self.knots.directions = directions;
    }

    /// Reads the corners as bends: turning within half a window of each knot, per metre, and how far that exceeds the windows
    /// before and behind.
    pub(super) fn set_knots(&mut self) {
        let length = self.length();
        let knots = &mut self.knots;
        let spacing = (knots.window / PER_WINDOW as f64).max(length / MAX_KNOTS);
        let count = (length / spacing).ceil() as usize + 1;
        (knots.spacing, knots.per_metre) = (spacing, 1.0 / spacing);
        knots.turned.clear();
        knots.segments.clear();
        let (mut turned, mut segment) = (0.0, 0);
        for knot in 0..count {
            let here = knot as f64 * spacing;
            while segment + 1 < self.directions.len() && self.arc_lengths[segment + 1] <= here {
                segment += 1;
                // Where the vehicle stops, it may turn as it likes.
                if !is_stop(&self.sections, segment) {
                    turned += turn(self.directions[segment - 1], self.directions[segment]);
                }
            }
            knots.turned.push(turned);
            knots.segments.push(segment as u32);
        }
        let last = count - 1;
        let turned = |knot: isize| knots.turned[knot.clamp(0, last as isize) as usize];
        let (whole, half) = (PER_WINDOW as isize, PER_WINDOW as isize / 2);
        let window = PER_WINDOW as f64 * spacing;
        let curvature = |knot: isize| (turned(knot + half) - turned(knot - half)) / window;
        knots.bends.clear();
        knots.bends.extend((0..count as isize).map(|knot| {
            let here = curvature(knot);
            let (before, after) = (curvature(knot - whole), curvature(knot + whole));
            let exceeds = |other: f64| if here.abs() >= other.abs() { (here - other).abs() } else { 0.0 };
            Bend { curvature: here, change: exceeds(before).max(exceeds(after)) / (0.5 * window) }
        }));
    }
}

/// Whether two sections meet at a vertex.
fn is_stop(sections: &[Section], vertex: usize) -> bool {
    let next = sections.partition_point(|section| section.first < vertex);
    sections.get(next).is_some_and(|section| section.first == vertex)
}

/// Signed turn between two directions, in radians.
fn turn(from: So2, to: So2) -> f64 {
    from.inverse().compose(&to).angle()
}
