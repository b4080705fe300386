//! What an event does to the state.

use super::{
    FusionOutcome, FusionParams, Reference,
    correct::{apply, weigh},
    history::{Event, Happening},
    linearize::{linearize, overlaps, remembered},
    measurement::Reading,
    process::predict,
    source::Source,
    state::State,
};
use agv_core::geometry::Se2;
use nalgebra::Matrix3;

/// Goes on to an event, and takes it in.
pub(super) fn happen(state: &mut State, event: &mut Event, params: &FusionParams, sources: &[Source]) {
    let dt = event.stamp - state.stamp;
    predict(state, params, dt);
    state.stamp = event.stamp;
    let nothing = Matrix3::zeros();
    match &event.happening {
        Happening::Begin => {}
        Happening::Anchor(slot) => state.drop_anchor(usize::from(*slot), Se2::default(), &nothing),
        Happening::Measured(reading) => {
            let index = usize::from(event.source);
            let Some(source) = sources.get(index) else { return };
            let outcome = take(state, reading, source, index);
            event.outcome = Some(outcome);
            let Some(slot) = source.slot.map(usize::from) else { return };
            let reference = source.params.reference;
            let is_motion = matches!(reading, Reading::Motion { .. });
            let moves_on = is_motion || reference == Reference::Previous || state.anchors[slot].is_none();
            if moves_on
                && outcome != FusionOutcome::Overlapping
                && let Some((own, spread)) = remembered(reading, reference, source.params.components)
            {
                state.drop_anchor(slot, own, &spread);
            }
        }
    }
}

/// Corrects the state by a reading, unless it is beyond the gate.
fn take(state: &mut State, reading: &Reading, source: &Source, index: usize) -> FusionOutcome {
    if let (Reading::Motion { start, .. }, Some(slot)) = (reading, source.slot)
        && overlaps(state, usize::from(slot), *start)
    {
        return FusionOutcome::Overlapping;
    }
    let Some(innovation) = linearize(state, reading, source) else { return FusionOutcome::Anchored };
    let degrees = innovation.rows();
    let Some(weighed) = weigh(state, &innovation) else { return FusionOutcome::Degenerate };
    let (nis, limit) = (weighed.nis, source.gate.limit(degrees));
    let patience = source.params.gate_patience;
    let tally = &mut state.tallies[index];
    if nis > limit && !(patience > 0 && tally.gated_in_a_row >= patience) {
        tally.gated += 1;
        tally.gated_in_a_row = tally.gated_in_a_row.saturating_add(1);
        return FusionOutcome::Gated { nis, limit };
    }
    tally.accepted += 1;
    tally.gated_in_a_row = 0;
    tally.nis_sum += nis;
    tally.degrees_of_freedom += degrees as u64;
    apply(state, &weighed);
    FusionOutcome::Applied { nis, degrees }
}
