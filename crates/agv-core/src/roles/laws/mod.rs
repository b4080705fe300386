//! What every player of a role must do, as functions that a player's tests call.
//!
//! Each takes the player and a case that it should be able to handle, and returns the first law that was broken:
//!
//! ```
//! # use agv_core::{check, roles::{ControlError, Controller, laws}};
//! # struct Proportional(f64);
//! # impl Controller for Proportional {
//! #     fn update(&mut self, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError> {
//! #         check::positive("dt", dt)?;
//! #         Ok(self.0 * (check::finite("set_point", set_point)? - check::finite("measurement", measurement)?))
//! #     }
//! #     fn reset(&mut self) {}
//! # }
//! laws::controller(&mut Proportional(2.0))?;
//! # Ok::<(), laws::LawViolation>(())
//! ```

mod control;
mod localizer;
mod matching;
mod planners;
mod vehicles;

pub use control::{controller, path_tracker};
pub use localizer::{correct, localizer, two_sensors};
pub use matching::{lidar_odometry, registration, scan_matcher};
pub use planners::{global_planner, local_planner};
pub use vehicles::vehicles;

/// A law that a player of a role broke.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{role} broke a law: {law}")]
pub struct LawViolation {
    /// The role.
    pub role: &'static str,
    /// What it promises.
    pub law: &'static str,
}

/// Turns a condition into a verdict.
fn ensure(role: &'static str, law: &'static str, holds: bool) -> Result<(), LawViolation> {
    if holds { Ok(()) } else { Err(LawViolation { role, law }) }
}

/// Values that no state, motion or duration may have.
const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
