//! The state of a running filter, to store and to resume from.

use super::{
    beams::FAR,
    filter::{Belief, Rbpf, Seen},
    map::{TileMap, TileRect},
    scan_odometry::ScanOdometry,
    tile::{TILE, Tile},
    trajectory::TrajectoryTree,
};
use crate::particle::{ParticleSet, WeightSummary};
use agv_core::{Error, check, compute::Seed, geometry::Se2, odometry::OdometryIncrement, sensors::LaserScan};
use std::{collections::HashMap, sync::Arc};

/// All of a filter that changes as it runs: particles, maps, trajectories, pending odometry, the last scans.
///
/// Motion model and parameters are not in it: they are the caller's. A filter that is built with the same ones and
/// [`restore`](Rbpf::restore)d continues with the same bits, provided the format keeps every `f64` exactly (`serde_json` does with its
/// feature `float_roundtrip`). Tiles that maps share are stored once.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct RbpfCheckpoint {
    seed: Seed,
    resolution: f64,
    start: Se2,
    particles: ParticleSet,
    scores: Vec<f64>,
    tree: TrajectoryTree,
    pending: Option<OdometryIncrement>,
    weights: WeightSummary,
    scans_without: u32,
    walked: Se2,
    drift: Se2,
    steps: Vec<Se2>,
    seen: Vec<Seen>,
    since_resampling: u64,
    recent: Vec<(Se2, LaserScan)>,
    tiles: Vec<Tile>,
    /// Tiles of each different map, by their numbers.
    sheets: Vec<Vec<((i32, i32), u32)>>,
    /// Which of those each particle has.
    maps: Vec<u32>,
}

impl<M> Rbpf<M> {
    /// The state of the filter. O(tiles of all maps).
    pub fn checkpoint(&self) -> RbpfCheckpoint {
        let Belief {
            start,
            particles,
            maps,
            tree,
            scores,
            pending,
            weights,
            scans_without,
            walked,
            drift,
            steps,
            seen,
            since_resampling,
        } = &self.belief;
        // Numbers go by the order in which tiles are met, so that addresses do not reach the result.
        let (mut tiles, mut sheets) = (Vec::new(), Vec::new());
        let (mut tile_numbers, mut sheet_numbers) = (HashMap::new(), HashMap::new());
        let mut numbered = |map: &TileMap| {
            *sheet_numbers.entry(map.address()).or_insert_with(|| {
                let mut number = |tile: &Arc<Tile>| {
                    *tile_numbers.entry(Arc::as_ptr(tile).addr()).or_insert_with(|| {
                        tiles.push(Tile::clone(tile));
                        tiles.len() as u32 - 1
                    })
                };
                sheets.push(map.tiles().map(|(place, tile)| (place, number(tile))).collect());
                sheets.len() as u32 - 1
            })
        };
        let maps = maps.iter().map(&mut numbered).collect();
        RbpfCheckpoint {
            seed: self.seed,
            resolution: self.params.resolution,
            start: *start,
            particles: particles.clone(),
            scores: scores.clone(),
            tree: tree.clone(),
            pending: *pending,
            weights: *weights,
            scans_without: *scans_without,
            walked: *walked,
            drift: *drift,
            steps: steps.clone(),
            seen: seen.clone(),
            since_resampling: *since_resampling,
            recent: self.scan_odometry.as_ref().map_or_else(Vec::new, ScanOdometry::recent),
            tiles,
            sheets,
            maps,
        }
    }

    /// Puts the filter into a stored state; the seed becomes that of the checkpoint.
    ///
    /// # Errors
    /// Another number of particles or another resolution than the filter's, or parts that do not fit each other; the filter is then
    /// as it was.
    pub fn restore(&mut self, checkpoint: &RbpfCheckpoint) -> Result<(), Error> {
        let stored = checkpoint;
        let count = self.params.particles;
        for (name, len) in
            [("particles", stored.particles.len()), ("scores", stored.scores.len()), ("maps", stored.maps.len())]
        {
            check::length(name, len, count)?;
        }
        let resolution = self.params.resolution;
        check::in_range("resolution", stored.resolution, resolution, resolution)?;
        check::all_finite("scores", &stored.scores)?;
        let last = stored.seen.iter().map(|seen| seen.step as usize + 1).max().unwrap_or(0);
        check::in_range("steps", stored.steps.len() as f64, last as f64, f64::from(u32::MAX))?;
        if !stored.tree.is_sound(count, stored.steps.len()) {
            return Err(Error::LengthMismatch { name: "trajectories", len: 0, expected: stored.steps.len() });
        }
        if let Some(pending) = stored.pending.filter(|pending| !pending.is_finite()) {
            return Err(Error::NotFinite { name: "odometry", value: pending.start_from_end.x() });
        }
        let maps = stored.maps()?;
        self.belief = Belief {
            start: stored.start,
            particles: stored.particles.clone(),
            maps,
            tree: stored.tree.clone(),
            scores: stored.scores.clone(),
            pending: stored.pending,
            weights: stored.weights,
            scans_without: stored.scans_without,
            walked: stored.walked,
            drift: stored.drift,
            steps: stored.steps.clone(),
            seen: stored.seen.clone(),
            since_resampling: stored.since_resampling,
        };
        self.seed = stored.seed;
        if let Some(odometry) = &mut self.scan_odometry {
            odometry.restore(&stored.recent);
        }
        Ok(())
    }
}

impl RbpfCheckpoint {
    /// The maps of all particles, which share what they shared.
    fn maps(&self) -> Result<Vec<TileMap>, Error> {
        let tiles: Vec<Arc<Tile>> = self.tiles.iter().cloned().map(Arc::new).collect();
        let mut sheets = Vec::with_capacity(self.sheets.len());
        for sheet in &self.sheets {
            let mut map = TileMap::new(self.resolution);
            for (place, number) in sheet {
                let tile = tiles.get(*number as usize);
                let tile = tile.ok_or(Error::LengthMismatch {
                    name: "tiles",
                    len: tiles.len(),
                    expected: *number as usize + 1,
                })?;
                for along in [place.0, place.1] {
                    let most = FAR / f64::from(TILE);
                    check::in_range("place of a tile", f64::from(along), -most, most)?;
                }
                map.check_room(&TileRect { low: *place, high: *place })?;
                map.put(*place, Arc::clone(tile));
            }
            sheets.push(map);
        }
        let map = |number: &u32| {
            let missing = Error::LengthMismatch { name: "sheets", len: sheets.len(), expected: *number as usize + 1 };
            sheets.get(*number as usize).cloned().ok_or(missing)
        };
        self.maps.iter().map(map).collect()
    }
}
