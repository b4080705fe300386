//! One error type over all parts, for callers who compose several.

use agv_core::{
    frames::FrameError,
    roles::{AlignmentError, ControlError, LocalPlanError, LocalizationError, PlanError, TrackError},
};

/// Whatever a part of a pipeline refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value was refused at construction.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
    /// A tree of frames refused an edge or a look-up.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// A localizer refused a call.
    #[error(transparent)]
    Localization(#[from] LocalizationError),
    /// A scan matcher, a registration or a lidar odometry refused a call.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// A global planner refused a query.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A global planner refused its parameters.
    #[cfg(feature = "plan")]
    #[error(transparent)]
    PlanParams(#[from] agv_plan::Error),
    /// A map of normal distributions or its parameters were refused.
    #[cfg(feature = "ndt")]
    #[error(transparent)]
    Ndt(#[from] agv_ndt::Error),
    /// A local planner refused a request.
    #[error(transparent)]
    LocalPlan(#[from] LocalPlanError),
    /// A path tracker refused a call.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A plant or a test of a controller was refused.
    #[cfg(feature = "control")]
    #[error(transparent)]
    ControlParams(#[from] agv_control::Error),
    /// A controller refused a call.
    #[error(transparent)]
    Control(#[from] ControlError),
}
