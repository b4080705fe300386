//! A map as it is stored, before it is checked.

use super::{
    KeyFrame, KeyFrameMap, KeyFrameParams,
    closures::Closure,
    map::{Place, Tracked},
};
use crate::Error;
use agv_core::{check, geometry::Se3, time::Stamp};
use agv_filters::graph::PoseGraph;
use agv_ndt::places::ScanContext;

#[derive(serde::Deserialize)]
pub(super) struct RawMap {
    params: KeyFrameParams,
    keys: Vec<KeyFrame>,
    graph: PoseGraph<Se3>,
    trajectory: Vec<Place>,
    tracked: Option<Tracked>,
    followed: u32,
    way: f64,
    doubt: f64,
    pending: Vec<Closure>,
}

impl TryFrom<RawMap> for KeyFrameMap {
    type Error = Error;

    fn try_from(raw: RawMap) -> Result<Self, Error> {
        let mut map = Self::new(raw.params)?;
        let count = raw.keys.len();
        check::length("poses of the graph", raw.graph.poses().len(), count)?;
        let is_there = |name: &'static str, key: u32| {
            check::in_range(name, f64::from(key), 0.0, count.max(1) as f64 - 1.0).map(|_| ())
        };
        is_there("key frame that is followed", raw.followed)?;
        raw.trajectory.iter().try_for_each(|place| is_there("key frame of a cloud", place.key))?;
        raw.trajectory.windows(2).try_for_each(|pair| in_order(pair[0].stamp, pair[1].stamp))?;
        for Closure { from, to, from_from_to, information, inlier_ratio, unobserved } in &raw.pending {
            is_there("key frame of a find", *to)?;
            check::in_range("older key frame of a find", f64::from(*from), 0.0, f64::from(*to) - 1.0)?;
            check::in_range("inlier_ratio", *inlier_ratio, 0.0, 1.0)?;
            check::all_finite("pose of a find", from_from_to.translation().iter())?;
            check::covariance("information", information)?;
            check::all_finite("unobserved", unobserved.iter())?;
        }
        if count > 0 && raw.tracked.is_none() {
            return Err(agv_core::Error::Empty { name: "tracked" }.into());
        }
        if let Some(Tracked { stamp, since, kept_from_base, .. }) = raw.tracked {
            in_order(since, stamp)?;
            raw.trajectory.last().map_or(Ok(()), |place| in_order(place.stamp, stamp))?;
            if kept_from_base.is_none() && count > 0 {
                let last = count as f64 - 1.0;
                check::in_range("key frame that is followed", f64::from(raw.followed), last, last)?;
            }
        }
        check::non_negative("way", raw.way)?;
        check::non_negative("doubt", raw.doubt)?;
        let mut context = ScanContext::default();
        for key in &raw.keys {
            check::in_range("way of a key frame", key.way, 0.0, raw.way)?;
            check::at_least("points of a key frame", key.cloud.len(), 1)?;
            map.places.describe_into(&key.cloud, &mut context);
            map.places.push(&context);
        }
        Ok(Self {
            keys: raw.keys,
            graph: raw.graph,
            trajectory: raw.trajectory,
            tracked: raw.tracked,
            followed: raw.followed,
            way: raw.way,
            doubt: raw.doubt,
            pending: raw.pending,
            ..map
        })
    }
}

fn in_order(earlier: Stamp, later: Stamp) -> Result<(), Error> {
    if earlier <= later {
        return Ok(());
    }
    let (earlier_ns, later_ns) = (earlier.nanoseconds(), later.nanoseconds());
    Err(agv_core::Error::TimeBackwards { earlier_ns, later_ns }.into())
}
