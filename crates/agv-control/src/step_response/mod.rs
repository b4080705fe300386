//! Step tests: how well a loop follows a step of its set-point.
//!
//! - [`StepTest`]: the cost of PID gains on a linear plant, for tuners that need it a thousand times.

mod figures;
mod kernel;
mod lane;
mod step_test;

pub use figures::StepFigures;
pub use step_test::{PidGains, StepTest, StepTestParams};
