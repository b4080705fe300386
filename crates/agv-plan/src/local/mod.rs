//! What local planners share.
//!
//! - [`Guard`]: lets no command pass that does not leave a way to brake; what makes planners safe.
//! - [`Reference`]: what the path asks for now: drive, turn on the spot, or rest.
//! - [`moving`]: contact with obstacles that move, each at its time.
//! - [`Tracked`]: the plainest local planner, a path tracker that stops before obstacles.

mod guard;
pub mod moving;
mod reference;
mod tracked;

use agv_core::{
    check,
    roles::{LocalPlanError, LocalPlanRequest},
};
pub use guard::{Guard, GuardParams, Verdict};
pub use reference::{Drive, Reference, ReferenceParams, Task};
pub use tracked::{Tracked, TrackedParams};

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
