//! The state of a running filter, to store and to resume from.

use super::{Amcl, doubts::SensorDoubt};
use crate::particle::{Hypothesis, MclCheckpoint, Recovery, ResumableProposal, SearchState};
use agv_core::Error;

/// All of an [`Amcl`] that changes as it runs; models, map and policies are the caller's, as for an [`MclCheckpoint`].
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AmclCheckpoint {
    mcl: MclCheckpoint,
    fresh_doubt: Recovery,
    doubts: Vec<SensorDoubt>,
    hypotheses: Vec<Hypothesis>,
    search: Option<SearchState>,
}

impl<M, S, G: ResumableProposal, R, P, U> Amcl<M, S, G, R, P, U> {
    /// The state of the filter.
    pub fn checkpoint(&self) -> AmclCheckpoint {
        let (fresh_doubt, doubts) = self.adaptation.doubts.entries();
        AmclCheckpoint {
            mcl: self.mcl.checkpoint(),
            fresh_doubt,
            doubts: doubts.to_vec(),
            hypotheses: self.adaptation.hypotheses.clone(),
            search: self.adaptation.proposal.state(),
        }
    }

    /// Puts the filter into a stored state.
    ///
    /// # Errors
    /// As [`Mcl::restore`](crate::particle::Mcl::restore); the filter is then as it was.
    pub fn restore(&mut self, checkpoint: &AmclCheckpoint) -> Result<(), Error> {
        self.mcl.restore(&checkpoint.mcl)?;
        self.adaptation.doubts.restore(checkpoint.fresh_doubt, &checkpoint.doubts);
        self.adaptation.hypotheses.clear();
        self.adaptation.hypotheses.extend_from_slice(&checkpoint.hypotheses);
        self.adaptation.proposal.resume(checkpoint.search.as_ref());
        Ok(())
    }
}
