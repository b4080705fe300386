//! Step tests: how well a loop follows a step of its set-point.
//!
//! - [`StepTest`]: the cost of PID gains on a linear plant, for tuners that need it a thousand times.
//! - [`simulate_step`]: the response of any [`Controller`](agv_core::roles::Controller) on any
//!   [`Plant`](crate::plant::Plant).
//! - [`StepMetrics`]: rise, settling, overshoot, steady-state error and the integral criteria of a response.

mod figures;
mod kernel;
mod lane;
mod metrics;
mod simulate;
mod step_test;
#[cfg(test)]
mod tests;

pub use figures::StepFigures;
pub use metrics::{StepMetrics, StepMetricsParams};
pub use simulate::{StepResponse, simulate_step};
pub use step_test::{PidGains, StepTest, StepTestParams};
