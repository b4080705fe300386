//! One scan of a tracker: outlines are found, given to tracks, and looked at for motion.

use super::{GIVE_UP, ObstacleTracker};
use crate::tracking::{
    Cluster, Outline, ScanClusters, TrackerParams,
    track::Track,
    views::{View, Views},
};
use agv_core::{
    geometry::{LieGroup, Se2},
    obstacle::ObstacleId,
    sensors::LaserScan,
    time::Stamp,
};
use nalgebra::Vector2;

impl ObstacleTracker {
    /// Finds the outlines in the scan.
    pub(super) fn see(&mut self, map_from_base: &Se2) {
        let (explained, tolerance) = (&self.explained, self.params.map_tolerance as f32);
        self.clusters.segment(&self.scan, map_from_base, |_, point| {
            !explained.as_ref().is_some_and(|field| {
                field.layout().cell_at(point).and_then(|cell| field.get(cell)).is_some_and(|&d| d <= tolerance)
            })
        });
        let sensor = sensor_at(map_from_base, &self.scan);
        self.outlines.clear();
        for (index, cluster) in self.clusters.clusters().iter().enumerate() {
            let points = self.clusters.points_of(cluster);
            if extent(points) <= self.params.max_extent
                && let Some(outline) = Outline::of(points, &sensor, cluster.hidden, self.params.surface_sigma, None)
            {
                self.outlines.push((index, outline));
            }
        }
    }

    /// Gives outlines to tracks, and begins and ends tracks.
    pub(super) fn associate(&mut self, map_from_base: &Se2, now: Stamp, dt: f64) {
        let Self { params, tracks, outlines, pairs, clusters, taken, .. } = self;
        pairs.clear();
        for (row, track) in tracks.iter().enumerate() {
            let distances = outlines.iter().map(|(_, outline)| track.distance(outline)).enumerate();
            let gate = self.gate;
            pairs.extend(distances.filter(|(_, d)| *d < gate).map(|(column, d)| (row, column, d)));
        }
        self.assignment.solve(tracks.len(), outlines.len(), self.gate, pairs.iter().copied());
        taken.clear();
        taken.resize(outlines.len(), false);
        self.moving_beams.clear();
        self.moving_beams.resize(self.scan.len(), false);
        let sensor = sensor_at(map_from_base, &self.scan);
        for (track, &column) in tracks.iter_mut().zip(self.assignment.column_of()) {
            let Some(&(cluster, outline)) = column.and_then(|column| outlines.get(column)) else {
                let gone = self.present.sees_through(&track.position(), params.free_margin);
                track.absent = if gone { track.absent + dt } else { track.absent };
                continue;
            };
            if let Some(slot) = column.and_then(|column| taken.get_mut(column)) {
                *slot = true;
            }
            let Some(cluster) = clusters.clusters().get(cluster) else { continue };
            let points = clusters.points_of(cluster);
            // Again, by what the track knows of the size.
            let known = outline.hull.is_none().then_some(track.radius);
            let better = known
                .and_then(|radius| Outline::of(points, &sensor, cluster.hidden, params.surface_sigma, Some(radius)));
            if !track.update(&better.unwrap_or(outline), points, now, params) {
                track.absent = f64::INFINITY;
                continue;
            }
            let evidence = track.has_speed(params.min_speed, self.speed_limit)
                && moves(track, points, now, &self.views, &self.present, params);
            track.judge(evidence, params.confirm_hits);
            if track.moving {
                mark(&mut self.moving_beams, clusters, cluster);
            }
        }
        tracks.retain(|track| track.absent <= GIVE_UP);
        for ((cluster, outline), taken) in outlines.iter().zip(taken) {
            let Some(cluster) = clusters.clusters().get(*cluster).filter(|_| !*taken) else { continue };
            let points = clusters.points_of(cluster);
            if let Some(track) = Track::new(ObstacleId(self.next_id), outline, points, now, params) {
                self.next_id = self.next_id.saturating_add(1);
                tracks.push(track);
            }
        }
    }
}

/// Whether a thing is where earlier scans saw through, or has left where it was.
fn moves(
    track: &Track,
    points: &[Vector2<f64>],
    now: Stamp,
    views: &Views,
    present: &View,
    params: &TrackerParams,
) -> bool {
    let ages = (params.memory / 4.0, 1.5 * params.memory);
    let stride = points.len().div_ceil(24).max(1);
    let came = || {
        let new = points.iter().step_by(stride).filter(|p| views.saw_through(now, ages, p, params.free_margin));
        new.take(3).count() == 3
    };
    let left = || {
        let gone = track.trace().points().iter().filter(|p| present.sees_through(p, params.free_margin));
        gone.take(2).count() == 2
    };
    came() || left()
}

fn mark(beams: &mut [bool], clusters: &ScanClusters, cluster: &Cluster) {
    for &beam in clusters.beams().get(cluster.points.clone()).unwrap_or_default() {
        if let Some(slot) = beams.get_mut(beam) {
            *slot = true;
        }
    }
}

fn sensor_at(map_from_base: &Se2, scan: &LaserScan) -> Vector2<f64> {
    map_from_base.act(&scan.geometry().base_from_sensor.translation())
}

/// Greatest extent of points along the axes and the diagonals, in metres.
fn extent(points: &[Vector2<f64>]) -> f64 {
    let along = |direction: Vector2<f64>| {
        let (low, high) = points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
            let d = p.dot(&direction);
            (low.min(d), high.max(d))
        });
        high - low
    };
    let half = std::f64::consts::FRAC_1_SQRT_2;
    [Vector2::x(), Vector2::y(), Vector2::new(half, half), Vector2::new(half, -half)]
        .map(along)
        .into_iter()
        .fold(0.0, f64::max)
}
