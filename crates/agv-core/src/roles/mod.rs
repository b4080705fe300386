//! The parts that algorithms play in a pipeline, as object-safe traits: hold them as `Box<dyn GlobalPlanner + Send>`.
//!
//! A role is called once per cycle, so the dynamic call costs nothing that matters; what runs millions of times inside
//! is generic. The roles are declared here, on the ground floor, because several crates play the same one.
//!
//! What all roles share:
//! - A call that returns an error has changed nothing. Errors name the value that was refused.
//! - What can happen to correct callers (no path, a skipped scan, an iteration limit) is an *outcome* in the return
//!   value, not an error.
//! - No clock is read and nothing is drawn from the operating system: the same calls give the same bits.
//!
//! [`laws`] holds the tests that every player of a role must pass.

mod alignment;
mod controller;
mod global_planner;
pub mod laws;
mod local_planner;
mod localization_status;
mod localizer;
mod registration;
mod scan_matcher;
mod tracker;

pub use alignment::{Alignment, AlignmentError, Termination};
pub use controller::{ControlError, Controller};
pub use global_planner::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome};
pub use local_planner::{
    BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState,
};
pub use localization_status::{Doubt, LocalizationStatus, StatusMonitor, StatusParams};
pub use localizer::{
    Correct, LocalizationError, Localizer, PoseBelief, PoseEstimate, SkipReason, UpdateOutcome, UpdateReport,
};
pub use registration::{LidarOdometry, LidarOdometryStep, Registration};
pub use scan_matcher::{ScanMatcher, TargetScan};
pub use tracker::{PathTracker, TrackCommand, TrackError, TrackStatus};
