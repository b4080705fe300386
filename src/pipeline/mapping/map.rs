//! Key frames, what ties them together, and the maps that they make.

use super::{
    KeyFrameParams,
    closures::{Closure, is_find},
};
use crate::Error;
use agv_core::{
    geometry::{LieGroup, Se3, UncertainPose},
    sensors::PointCloud,
    time::Stamp,
};
use agv_filters::graph::{PoseGraph, Relation};
use agv_ndt::{
    ndt::{NdtTiles, VoxelParams},
    places::ScanContexts,
};
use std::collections::BTreeSet;

/// A cloud that is kept, and is a pose of the graph.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct KeyFrame {
    /// What the lidar saw, as if at once at its stamp: in the base frame, thinned.
    pub(super) cloud: PointCloud,
    /// Way until here, in metres.
    pub(super) way: f64,
}

impl KeyFrame {
    /// What the lidar saw, as if at once at its stamp, in the base frame; thinned.
    pub const fn cloud(&self) -> &PointCloud {
        &self.cloud
    }

    /// Way that odometry had gone until here, in metres.
    pub const fn way(&self) -> f64 {
        self.way
    }
}

/// The place of a cloud, relative to a key frame so that it follows when that is corrected.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Place {
    pub(super) stamp: Stamp,
    pub(super) key: u32,
    pub(super) key_from_base: Se3,
}

/// Where odometry was last.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Tracked {
    pub(super) stamp: Stamp,
    pub(super) odom_from_base: Se3,
    /// Motion since the key frame that is followed; of the whole way before the first.
    pub(super) key_from_base: UncertainPose<Se3>,
    /// Motion since the last key frame that was kept, where another one was met since then; none where that one is
    /// followed.
    pub(super) kept_from_base: Option<UncertainPose<Se3>>,
    /// Stamp of the cloud that was a key frame, or was found at one, last.
    pub(super) since: Stamp,
}

/// All that a [`KeyFrameMapper`](super::KeyFrameMapper) knows: a value that is stored and resumed from (feature
/// `serde`), to the same bits.
///
/// The frame of the map is that of the odometry at the first key frame, which never moves.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::checkpoint::RawMap")
)]
pub struct KeyFrameMap {
    pub(super) params: KeyFrameParams,
    pub(super) keys: Vec<KeyFrame>,
    pub(super) graph: PoseGraph<Se3>,
    pub(super) trajectory: Vec<Place>,
    pub(super) tracked: Option<Tracked>,
    /// Key frame that the motion is told from: the last one, or one that was met again since.
    pub(super) followed: u32,
    /// Way so far, in metres.
    pub(super) way: f64,
    /// How far off the last key frame may be since the last closure, in metres.
    pub(super) doubt: f64,
    /// Finds that wait for others.
    pub(super) pending: Vec<Closure>,
    /// How key frames look; this follows from their clouds.
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    pub(super) places: ScanContexts,
}

impl KeyFrameMap {
    /// A map without key frames.
    ///
    /// # Errors
    /// As [`KeyFrameParams::validate`].
    pub fn new(params: KeyFrameParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            keys: Vec::new(),
            graph: PoseGraph::new(),
            trajectory: Vec::new(),
            tracked: None,
            followed: 0,
            way: 0.0,
            doubt: 0.0,
            pending: Vec::new(),
            places: ScanContexts::new(params.places)?,
            params,
        })
    }

    /// The parameters.
    pub const fn params(&self) -> &KeyFrameParams {
        &self.params
    }

    /// The key frames with their corrected poses, `map_from_base`, in the order in which they were met first.
    pub fn key_frames(&self) -> impl ExactSizeIterator<Item = (&KeyFrame, &Se3)> + '_ {
        self.keys.iter().zip(self.graph.poses())
    }

    /// The key frames that closures relate, the older first; of those that turned out to contradict the rest, none.
    pub fn closures(&self) -> impl ExactSizeIterator<Item = (usize, usize)> + '_ {
        let closed = self.graph.relations().iter().filter(|relation| is_find(relation));
        let pairs: BTreeSet<_> = closed.map(|relation| (relation.from.index(), relation.to.index())).collect();
        pairs.into_iter()
    }

    /// What ties the key frames together.
    pub fn relations(&self) -> &[Relation<Se3>] {
        self.graph.relations()
    }

    /// Poses of all clouds as they are known now, `map_from_base`.
    pub fn trajectory(&self) -> impl ExactSizeIterator<Item = (Stamp, Se3)> + '_ {
        self.trajectory.iter().map(|place| {
            let key = self.graph.poses().get(place.key as usize);
            (place.stamp, key.map_or(place.key_from_base, |key| key.compose(&place.key_from_base)))
        })
    }

    /// Where the vehicle is; the frame of the map before the first cloud.
    pub fn map_from_base(&self) -> Se3 {
        let here = self.tracked.map_or_else(Se3::identity, |tracked| *tracked.key_from_base.mean());
        self.graph.poses().get(self.followed as usize).map_or(here, |key| key.compose(&here))
    }

    /// What to correct the odometry by.
    pub fn map_from_odom(&self) -> Se3 {
        let odom_from_base = self.tracked.map_or_else(Se3::identity, |tracked| tracked.odom_from_base);
        self.map_from_base().compose(&odom_from_base.inverse())
    }

    /// The map of normal distributions of all key frames at their corrected poses, in tiles of `tile_voxels` voxels:
    /// linear in the points.
    ///
    /// # Errors
    /// As [`NdtTiles::new`].
    pub fn tiles(&self, voxels: VoxelParams, tile_voxels: usize) -> Result<NdtTiles, Error> {
        let mut tiles = NdtTiles::new(voxels, tile_voxels)?;
        for (key, pose) in self.key_frames() {
            tiles.insert(&key.cloud, pose);
        }
        Ok(tiles)
    }

    /// All clouds at their corrected poses as one, with the mean of each cube of `leaf` metres, in the frame of the
    /// map.
    ///
    /// # Errors
    /// A leaf that is not from 1 cm to 1 km.
    pub fn thinned_cloud(&self, leaf: f64) -> Result<PointCloud, Error> {
        let voxels = VoxelParams { resolution: leaf, min_sigma: 1e-3, ..VoxelParams::default() };
        let mut cloud = PointCloud::default();
        self.tiles(voxels, 256)?.means_into(&mut cloud);
        Ok(cloud)
    }
}
