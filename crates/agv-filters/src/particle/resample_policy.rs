//! When to draw a new set, as small policies that combine: `EffectiveSampleSizeBelow::default().and(EveryNth(2))`.

use super::{MotionThreshold, WeightSummary};
use agv_core::{Error, check, geometry::Se2};

/// What a [`ResamplePolicy`] decides by, right after an update.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ResampleContext {
    /// The weights: effective sample size, entropy, greatest weight.
    pub weights: WeightSummary,
    /// Number of particles.
    pub count: usize,
    /// Updates since the set was last drawn anew, this one included: at least one.
    pub updates: u64,
    /// How the vehicle has moved since then: the base now, in the base frame of then.
    pub motion: Se2,
    /// How far it has been from there at most, in metres.
    pub distance: f64,
    /// How much it has been turned from then at most, in radians.
    pub angle: f64,
}

impl ResampleContext {
    /// A set of `count` particles, `updates` and `motion` after it was last drawn anew, and never farther from there than now.
    pub fn new(weights: WeightSummary, count: usize, updates: u64, motion: Se2) -> Self {
        let (distance, angle) = (motion.translation().norm(), motion.yaw().abs());
        Self { weights, count, updates, motion, distance, angle }
    }

    /// The same of a vehicle that has been that far from there, in metres, and turned that much, in radians; what is less than its
    /// motion is the motion.
    #[must_use]
    pub const fn having_been(self, distance: f64, angle: f64) -> Self {
        Self { distance: distance.max(self.distance), angle: angle.max(self.angle), ..self }
    }
}

/// Whether a new set is to be drawn after an update.
pub trait ResamplePolicy {
    /// Whether the set is to be resampled.
    fn is_due(&self, context: &ResampleContext) -> bool;

    /// Resample when both policies ask for it.
    fn and<P: ResamplePolicy>(self, other: P) -> And<Self, P>
    where
        Self: Sized,
    {
        And(self, other)
    }

    /// Resample when either policy asks for it.
    fn or<P: ResamplePolicy>(self, other: P) -> Or<Self, P>
    where
        Self: Sized,
    {
        Or(self, other)
    }
}

impl<P: ResamplePolicy + ?Sized> ResamplePolicy for Box<P> {
    fn is_due(&self, context: &ResampleContext) -> bool {
        (**self).is_due(context)
    }
}

/// Resample when the effective sample size falls below a share of the particles (paper 000, Eq. 7): while the weights
/// are even, resampling would only lose diversity.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EffectiveSampleSizeBelow {
    /// Share of the number of particles, in [0, 1]; one resamples unless all weights are equal, zero never.
    pub ratio: f64,
}

impl Default for EffectiveSampleSizeBelow {
    /// One half, the usual choice (Doucet and Johansen, *A tutorial on particle filtering and smoothing*, 2009).
    fn default() -> Self {
        Self { ratio: 0.5 }
    }
}

impl EffectiveSampleSizeBelow {
    /// Checks the ratio.
    ///
    /// # Errors
    /// A ratio outside [0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("resampling ratio", self.ratio, 0.0, 1.0).map(|_| ())
    }
}

impl ResamplePolicy for EffectiveSampleSizeBelow {
    fn is_due(&self, context: &ResampleContext) -> bool {
        context.weights.effective_sample_size < self.ratio * context.count as f64
    }
}

/// Resample when the entropy of the weights, `-Σ w ln w`, falls below a share of the `ln n` of equal weights (paper 001).
///
/// Less moved by a single heavy particle than the effective sample size is. Of one particle nothing can be even or uneven:
/// it is never resampled.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EntropyBelow {
    /// Share of `ln n`, in [0, 1]; one resamples unless all weights are equal, zero never.
    pub ratio: f64,
}

impl Default for EntropyBelow {
    /// 0.9: with 1000 particles the entropy of 500 equal weights, and so the counterpart of an effective sample size of
    /// one half.
    fn default() -> Self {
        Self { ratio: 0.9 }
    }
}

impl EntropyBelow {
    /// Checks the ratio.
    ///
    /// # Errors
    /// A ratio outside [0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("entropy ratio", self.ratio, 0.0, 1.0).map(|_| ())
    }
}

impl ResamplePolicy for EntropyBelow {
    fn is_due(&self, context: &ResampleContext) -> bool {
        context.weights.entropy < self.ratio * (context.count as f64).ln()
    }
}

