//! What earlier scans saw through.
//!
//! A point was free if every beam that passed it within a guard, on both sides, went on for more than a margin beyond it.
//! Where something stands still, the beam towards any point of its surface ends at that surface, or before it at another:
//! it is never seen through, from wherever the scanner looks.

use agv_core::{
    geometry::{LieGroup, Se2},
    sensors::{Beam, LaserScan},
    time::Stamp,
};
use nalgebra::Vector2;
use std::{collections::VecDeque, f64::consts::TAU};

/// A scan, taken at once, and from where it was taken.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct View {
    pub(super) stamp: Stamp,
    sensor_from_map: Se2,
    scan: LaserScan,
}

impl View {
    pub(super) fn new(stamp: Stamp, map_from_base: &Se2, scan: &LaserScan) -> Self {
        let sensor_from_map = map_from_base.compose(&scan.geometry().base_from_sensor).inverse();
        Self { stamp, sensor_from_map, scan: scan.clone() }
    }

    /// Becomes another view in this one's memory.
    pub(super) fn retake(&mut self, stamp: Stamp, map_from_base: &Se2, scan: &LaserScan) {
        self.stamp = stamp;
        self.sensor_from_map = map_from_base.compose(&scan.geometry().base_from_sensor).inverse();
        self.scan.copy_masked(scan, |_| true);
    }

    /// Whether the scan looked through a point of the map, and around it by a guard of as much as the margin.
    pub(super) fn sees_through(&self, point: &Vector2<f64>, margin: f64) -> bool {
        let local = self.sensor_from_map.act(point);
        let distance = local.norm();
        let geometry = self.scan.geometry();
        let margin = margin + 0.01 * distance;
        let step = geometry.angle_increment.abs();
        // Below this the point lies on the scanner.
        if distance <= margin || !distance.is_finite() {
            return false;
        }
        let turn = (local.y.atan2(local.x) - geometry.angle_min) * geometry.angle_increment.signum();
        let beam = turn.rem_euclid(TAU) / step;
        let guard = 0.5 * margin / distance / step;
        let (first, last) = ((beam - guard).floor(), (beam + guard).ceil());
        if first < 0.0 || last >= self.scan.len() as f64 {
            return false;
        }
        let (first, last) = (first as usize, last as usize);
        let mut silent = 0;
        for &range in self.scan.ranges().get(first..=last).unwrap_or_default() {
            match self.scan.interpret(range) {
                Beam::Hit(range) if range > distance + margin => {}
                Beam::NoReturn if geometry.range_max > distance + 3.0 * margin => {}
                Beam::Invalid => silent += 1,
                _ => return false,
            }
        }
        2 * silent < last + 1 - first
    }
}

/// Views of the last while, oldest first.
#[derive(Debug, Clone, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub(super) struct Views {
    views: VecDeque<View>,
}

impl Views {
    /// Views that are kept for a memory, about.
    const KEPT: f64 = 8.0;

    /// Remembers a view, unless one of the same sensor is as good as new; forgets what is older than `memory` seconds.
    pub(super) fn remember(&mut self, now: Stamp, map_from_base: &Se2, scan: &LaserScan, memory: f64) {
        let spacing = 0.99 * memory / Self::KEPT;
        let fresh = |view: &&View| now - view.stamp < spacing;
        if self.views.iter().rev().take_while(fresh).any(|view| view.scan.sensor() == scan.sensor()) {
            return;
        }
        match self.views.front() {
            Some(oldest) if now - oldest.stamp > memory => {
                if let Some(mut view) = self.views.pop_front() {
                    view.retake(now, map_from_base, scan);
                    self.views.push_back(view);
                }
                // Those that were skipped while no scan came.
                while self.views.front().is_some_and(|view| now - view.stamp > 2.0 * memory) {
                    self.views.pop_front();
                }
            }
            _ => self.views.push_back(View::new(now, map_from_base, scan)),
        }
    }

    /// Whether a scan from `least` seconds ago or before, but no more than `most`, looked through a point.
    pub(super) fn saw_through(&self, now: Stamp, (least, most): (f64, f64), point: &Vector2<f64>, margin: f64) -> bool {
        let aged = |view: &&View| (least..=most).contains(&(now - view.stamp));
        self.views.iter().filter(aged).any(|view| view.sees_through(point, margin))
    }

    /// Accepts stored views of scans up to `now`.
    #[cfg(feature = "serde")]
    pub(super) fn check(&self, now: Stamp) -> Result<(), agv_core::Error> {
        self.views.iter().try_for_each(|view| super::track::not_after(view.stamp, now))
    }

    pub(super) fn clear(&mut self) {
        self.views.clear();
    }
}
