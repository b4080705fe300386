//! What the filter knows: poses, trajectories, maps, and what they cost.

use super::{
    filter::Rbpf,
    insert::Scratch,
    map::{TileMap, layout_of, rect_of},
    scan_odometry::ScanOdometry,
};
use agv_core::{
    Error,
    geometry::{LieGroup, Se2, UncertainPose},
    grid::{CellState, Grid, OccupancyThresholds},
    time::Stamp,
};
use std::collections::HashSet;

impl<M> Rbpf<M> {
    /// Number of the best particle: that of the greatest likelihood of its whole trajectory.
    pub fn best(&self) -> usize {
        let scores = self.belief.scores.iter().enumerate();
        scores.reduce(|best, next| if next.1 > best.1 { next } else { best }).map_or(0, |(index, _)| index)
    }

    /// The base in the map now, by the best particle and what the odometry said since the last scan that was taken in.
    pub fn map_from_base(&self) -> Se2 {
        let pose = self.belief.particles.states().get(self.best()).copied().unwrap_or_default();
        pose * self.belief.since()
    }

    /// Mean and covariance of the particles after the last scan that was taken in, in the frame of the map.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where squares of coordinates are not.
    pub fn estimate(&self) -> Result<UncertainPose<Se2>, Error> {
        self.belief.particles.estimate(self.par)
    }

    /// Normalised weights of the particles.
    pub fn weights(&self) -> &[f64] {
        self.belief.particles.weights()
    }

    /// The trajectory of the best particle: the base in the map at every scan that came since the first that was taken in.
    ///
    /// A scan that was not taken in lies on the odometry's way between those that were, and that way is bent evenly to end where
    /// the particle is. O(scans).
    pub fn trajectory(&self) -> Vec<(Stamp, Se2)> {
        self.trajectory_of(self.best())
    }

    /// The trajectory of a particle; empty if there is none of that number.
    pub fn trajectory_of(&self, particle: usize) -> Vec<(Stamp, Se2)> {
        let (belief, path) = (&self.belief, self.belief.tree.path(particle));
        let length = |motion: &Se2| motion.translation().norm() + motion.yaw().abs();
        let place = |step: usize, since: &Se2| {
            let here = path.get(step)?;
            let Some((next, whole)) = path.get(step + 1).zip(belief.steps.get(step + 1)) else {
                return Some(*here * *since);
            };
            let share = if length(whole) > 0.0 { (length(since) / length(whole)).min(1.0) } else { 0.0 };
            let bend = (*here * *whole).between(next).log();
            Some((*here * *since).plus(&(bend * share)))
        };
        belief.seen.iter().filter_map(|seen| Some((seen.stamp, place(seen.step as usize, &seen.since)?))).collect()
    }

    /// The map of the best particle.
    pub fn best_map(&self) -> &TileMap {
        // There is at least one particle.
        &self.belief.maps[self.best()]
    }

    /// The maps of all particles, in the order of [`weights`](Self::weights).
    pub fn maps(&self) -> &[TileMap] {
        &self.belief.maps
    }

    /// The map that all particles agree on: the mean of the probabilities that their maps state, by weight; one half where a map
    /// knows nothing. O(particles × cells).
    ///
    /// # Errors
    /// As [`TileMap::layout`].
    pub fn fused_map(&self, thresholds: &OccupancyThresholds) -> Result<Grid<CellState>, Error> {
        let tiles = self.belief.maps.iter().flat_map(|map| map.tiles().map(|(tile, _)| tile));
        let rect = rect_of(tiles).ok_or(Error::Empty { name: "map" })?;
        let layout = layout_of(&rect, self.params.resolution)?;
        let mut sums = Grid::filled(layout, (0.0_f32, false));
        for (map, &weight) in self.belief.maps.iter().zip(self.weights()) {
            map.for_each_cell(&layout, |cell, log_odds| {
                if let Some((sum, _)) = sums.get(cell) {
                    let probability = 1.0 / (1.0 + (-log_odds).exp());
                    sums.set(cell, (sum + (weight * (probability - 0.5)) as f32, true));
                }
            });
        }
        let state =
            |&(sum, seen): &(f32, bool)| if seen { thresholds.state(f64::from(sum) + 0.5) } else { CellState::Unknown };
        Grid::new(layout, sums.values().iter().map(state).collect())
    }

    /// Bytes of all maps and trajectories; what is shared counts once. What updates are worked out with is
    /// [`working_memory`](Self::working_memory).
    pub fn memory(&self) -> usize {
        let (mut known, mut bytes) = (HashSet::new(), self.belief.tree.bytes());
        for map in &self.belief.maps {
            map.for_each_part(|address, size| {
                let is_new = known.insert(address);
                bytes += if is_new { size } else { 0 };
                is_new
            });
        }
        bytes
            + self.belief.seen.capacity() * size_of::<super::filter::Seen>()
            + self.belief.steps.capacity() * size_of::<Se2>()
    }

    /// Bytes of what is worked with beside the maps: the few scans and the target of
    /// [scan odometry](super::RbpfParams::scan_odometry), and what particles see of their maps. Bounded by the parameters, however large the
    /// maps.
    pub fn working_memory(&self) -> usize {
        let matching = self.scan_odometry.as_ref().map_or(0, ScanOdometry::memory);
        matching + self.scratch.iter().map(Scratch::memory).sum::<usize>()
    }
}
