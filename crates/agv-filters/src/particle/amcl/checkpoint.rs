//! The state of a running filter, to store and to resume from.

use super::{Amcl, doubts::Doubts};
use crate::particle::{Hypothesis, MclCheckpoint, ResumableProposal, SearchState};
use agv_core::Error;

/// All of an [`Amcl`] that changes as it runs; models, map and policies are the caller's, as for an [`MclCheckpoint`].
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AmclCheckpoint {
    mcl: MclCheckpoint,
    doubts: Doubts,
    hypotheses: Vec<Hypothesis>,
    search: Option<SearchState>,
}

impl<M, S, G: ResumableProposal, R, P, U> Amcl<M, S, G, R, P, U> {
    /// The state of the filter.
    pub fn checkpoint(&self) -> AmclCheckpoint {
        AmclCheckpoint {
            mcl: self.mcl.checkpoint(),
            doubts: self.adaptation.doubts.clone(),
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
        self.adaptation.doubts.assign(&checkpoint.doubts);
        self.adaptation.hypotheses.clear();
        self.adaptation.hypotheses.extend_from_slice(&checkpoint.hypotheses);
        self.adaptation.proposal.resume(checkpoint.search.as_ref());
        Ok(())
    }
}
