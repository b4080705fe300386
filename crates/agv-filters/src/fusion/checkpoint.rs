//! A filter as it is stored, before it is checked.

use super::{
    FusionFilter, FusionParams, RoleInput, SourceId,
    filter::Traffic,
    history::History,
    source::{MAX_SOURCES, Source},
    state::MAX_ANCHORS,
};
use agv_core::{Error, check, roles::StatusMonitor};

#[derive(serde::Deserialize)]
pub(super) struct RawFilter {
    params: FusionParams,
    sources: Vec<Source>,
    traffic: Vec<Traffic>,
    history: Option<History>,
    timed: bool,
    strange: u32,
    outlet: Option<u8>,
    inputs: Vec<(RoleInput, SourceId)>,
    monitor: StatusMonitor,
}

impl TryFrom<RawFilter> for FusionFilter {
    type Error = Error;

    fn try_from(raw: RawFilter) -> Result<Self, Error> {
        let RawFilter { params, sources, traffic, mut history, timed, strange, outlet, inputs, monitor } = raw;
        let fresh = Self::new(params)?;
        check::in_range("sources", sources.len() as f64, 0.0, MAX_SOURCES as f64)?;
        check::length("traffic", traffic.len(), sources.len())?;
        sources.iter().try_for_each(|source| source.params.validate(&params))?;
        // There is one latency to be estimated.
        let late = sources.iter().filter(|source| source.params.late).count();
        if late > 1 {
            return Err(Error::TooMany { name: "sources of unknown latency", len: late, max: 1 });
        }
        let mut is_taken = [false; MAX_ANCHORS];
        for slot in sources.iter().filter_map(|source| source.slot).chain(outlet) {
            check::in_range("slot", f64::from(slot), 0.0, MAX_ANCHORS as f64 - 1.0)?;
            // Two that share an anchor would measure from each other's poses.
            if std::mem::replace(&mut is_taken[usize::from(slot)], true) {
                return Err(Error::TooMany { name: "owners of a slot", len: 2, max: 1 });
            }
        }
        for source in &sources {
            check::length("slots of a source", usize::from(source.slot.is_some()), usize::from(source.refers()))?;
        }
        if inputs.iter().any(|(_, source)| source.index() >= sources.len()) {
            return Err(Error::Empty { name: "source that is connected" });
        }
        if let Some(history) = &mut history {
            history.validate()?;
            history.reserve(params.capacity);
        }
        Ok(Self { sources, traffic, history, timed, strange, outlet, inputs, monitor, ..fresh })
    }
}
