//! Monte Carlo localisation: a belief as weighted samples of the pose.
//!
//! A cycle moves every particle by a draw of the [`MotionModel`], weighs it by the likelihood of the scan
//! ([`SensorModel`]), and draws a new set in proportion to the weights where they have become uneven ([`Resampler`],
//! [`ResamplePolicy`]). [`Mcl`] is that cycle; the parts are traits, so that each can be replaced.
//!
//! Particles are handled in fixed chunks of [`CHUNK`](agv_core::compute::CHUNK), each with a random stream keyed by
//! (seed, step, chunk): a run has the same bits for any number of threads and continues from a checkpoint with them.

mod free_space;
mod gaussian;
mod mcl;
mod moments;
mod motion;
mod resample;
mod resample_policy;
mod sample_size;
mod sensor;
mod set;
mod trig;
mod update_policy;
mod weights;

pub use free_space::FreeSpace;
#[cfg(feature = "serde")]
pub use mcl::MclCheckpoint;
pub use mcl::{Mcl, MclDiagnostics, MclParams, TemperingParams};
pub use motion::{DifferentialOdometryModel, MotionModel, OdometryNoise};
pub use resample::{Resampler, Systematic};
pub use resample_policy::{And, EffectiveSampleSizeBelow, EntropyBelow, EveryNth, Or, ResampleContext, ResamplePolicy};
pub use sample_size::{SameSize, SampleSize};
pub use sensor::{
    LikelihoodFieldModel, LikelihoodFieldModelParams, PerPose, PoseLikelihood, ScanForm, SensorModel, WeighParticles,
};
pub use set::{ParticleSet, ParticleState};
pub use update_policy::{MotionThreshold, UpdateContext, UpdatePolicy};
pub use weights::WeightSummary;
