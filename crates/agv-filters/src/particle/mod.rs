//! Monte Carlo localisation: a belief as weighted samples of the pose.
//!
//! A cycle moves every particle by a draw of the [`MotionModel`], weighs it by the likelihood of the scan
//! ([`SensorModel`]), and draws a new set in proportion to the weights where they have become uneven ([`Resampler`],
//! [`ResamplePolicy`]). [`Mcl`] is that cycle; the parts are traits, so that each can be replaced. [`Amcl`] is the adaptive filter: as many particles
//! as the belief needs ([`KldSampling`]), new ones elsewhere where the belief is to be doubted ([`Recovery`],
//! [`PoseProposal`]), and the best of several hypotheses for an estimate ([`Clusters`]).
//!
//! Particles are handled in fixed chunks of [`CHUNK`](agv_core::compute::CHUNK), each with a random stream keyed by
//! (seed, step, chunk): a run has the same bits for any number of threads and continues from a checkpoint with them.

mod amcl;
mod chi_square;
mod cluster;
mod draw;
mod excursion;
mod exp;
mod free_space;
mod gaussian;
mod hilbert;
mod histogram;
mod kld;
mod mcl;
mod moments;
mod motion;
mod normal;
mod per_sensor;
mod proposal;
mod recovery;
mod resample;
mod resample_policy;
mod sample_size;
mod sensor;
mod set;
#[cfg(test)]
mod simd;
mod swarm;
mod temper;
mod trig;
mod update_policy;
mod weights;

#[cfg(feature = "serde")]
pub use amcl::AmclCheckpoint;
pub use amcl::{Amcl, AmclParams};
pub use cluster::{Clusters, Hypothesis, Hysteresis};
pub use free_space::FreeSpace;
pub(crate) use gaussian::semidefinite_root;
pub use histogram::{PoseBins, PoseHistogram};
pub use kld::{KldBound, KldParams, KldQuantile, KldSampling};
#[cfg(feature = "serde")]
pub use mcl::MclCheckpoint;
pub use mcl::{Mcl, MclDiagnostics, MclParams, TemperingParams};
pub use motion::{
    AckermannOdometryModel, AckermannOdometryParams, DifferentialOdometryModel, MotionModel, OdometryNoise,
    OmnidirectionalNoise, OmnidirectionalOdometryModel, PriorMotionModel, PriorNoise, VelocityModel, VelocityNoise,
};
pub use proposal::{
    LikelihoodSearch, LikelihoodSearchParams, MarkerProposal, ObservedPose, PoseProposal, ProposalContext,
    ResumableProposal, SearchState, UniformProposal,
};
pub use recovery::{Recovery, RecoveryParams};
pub use resample::{Multinomial, Resampler, Residual, Stratified, Systematic};
pub use resample_policy::{And, EffectiveSampleSizeBelow, EntropyBelow, EveryNth, Or, ResampleContext, ResamplePolicy};
pub use sample_size::{SameSize, SampleSize};
pub use sensor::{
    BeamFit, BeamModel, BeamModelParams, BeamSample, BeamSkipping, BeamSkippingParams, LandmarkModel,
    LandmarkModelParams, LikelihoodFieldModel, LikelihoodFieldModelParams, MarkerModel, MarkerModelParams, NdtMapModel,
    NdtMapModelParams, PerPose, PoseLikelihood, ScanForm, SensorModel, Sensors, UsedBeams, WeighParticles,
};
pub use set::{ParticleSet, ParticleState};
pub use swarm::{AroundPose, BlendedPoses, ImprovedSwarm, InitialPoses, StratifiedPoses, SwarmParams, UniformPoses};
pub use update_policy::{MotionThreshold, UpdateContext, UpdatePolicy};
pub use weights::WeightSummary;
