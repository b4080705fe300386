//! What a cloud changes: brought to the time of the belief, matched, and taken or not.

use super::matching::Match;
use super::{NdtLocalizer, State};
use agv_core::{
    roles::{Correct, LocalizationError, SkipReason, UpdateOutcome, UpdateReport},
    sensors::{Deskew, PointCloud, PoseTrack},
};

impl Correct<PointCloud> for NdtLocalizer {
    /// The observation is compensated for the motion between its stamp and the end of the last motion.
    fn update(&mut self, cloud: &PointCloud) -> Result<UpdateOutcome, LocalizationError> {
        self.is_fresh = false;
        let mut state = self.state.take().ok_or(LocalizationError::NotInitialized)?;
        let outcome = self.correct(&mut state, cloud);
        self.state = Some(state);
        outcome
    }
}

impl NdtLocalizer {
    /// Deskews a cloud to the time of the belief, thins it out and brings it into the base frame; or says why not.
    fn take(&mut self, state: &State, cloud: &PointCloud) -> Result<(), SkipReason> {
        let (at, track) = (state.belief.stamp, &state.track);
        let moving = track.first().zip(at).filter(|_| track.len() > 1);
        if let Some((first, now)) = moving {
            let (age, slack) = (now - cloud.stamp(), self.params.extrapolation);
            if age > (now - first.0) + slack || age < -slack {
                return Err(SkipReason::OutsideHistory { age });
            }
            // A track of increasing times and finite poses is one.
            if let Ok(motion) = PoseTrack::new(track, now) {
                Deskew::cloud_into(cloud, &motion, &mut self.straight);
            }
        } else {
            // At rest, as far as is known; but a track of one pose says so of its own time alone.
            let age = at.filter(|_| !track.is_empty()).map_or(0.0, |now| now - cloud.stamp());
            if age.abs() > self.params.extrapolation {
                return Err(SkipReason::OutsideHistory { age });
            }
            self.straight.copy_from(cloud);
        }
        self.is_fresh = true;
        self.thin.filter_into(&self.straight, &mut self.thinned);
        let mount = self.thinned.base_from_sensor();
        self.thinned.transform(&mount);
        let (usable, needed) = (self.thinned.len(), self.params.min_points);
        if usable < needed { Err(SkipReason::TooFewReadings { usable, needed }) } else { Ok(()) }
    }

    fn correct(&mut self, state: &mut State, cloud: &PointCloud) -> Result<UpdateOutcome, LocalizationError> {
        let observed = (cloud.sensor(), cloud.stamp());
        if state.applied.contains(&observed) {
            return Ok(UpdateOutcome::Skipped(SkipReason::Duplicate));
        }
        if let Err(reason) = self.take(state, cloud) {
            return Ok(UpdateOutcome::Skipped(reason));
        }
        let outcome = match self.match_cloud(state)? {
            Match::Unexplained => UpdateOutcome::Skipped(SkipReason::Unexplained),
            Match::Fused { nis, .. } if nis > self.params.gate => {
                UpdateOutcome::Skipped(SkipReason::Gated { nis, limit: self.params.gate })
            }
            Match::Fused { pose, nis, share } => {
                state.belief.pose = pose;
                let mut report = UpdateReport::explaining(share);
                report.nis = Some(nis);
                UpdateOutcome::Applied(report)
            }
            Match::Found { pose, share } => {
                state.belief.pose = pose;
                state.anywhere = false;
                self.monitor.initialized(&pose);
                UpdateOutcome::Applied(UpdateReport::explaining(share))
            }
        };
        if let UpdateOutcome::Applied(_) = outcome {
            state.applied.retain(|(sensor, _)| *sensor != observed.0);
            state.applied.push(observed);
            state.belief.stamp.get_or_insert(observed.1);
            state.misses = 0;
        } else {
            state.misses = state.misses.saturating_add(1);
        }
        self.monitor.updated(&state.belief.pose, &outcome);
        Ok(outcome)
    }
}
