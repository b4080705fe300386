//! What the weights of a set say of its health.

/// The weights after an observation, in a few numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WeightSummary {
    /// `N_eff = 1 / Σ w²`, between 1 and the number of particles (paper 000, Eq. 7).
    pub effective_sample_size: f64,
    /// `-Σ w ln w`, between 0 and the logarithm of the number of particles (paper 001).
    pub entropy: f64,
    /// Greatest normalised weight.
    pub max_weight: f64,
    /// Logarithm of the mean likelihood of the last observation over the belief; low where nothing explains it.
    pub log_evidence: f64,
}

impl WeightSummary {
    /// The summary of `count` equal weights.
    pub fn uniform(count: usize) -> Self {
        let count = count.max(1) as f64;
        Self { effective_sample_size: count, entropy: count.ln(), max_weight: count.recip(), log_evidence: 0.0 }
    }
}
