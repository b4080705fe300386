//! What the filter is asked for: estimates of any time, motions, and how its sources fare.

use super::{
    FusedState, FusionFilter, SourceDiagnostics, SourceId,
    history::{Event, Happening, History},
    process::predict,
    state::{DISTANCE_SCALE, GYRO_BIAS, LATENCY, POSE, State, VELOCITY, YAW_SCALE, anchor_at},
};
use agv_core::{Error, geometry::UncertainPose, odometry::OdometryIncrement, roles::LocalizationStatus, time::Stamp};

/// Source of the anchors of [`FusionFilter::take_motion`].
const NOBODY: u8 = u8::MAX;

impl FusionFilter {
    /// What is believed at the time of the newest measurement; none before [`initialize`](Self::initialize).
    pub fn state(&self) -> Option<FusedState> {
        fused(self.history.as_ref()?.newest()?)
    }

    /// What is believed at any time that the history reaches back to, or later: without measurements, the velocity goes on, and
    /// fades. Before the first measurement of a belief without a time, what is believed is so at any time.
    pub fn state_at(&self, stamp: Stamp) -> Option<FusedState> {
        let history = self.history.as_ref()?;
        if !self.timed {
            return fused(history.newest()?).map(|state| FusedState { stamp, ..state });
        }
        let mut state = *history.at(stamp)?;
        let dt = stamp - state.stamp;
        predict(&mut state, &self.params, dt);
        fused(&state)
    }

    /// The motion since the last call, up to the newest measurement, with its own covariance: for a particle filter that is to
    /// move by the fused estimate instead of the wheels alone. None before there is a belief, at the first
    /// call after it was given or a clock was set back, and where no time has passed.
    ///
    /// Both ends are parts of the state, so that the covariance is that of the motion and not of the poses. Feed a filter that
    /// hands out motions with nothing that comes from the particle filter itself.
    ///
    /// # Errors
    /// [`Error::TooMany`] beyond [`MAX_RELATIVE`](Self::MAX_RELATIVE) sources; a covariance that rounding has spoilt.
    pub fn take_motion(&mut self) -> Result<Option<OdometryIncrement>, Error> {
        let slot = match self.outlet {
            Some(slot) => slot,
            None => self.free_slot()?,
        };
        self.outlet = Some(slot);
        let Some(state) = self.history.as_ref().and_then(History::newest) else { return Ok(None) };
        let at = anchor_at(usize::from(slot));
        let mut motion = None;
        if let Some(anchor) = &state.anchors[usize::from(slot)] {
            if anchor.stamp >= state.stamp {
                return Ok(None);
            }
            let start = UncertainPose::new(anchor.map_from_base, state.block(at, at))?;
            let end = state.pose()?;
            let moved = start.between_correlated(&end, &state.block(at, POSE))?;
            motion = Some(OdometryIncrement {
                start: anchor.stamp,
                end: state.stamp,
                start_from_end: *moved.mean(),
                covariance: *moved.covariance(),
            });
        }
        let here = state.stamp;
        self.insert(&Event::new(here, NOBODY, Happening::Anchor(slot)), here);
        Ok(motion)
    }

    /// How far the pose can be trusted: places and poses in the map confirm it; without them it stays unconfirmed.
    pub const fn status(&self) -> LocalizationStatus {
        self.monitor.status()
    }

    /// How a source fares; none if there is no such source.
    pub fn diagnostics(&self, source: SourceId) -> Option<SourceDiagnostics> {
        let traffic = self.traffic.get(source.index())?;
        let tally = self.history.as_ref()?.newest()?.tallies.get(source.index())?;
        let any = tally.accepted > 0;
        Some(SourceDiagnostics {
            accepted: tally.accepted,
            gated: tally.gated,
            gated_in_a_row: tally.gated_in_a_row,
            dropped: traffic.dropped,
            nis_mean: any.then(|| tally.nis_sum / tally.accepted as f64),
            consistency: any.then(|| tally.nis_sum / tally.degrees_of_freedom as f64),
            last: traffic.last,
        })
    }

    /// The sources without a measurement for longer than their time-out, at a time; those that never had one among them.
    pub fn silent(&self, now: Stamp) -> impl Iterator<Item = SourceId> + '_ {
        let entries = self.sources.iter().zip(&self.traffic).zip(0..);
        entries.filter_map(move |((source, traffic), id)| {
            traffic.last.is_none_or(|last| now - last > source.params.timeout).then_some(SourceId(id))
        })
    }
}

/// What users see of a state; none if its covariance were none, which Joseph's form keeps from happening.
fn fused(state: &State) -> Option<FusedState> {
    let sigma = |at: usize| state.covariance[at][at].max(0.0).sqrt();
    Some(FusedState {
        stamp: state.stamp,
        pose: state.pose().ok()?,
        twist: state.twist,
        twist_covariance: state.block(VELOCITY, VELOCITY),
        acceleration: state.acceleration,
        gyro_bias: (state.gyro_bias, sigma(GYRO_BIAS)),
        distance_scale: (state.distance_scale, sigma(DISTANCE_SCALE)),
        yaw_scale: (state.yaw_scale, sigma(YAW_SCALE)),
        latency: (state.latency, sigma(LATENCY)),
    })
}
