//! What local planners share.
//!
//! - [`Trajectories`] and [`critics`]: many ways to go on at once, and what is good about each.
//! - [`NavigationField`]: how far it is to the goal around the obstacles in sight.
//! - [`Guard`]: lets no command pass that does not leave a way to brake; what makes planners safe.
//! - [`Reference`]: what the path asks for now: drive, turn on the spot, or rest.
//! - [`Window`]: which velocities can be reached soon.
//! - [`moving`]: contact with obstacles that move, each at its time.
//! - [`Tracked`]: the plainest local planner, a path tracker that stops before obstacles.

pub mod critics;
mod field;
mod guard;
pub(crate) mod lead;
pub mod moving;
mod reference;
pub(crate) mod sampling;
#[cfg(test)]
pub(crate) mod scenes;
mod tracked;
pub(crate) mod trajectories;
pub(crate) mod window;

use agv_core::{
    check,
    roles::{LocalPlanError, LocalPlanRequest},
};
pub use field::{FieldParams, NavigationField};
pub use guard::{Guard, GuardParams, Verdict};
pub use reference::{Drive, Reference, ReferenceParams, Task};
pub use tracked::{Tracked, TrackedParams};
pub use trajectories::{StepView, Trajectories};
pub use window::Window;

/// Accepts a request that a local planner can work with: a path, finite numbers, sound limits, time that passes.
///
/// # Errors
/// [`LocalPlanError::EmptyPath`], or the first value that is refused, by name.
pub fn check_request(request: &LocalPlanRequest<'_>) -> Result<(), LocalPlanError> {
    if request.path.is_empty() {
        return Err(LocalPlanError::EmptyPath);
    }
    request.state.validate()?;
    request.limits.validate()?;
    check::positive("dt", request.dt)?;
    for obstacle in request.obstacles {
        check::all_finite("obstacle position", obstacle.position.iter())?;
        check::all_finite("obstacle velocity", obstacle.velocity.iter())?;
        check::non_negative("obstacle radius", obstacle.radius)?;
    }
    Ok(())
}
