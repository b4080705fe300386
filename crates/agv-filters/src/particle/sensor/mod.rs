//! How likely an observation is, given a pose.
//!
//! Two shapes. A [`SensorModel`] is written pose by pose: conditioned once on the observation, then asked for the
//! log-likelihood of each pose. [`WeighParticles`] is the batch form that a filter calls: object-safe, and open to models
//! that must see all particles at once, as beam skipping does. [`PerPose`] makes the second of the first.

mod beam;
mod beam_skipping;
mod beams;
mod end_points;
mod landmark;
mod likelihood_field;
mod marker;
mod model;
mod ndt_map;
mod scan_form;
mod sensors;
mod weigh;

pub use beam::{BeamFit, BeamModel, BeamModelParams, BeamSample};
pub use beam_skipping::{BeamSkipping, BeamSkippingParams};
pub use beams::UsedBeams;
pub use landmark::{LandmarkModel, LandmarkModelParams};
pub use likelihood_field::{LikelihoodFieldModel, LikelihoodFieldModelParams};
pub use marker::{MarkerModel, MarkerModelParams};
pub use model::{PoseLikelihood, SensorModel};
pub use ndt_map::{NdtMapModel, NdtMapModelParams};
pub use scan_form::ScanForm;
pub use sensors::Sensors;
use weigh::weigh_per_pose;
pub use weigh::{PerPose, WeighParticles};