/// Resample at every n-th update, as `nav2_amcl`'s `resample_interval`; zero reads as one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EveryNth(
    /// Updates from one resampling to the next.
    pub u64,
);

impl ResamplePolicy for EveryNth {
    fn is_due(&self, context: &ResampleContext) -> bool {
        context.updates >= self.0
    }
}

/// Resample once the vehicle has been away: a vehicle that stands must not lose its diversity to repeated draws.
impl ResamplePolicy for MotionThreshold {
    fn is_due(&self, context: &ResampleContext) -> bool {
        self.is_reached(context.distance, context.angle)
    }
}

/// Resample when both policies ask for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct And<A, B>(
    /// The one.
    pub A,
    /// The other.
    pub B,
);

impl<A: ResamplePolicy, B: ResamplePolicy> ResamplePolicy for And<A, B> {
    fn is_due(&self, context: &ResampleContext) -> bool {
        self.0.is_due(context) && self.1.is_due(context)
    }
}

/// Resample when either policy asks for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Or<A, B>(
    /// The one.
    pub A,
    /// The other.
    pub B,
);

impl<A: ResamplePolicy, B: ResamplePolicy> ResamplePolicy for Or<A, B> {
    fn is_due(&self, context: &ResampleContext) -> bool {
        self.0.is_due(context) || self.1.is_due(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::ParticleSet;
    use agv_core::compute::Par;

    /// A set of 1000 of which `alive` share the weight, four updates and half a metre after it was drawn.
    fn context(alive: usize) -> ResampleContext {
        let mut set = ParticleSet::new(vec![Se2::default(); 1000]).unwrap();
        let log_likelihoods: Vec<f64> = (0..1000).map(|i| if i < alive { 0.0 } else { f64::NEG_INFINITY }).collect();
        let weights = set.reweigh(&log_likelihoods, Par::Seq).unwrap();
        ResampleContext::new(weights, 1000, 4, Se2::new(0.5, 0.0, 0.0))
    }

    #[test]
    fn uneven_weights_are_seen_by_sample_size_and_by_entropy() {
        for (alive, expected) in [(1000, false), (520, false), (480, true), (1, true)] {
            assert_eq!(EffectiveSampleSizeBelow::default().is_due(&context(alive)), expected, "{alive}");
            assert_eq!(EntropyBelow::default().is_due(&context(alive)), expected, "{alive}");
        }
        for alive in [1, 500] {
            assert!(!EffectiveSampleSizeBelow { ratio: 0.0 }.is_due(&context(alive)));
            assert!(!EntropyBelow { ratio: 0.0 }.is_due(&context(alive)));
        }
        let single = ResampleContext { count: 1, weights: WeightSummary::uniform(1), ..context(1) };
        assert!(!EntropyBelow { ratio: 1.0 }.is_due(&single));
    }

    #[test]
    fn counts_and_motion_since_the_last_resampling_are_seen() {
        let context = context(1000);
        assert!(EveryNth(0).is_due(&context) && EveryNth(4).is_due(&context) && !EveryNth(5).is_due(&context));
        let moved = |distance| ResamplePolicy::is_due(&MotionThreshold { distance, angle: 1.0 }, &context);
        assert!(moved(0.4) && !moved(0.6));
        let away = context.having_been(3.0, 0.0);
        assert!(ResamplePolicy::is_due(&MotionThreshold { distance: 2.0, angle: 1.0 }, &away));
    }

    #[test]
    fn policies_combine() {
        let (yes, no) = (EveryNth(1), EveryNth(9));
        let due = |policy: &dyn ResamplePolicy| policy.is_due(&context(1000));
        assert!(due(&yes.and(yes)) && !due(&yes.and(no)) && !due(&no.and(yes)));
        assert!(due(&yes.or(no)) && due(&no.or(yes)) && !due(&no.or(no)));
        let chosen: Box<dyn ResamplePolicy> = Box::new(no.or(EffectiveSampleSizeBelow { ratio: 1.0 }).and(yes));
        assert!(chosen.is_due(&context(999)) && !chosen.is_due(&context(1000)));
    }

    #[test]
    fn bad_policies_are_named() {
        for ratio in [1.1, -0.1, f64::NAN] {
            assert!(EffectiveSampleSizeBelow { ratio }.validate().is_err());
            assert!(EntropyBelow { ratio }.validate().is_err());
        }
    }
}
