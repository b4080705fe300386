//! Back to the given path where the smooth one touches something.
//!
//! The vehicle drives each step straight on, looking along it, and turns on the spot where two of them meet, at both ends from
//! and to the given headings. A step whose both ends lie where they were given is written along the given path, corners between
//! the two included, so that it touches what that touches and needs no look.

use super::{super::straight::heading, CurvatureSmoother};
use crate::Error;
use agv_core::{
    geometry::Se2,
    grid::{Footprint, ObstacleMap},
    path::PathPoint,
};
use nalgebra::Vector2;

impl CurvatureSmoother {
    /// Puts points back to where they were given until no step that leaves the given path touches an obstacle; how many.
    pub(super) fn fall_back(
        &mut self,
        obstacles: &ObstacleMap,
        footprint: &Footprint,
        piece: &[PathPoint],
    ) -> Result<usize, Error> {
        let last = self.moved.len() - 1;
        self.keep.clear();
        self.keep.resize(self.moved.len(), false);
        // Each round puts at least one point back.
        let mut reach = 1;
        loop {
            let mut changed = false;
            for index in 0..last {
                if self.is_given(index) || !self.step_collides(obstacles, footprint, piece, index)? {
                    continue;
                }
                for i in index.saturating_sub(reach - 1)..=(index + reach).min(last) {
                    changed |= !self.keep[i];
                    (self.keep[i], self.moved[i]) = (true, self.given[i]);
                }
            }
            if !changed {
                return Ok(self.keep.iter().filter(|&&keep| keep).count());
            }
            reach *= 2;
        }
    }

    /// Leaves the line to be written in `uneven`: the points, and the given path's corners between those that were kept.
    pub(super) fn join_corners(&mut self, piece: &[PathPoint]) {
        let mut line = std::mem::take(&mut self.uneven);
        line.clear();
        for (index, point) in self.moved.iter().enumerate() {
            line.push(*point);
            if self.is_given(index) {
                line.extend(self.corners(piece, index));
            }
        }
        self.uneven = line;
    }

    /// Whether the step from this sample to the next one is one of the given path.
    fn is_given(&self, index: usize) -> bool {
        matches!(self.keep.get(index..index + 2), Some([true, true]))
    }

    /// Points of the given path between a sample and the next one.
    fn corners<'a>(
        &'a self,
        piece: &'a [PathPoint],
        index: usize,
    ) -> impl DoubleEndedIterator<Item = Vector2<f64>> + 'a {
        let line = |sample: usize| self.lines.get(sample).copied().unwrap_or_default();
        let between = piece.get(line(index) + 1..=line(index + 1)).unwrap_or_default();
        let ends = self.given.get(index..index + 2).unwrap_or_default();
        between.iter().map(|point| point.pose.translation()).filter(|corner| !ends.contains(corner))
    }

    /// Whether the vehicle touches anything on the step from a sample to the next one and where it turns into it and out of it.
    fn step_collides(
        &self,
        obstacles: &ObstacleMap,
        footprint: &Footprint,
        piece: &[PathPoint],
        index: usize,
    ) -> Result<bool, Error> {
        let (Some(first), Some(last)) = (piece.first(), piece.last()) else { return Ok(false) };
        let [from, to] = [self.moved[index], self.moved[index + 1]];
        let along = |a, b| heading(a, b, last.gear);
        let Some(ahead) = along(from, to) else { return Ok(false) };
        let before = match index.checked_sub(1) {
            None => Some(first.pose.rotation()),
            Some(i) if self.is_given(i) => along(self.corners(piece, i).next_back().unwrap_or(self.moved[i]), from),
            Some(i) => along(self.moved[i], from),
        };
        let after = match self.moved.get(index + 2) {
            None => Some(last.pose.rotation()),
            Some(next) if self.is_given(index + 1) => along(to, self.corners(piece, index + 1).next().unwrap_or(*next)),
            // Looked at with the next step.
            Some(_) => None,
        };
        let poses = [(from, before.unwrap_or(ahead)), (from, ahead), (to, ahead), (to, after.unwrap_or(ahead))]
            .map(|(position, heading)| Se2::from_parts(position, heading));
        for pair in poses.windows(2) {
            if obstacles.collides_between(footprint, &pair[0], &pair[1])? {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
