//! SLAM as it is stored, before it is checked.

use super::{
    GraphSlam, GraphSlamParams,
    closures::Closure,
    key_scan::KeyScan,
    params::Driven,
    slam::{Derived, Place},
};
use crate::graph::PoseGraph;
use agv_core::{Error, check, geometry::Se2, sensors::LaserScan};
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeSet;

/// A key scan without what follows from it.
#[derive(Serialize, Deserialize)]
struct StoredKey<S> {
    scan: S,
    path: f64,
    drive: u32,
}

pub(super) fn store_keys<S: Serializer>(keys: &[KeyScan], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(keys.iter().map(|KeyScan { scan, path, drive, .. }| StoredKey {
        scan,
        path: *path,
        drive: *drive,
    }))
}

#[derive(Deserialize)]
pub(super) struct RawGraphSlam {
    params: GraphSlamParams,
    keys: Vec<StoredKey<LaserScan>>,
    graph: PoseGraph<Se2>,
    way: Vec<Place>,
    anchor: u32,
    anchor_from_base: Se2,
    path: f64,
    tied: f64,
    drive: u32,
    frozen: bool,
    last_odometry: Option<Se2>,
    last_motion: Se2,
    since_key: Option<Driven>,
    pending: Vec<Closure>,
    closed: BTreeSet<(u32, u32)>,
}

impl TryFrom<RawGraphSlam> for GraphSlam {
    type Error = Error;

    fn try_from(raw: RawGraphSlam) -> Result<Self, Error> {
        raw.params.validate()?;
        let count = raw.keys.len();
        check::length("poses of the graph", raw.graph.poses().len(), count)?;
        let is_there = |name: &'static str, key: u32| {
            check::in_range(name, f64::from(key), 0.0, count.max(1) as f64 - 1.0).map(|_| ())
        };
        raw.way.iter().try_for_each(|place| is_there("key scan of the way", place.key))?;
        for closure in &raw.pending {
            is_there("key scan of a closure", closure.from.max(closure.to))?;
            check::covariance("information", &closure.information)?;
        }
        is_there("anchor", raw.anchor)?;
        let Driven { path, turn, .. } = raw.since_key.unwrap_or_default();
        check::all_finite("way", [raw.path, raw.tied, path, turn].iter().chain(raw.keys.iter().map(|key| &key.path)))?;
        let derived = Derived::new(&raw.params)?;
        let key = |key: StoredKey<LaserScan>| KeyScan::new(key.scan, key.path, key.drive, &raw.params);
        let mut slam = Self {
            params: raw.params,
            keys: raw.keys.into_iter().map(key).collect(),
            graph: raw.graph,
            way: raw.way,
            anchor: raw.anchor,
            anchor_from_base: raw.anchor_from_base,
            path: raw.path,
            tied: raw.tied,
            drive: raw.drive,
            frozen: raw.frozen,
            last_odometry: raw.last_odometry,
            last_motion: raw.last_motion,
            since_key: raw.since_key,
            pending: raw.pending,
            closed: raw.closed,
            derived,
        };
        slam.aim()?;
        Ok(slam)
    }
}
