//! Kalman filters: a Gaussian belief, moved by a model and corrected by measurements.
//!
//! # Parts
//! - A state is a [`Manifold`]: a vector, a vector with angles ([`Wrapped`]), a pose, or a type of the user's.
//! - A [`ProcessModel`] moves it, a [`MeasurementModel`] reads it. Those here are listed below; one of your own is a few lines.
//! - A filter puts them together: [`Ekf`]. It holds a [`GaussianBelief`], takes readings through a [`Gate`], and
//!   reports each as a [`Correction`].
//! - [`laws`] hold models to their own Jacobians in tests.
//!
//! Models and filters have fixed sizes and are called without dispatch: a cycle of a pose in the plane takes tens of
//! nanoseconds, and nothing allocates.
//!
//! # Ready-made
//! - Motion: [`Unicycle`].
//! - Measurements: [`LinearMeasurement`], [`Landmark`].
//! - [`PoseFilter`]: the pose in the plane from wheel odometry and measured poses, with the odometry's yaw scale; it plays
//!   the roles.

mod belief;
mod ekf;
mod gate;
mod innovation;
pub mod laws;
mod manifold;
mod matrix;
mod measurement;
mod pose_filter;
mod process;
mod wrapped;

pub use belief::GaussianBelief;
pub use ekf::Ekf;
pub use gate::Gate;
pub use innovation::{Correction, Innovation};
pub use manifold::{Manifold, PlanarState};
pub use measurement::{Expected, Landmark, LinearMeasurement, MeasurementModel};
pub use pose_filter::{PoseFilter, PoseFilterParams};
pub use process::{ProcessModel, Transition, Unicycle, UnicycleParams, noise_from_inputs};
pub use wrapped::{PlanarPose, Wrapped};
