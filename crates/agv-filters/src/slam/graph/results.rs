//! What graph SLAM knows: where the vehicle is and was, and the map.

use super::{GraphSlam, GraphSlamParams, closures::Seeker, key_scan::KeyScan, slam::Derived};
use crate::{graph::PoseGraph, matching::room_of};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
    grid::{EvidenceGrid, GridLayout},
    time::Stamp,
};

impl GraphSlam {
    /// Pose of the vehicle in the map, as of the last scan.
    pub fn map_from_base(&self) -> Se2 {
        let anchor = self.graph.poses().get(self.anchor as usize).copied().unwrap_or_default();
        anchor.compose(&self.anchor_from_base)
    }

    /// Poses of all scans that were taken in, as they are known now, with their stamps; in the order of the scans.
    pub fn trajectory(&self) -> impl ExactSizeIterator<Item = (Stamp, Se2)> + '_ {
        let poses = self.graph.poses();
        self.way.iter().map(move |place| {
            let key = poses.get(place.key as usize).copied().unwrap_or_default();
            (place.stamp, key.compose(&place.key_from_base))
        })
    }

    /// The map: all key scans from their corrected poses. O(cells that their beams cross).
    ///
    /// # Errors
    /// [`Error::TooMany`] for a map that is larger than a grid may be.
    pub fn map(&self) -> Result<EvidenceGrid, Error> {
        let half = 32.0 * self.params.resolution;
        let layout = GridLayout::new(64, 64, self.params.resolution, Se2::new(-half, -half, 0.0))?;
        let mut map = EvidenceGrid::new(layout, self.params.inverse_model)?;
        for (key, pose) in self.keys.iter().zip(self.graph.poses()) {
            map.insert_scan(&key.scan, pose)?;
        }
        Ok(map)
    }

    /// Its parameters; those of the matcher are [widened](crate::matching::CorrelativeParams::widened_for) for the noise of the first scan.
    pub const fn params(&self) -> &GraphSlamParams {
        &self.params
    }

    /// Poses of the key scans and what relates them.
    pub const fn graph(&self) -> &PoseGraph<Se2> {
        &self.graph
    }

    /// Number of key scans.
    pub fn keys(&self) -> usize {
        self.keys.len()
    }

    /// Bytes of what was kept: key scans, graph and trajectory. Grows with the way in new space and with its length, some 3 kB a key
    /// scan of 180 beams. What follows from it and is made anew is [`working_memory`](Self::working_memory).
    pub fn memory(&self) -> usize {
        let keys: usize = self
            .keys
            .iter()
            .map(|key| size_of::<KeyScan>() + size_of_val(key.points.as_slice()) + size_of_val(key.scan.ranges()))
            .sum();
        let graph = size_of_val(self.graph.poses()) + size_of_val(self.graph.relations());
        keys + graph + size_of_val(self.way.as_slice()) + size_of_val(self.pending.as_slice())
    }

    /// Bytes of what is worked with beside that: the targets of the front end and of closures, which hold the grids of what a few scans
    /// see. Bounded by the parameters, however long the way. Without the memory of the graph's solver, and without the
    /// [`map`](Self::map), which the caller owns.
    pub fn working_memory(&self) -> usize {
        let Derived { front, seekers, points, target, squares, .. } = &self.derived;
        let seekers: usize = seekers.iter().map(Seeker::memory).sum();
        front.memory() + seekers + room_of(points) + room_of(target) + room_of(squares)
    }
}
