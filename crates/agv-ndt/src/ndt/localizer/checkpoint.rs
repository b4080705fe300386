//! A localizer as it is stored: parameters, map and belief. What is computed from them is computed again.

use super::{NdtLocalizer, NdtLocalizerParams, NdtMap, State};
use crate::Error;
use crate::checks::finite_pose;
use agv_core::{
    geometry::Se3,
    roles::{Alignment, StatusMonitor},
};

#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct RawLocalizer {
    params: NdtLocalizerParams,
    map: NdtMap,
    places: Vec<Se3>,
    state: Option<State>,
    monitor: StatusMonitor,
    alignment: Option<Alignment<Se3>>,
}

impl TryFrom<RawLocalizer> for NdtLocalizer {
    type Error = Error;

    fn try_from(raw: RawLocalizer) -> Result<Self, Error> {
        let mut localizer = Self::new(&raw.map, raw.params)?;
        for place in &raw.places {
            finite_pose("place", place)?;
        }
        // None, too, come back as they were, whatever floors the map has shown since.
        localizer.places = raw.places;
        if let Some(state) = &raw.state {
            for (before, after) in state.track.iter().zip(state.track.iter().skip(1)) {
                if after.0 <= before.0 {
                    let (earlier_ns, later_ns) = (before.0.nanoseconds(), after.0.nanoseconds());
                    return Err(agv_core::Error::TimeBackwards { earlier_ns, later_ns }.into());
                }
            }
            for (_, pose) in &state.track {
                finite_pose("pose of the track", pose)?;
            }
        }
        (localizer.state, localizer.monitor, localizer.alignment) = (raw.state, raw.monitor, raw.alignment);
        Ok(localizer)
    }
}

impl From<NdtLocalizer> for RawLocalizer {
    fn from(localizer: NdtLocalizer) -> Self {
        Self {
            map: localizer.map().clone(),
            params: localizer.params,
            places: localizer.places,
            state: localizer.state,
            monitor: localizer.monitor,
            alignment: localizer.alignment,
        }
    }
}
