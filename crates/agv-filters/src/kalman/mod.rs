//! Kalman filters: a Gaussian belief, moved by a model and corrected by measurements.
//!
//! # Parts
//! - A state is a [`Manifold`]: a vector, a vector with angles ([`Wrapped`]), a pose, a pose with more beside it
//!   ([`AugmentedPose`]), or a type of the user's.
//! - A [`ProcessModel`] moves it, a [`MeasurementModel`] reads it. Those here are listed below; one of your own is a few lines.
//! - A filter puts them together: [`Ekf`] (with the iterated update; [`KalmanFilter`] where the state is a vector and the
//!   models are linear), [`Ukf`], [`BootstrapFilter`]. The Gaussian ones hold a [`GaussianBelief`], take readings through a
//!   [`Gate`] and report each as a [`Correction`]; [`RtsSmoother`] looks back.
//! - [`laws`] hold models to their own Jacobians in tests.
//!
//! Models and filters have fixed sizes and are called without dispatch: a cycle of a pose in the plane takes tens of
//! nanoseconds, and nothing allocates.
//!
//! # Ready-made
//! - Motion: [`Unicycle`], [`Bicycle`], [`ConstantTurn`], [`LinearProcess`].
//! - Measurements: [`YawReading`], [`PositionReading`], [`PoseReading`] and [`Landmark`] of any [`PlanarState`],
//!   [`Components`] of a [`Wrapped`] state, [`LinearMeasurement`]; [`Masked`] leaves out some components of any.
//! - [`PoseFilter`]: the pose in the plane from wheel odometry and measured poses, with the odometry's yaw scale; it plays
//!   the roles.

mod augmented;
mod belief;
mod bootstrap;
mod ekf;
mod gate;
mod innovation;
mod iterated;
pub mod laws;
mod manifold;
mod matrix;
mod measurement;
mod pose_filter;
mod process;
mod rts;
mod ukf;
mod wrapped;

pub use augmented::AugmentedPose;
pub use belief::GaussianBelief;
pub use bootstrap::BootstrapFilter;
pub use ekf::{Ekf, KalmanFilter};
pub use gate::Gate;
pub use innovation::{Correction, Innovation};
pub use iterated::{IteratedCorrection, IterationParams};
pub use manifold::{Manifold, PlanarState};
pub use measurement::{
    Components, Expected, Landmark, LinearMeasurement, Masked, MeasurementModel, PoseReading, PositionReading,
    YawReading,
};
pub use pose_filter::{PoseFilter, PoseFilterParams};
pub use process::{
    Bicycle, BicycleParams, ConstantTurn, ConstantTurnParams, LinearProcess, ProcessModel, SteeredMotion, Transition,
    TurningState, Unicycle, UnicycleParams, noise_from_inputs,
};
pub use rts::RtsSmoother;
pub use ukf::{Ukf, UkfParams};
pub use wrapped::{PlanarPose, Wrapped};
