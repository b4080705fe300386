//! Graph SLAM as it is stored: loading checks that filter and graph belong together.
//!
//! The solver is not stored: it is memory, and an order of elimination that follows from the graph alone. The filter is stored with its own
//! parameters, which count.

use super::{GraphLandmark, LandmarkGraph, LandmarkGraphSlam, LandmarkGraphSlamParams, LandmarkSlam};
use agv_core::{Error, check, odometry::OdometryIncrement};
use std::collections::BTreeMap;

#[derive(serde::Deserialize)]
pub(super) struct RawLandmarkGraphSlam {
    params: LandmarkGraphSlamParams,
    front: LandmarkSlam,
    graph: LandmarkGraph,
    of_key: BTreeMap<u32, GraphLandmark>,
    motion: Option<OdometryIncrement>,
    since: usize,
}

impl TryFrom<RawLandmarkGraphSlam> for LandmarkGraphSlam {
    type Error = Error;

    fn try_from(raw: RawLandmarkGraphSlam) -> Result<Self, Error> {
        let RawLandmarkGraphSlam { params, front, graph, of_key, motion, since } = raw;
        let fresh = Self::new(LandmarkGraphSlamParams { front: *front.params(), ..params })?;
        let (poses, landmarks) = (graph.poses().len(), graph.landmarks().len());
        for (key, landmark) in &of_key {
            check::in_range("key of a landmark", f64::from(*key), 0.0, f64::from(front.next) - 1.0)?;
            check::in_range("landmark of a key", landmark.index() as f64, 0.0, landmarks as f64 - 1.0)?;
        }
        // Each pose but the first is tied to the one before, and sightings come in the order of their poses.
        let relations = graph.poses.relations();
        check::length("motions of the graph", relations.len(), poses.saturating_sub(1))?;
        for (from, relation) in (0..).zip(relations) {
            check::in_range("start of a motion", f64::from(relation.from.0), f64::from(from), f64::from(from))?;
            check::in_range("end of a motion", f64::from(relation.to.0), f64::from(from + 1), f64::from(from + 1))?;
        }
        for pair in graph.ties().windows(2) {
            let (pose, before) = (f64::from(pair[1].pose.0), f64::from(pair[0].pose.0));
            check::in_range("pose of a sighting", pose, before, poses as f64)?;
        }
        check::in_range("poses since the last correction", since as f64, 0.0, poses as f64)?;
        if let Some(motion) = motion.as_ref() {
            fresh.information_of(motion)?;
        }
        Ok(Self { front, graph, of_key, motion, since, ..fresh })
    }
}
