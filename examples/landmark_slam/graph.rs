//! The same log by the graph behind the filter.

use super::{
    Result,
    replay::{Counts, Found, Run},
    settings::Settings,
};
use agv_nav::{
    core::geometry::UncertainPose,
    filters::slam::landmark::{LandmarkGraphSlam, LandmarkGraphSlamParams},
    prelude::*,
};
use agv_support::{landmark_log::LandmarkLog, progress::Progress, timing::Timings};

/// Runs through a log, and corrects the whole of it at the end; the covariances of the poses are the filter's.
pub(crate) fn run(log: &LandmarkLog, settings: &Settings) -> Result<(Run, usize)> {
    let params = LandmarkGraphSlamParams { front: settings.params, ..LandmarkGraphSlamParams::default() };
    let mut slam = LandmarkGraphSlam::new(params)?;
    let (mut places, mut known, mut names, mut timings) = (Vec::new(), Vec::new(), Vec::new(), Timings::default());
    let mut counts = Counts::default();
    let mut before = log.steps.first().map(|step| step.stamp).unwrap_or_default();
    let progress = Progress::new(log.steps.len(), "mapping");
    for step in progress.over(&log.steps) {
        let seen: Vec<_> = step.seen.iter().map(|seen| settings.sighting(seen)).collect::<Result<_>>()?;
        slam.predict(&settings.motion(before, step))?;
        before = step.stamp;
        if !seen.is_empty() {
            let update = timings.time(|| slam.update(&seen))?;
            counts.add(seen.len(), &update);
            // Ties are in the order of the sightings that found a landmark.
            names.extend(
                step.seen.iter().zip(slam.taken()).filter(|(_, taken)| taken.is_some()).map(|(seen, _)| seen.id),
            );
        }
        places.push((step.stamp, slam.place()));
        known.push(slam.front().estimate()?);
    }
    let merged = timings.time(|| slam.finish())?;
    let poses = slam.graph().poses();
    let at = |(stamp, (key, key_from_base)): (Stamp, (Option<_>, Se2))| {
        let key: Option<agv_nav::filters::graph::PoseId> = key;
        (stamp, key.map(|key| poses[key.index()]).unwrap_or_default().compose(&key_from_base))
    };
    let way: Vec<_> = places.into_iter().map(at).collect();
    let known: Vec<UncertainPose<Se2>> = known;
    let taken = slam.graph().ties().iter().zip(names).map(|(tie, name)| (tie.landmark.index() as u32, name)).collect();
    let believed: Vec<_> = slam.landmarks().map(|(landmark, _)| landmark).collect();
    let found = believed.into_iter().map(|landmark| Found {
        key: landmark.index() as u32,
        place: slam.graph().landmarks()[landmark.index()],
        covariance: slam.landmark_covariance(landmark).unwrap_or_default(),
        confirmed: true,
    });
    let landmarks = found.collect();
    let range_scale = slam.front().range_scale();
    Ok((Run { way, known, landmarks, taken, counts, timings, range_scale }, merged))
}
