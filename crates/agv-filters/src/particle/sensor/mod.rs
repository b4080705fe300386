//! How likely an observation is, given a pose.
//!
//! Two shapes. A [`SensorModel`] is written pose by pose: conditioned once on the observation, then asked for the
//! log-likelihood of each pose. [`WeighParticles`] is the batch form that a filter calls: object-safe, and open to models
//! that must see all particles at once, as beam skipping does. [`PerPose`] makes the second of the first.

mod likelihood_field;
mod model;
mod weigh;

pub use likelihood_field::{LikelihoodFieldModel, LikelihoodFieldModelParams, ScanForm};
pub use model::{PoseLikelihood, SensorModel};
use weigh::weigh_per_pose;
pub use weigh::{PerPose, WeighParticles};
