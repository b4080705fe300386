//! Tuning: which gains, or which parameters of anything, make a loop behave.
//!
//! - [`tune_pid`] finds the gains of a PID controller for the cost of a step test: a [`StepTest`] as it is (ITAE), or a
//!   [`StepCost`] with weights on overshoot, effort and robustness, over one plant or several.
//! - [`Knobs`] turns chosen fields of any parameters into coordinates, so that trackers, filters and planners are tuned by
//!   the user's own cost.
//! - [`OnlineTuner`] goes on tuning while the vehicle drives, a few evaluations per cycle, and begins anew when its plant
//!   has changed.
//!
//! ```
//! use agv_control::plant::StandIn;
//! use agv_control::tune::tune_pid;
//! use agv_core::compute::Seed;
//!
//! let tuned = tune_pid(&StandIn::P1.step_test()?, [50.0; 3].into(), Seed(1))?;
//! assert!(tuned.cost < 0.0451 && tuned.evaluations <= 2000);
//! # Ok::<(), agv_control::Error>(())
//! ```

mod knobs;
mod online;
mod pid;
mod step_cost;

pub use knobs::Knobs;
pub use online::{OnlineTuner, OnlineTunerParams, Proposal};
pub use pid::{TunedPid, gain_space, tune_pid};
pub use step_cost::{Criterion, StepCost, StepCostParams};

#[cfg(doc)]
use crate::step_response::StepTest;
