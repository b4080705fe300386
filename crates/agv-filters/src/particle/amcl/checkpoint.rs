//! The state of a running filter, to store and to resume from.

use super::{Amcl, doubts::SensorDoubt};
use crate::particle::{Hypothesis, MclCheckpoint};
use agv_core::Error;

/// All of an [`Amcl`] that changes as it runs; models, map and policies are the caller's, as for an [`MclCheckpoint`].
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AmclCheckpoint {
    mcl: MclCheckpoint,
    doubts: Vec<SensorDoubt>,
    hypotheses: Vec<Hypothesis>,
}

impl<M, S, G, R, P, U> Amcl<M, S, G, R, P, U> {
    /// The state of the filter.
    pub fn checkpoint(&self) -> AmclCheckpoint {
        AmclCheckpoint {
            mcl: self.mcl.checkpoint(),
            doubts: self.adaptation.doubts.entries().to_vec(),
            hypotheses: self.adaptation.hypotheses.clone(),
        }
    }

    /// Puts the filter into a stored state.
    ///
    /// # Errors
    /// As [`Mcl::restore`](crate::particle::Mcl::restore); the filter is then as it was.
    pub fn restore(&mut self, checkpoint: &AmclCheckpoint) -> Result<(), Error> {
        self.mcl.restore(&checkpoint.mcl)?;
        self.adaptation.doubts.restore(&checkpoint.doubts);
        self.adaptation.hypotheses.clear();
        self.adaptation.hypotheses.extend_from_slice(&checkpoint.hypotheses);
        Ok(())
    }
}
