//! What planners that sample trajectories ask of their parameters alike.

use crate::Error;
use agv_core::check;

/// Longest step of a trajectory, in seconds: its arcs are series in the angle that it turns.
pub(crate) const MAX_STEP: f64 = 0.25;

/// Checks a horizon in seconds of so many steps.
pub(crate) fn check_horizon(horizon: f64, steps: usize) -> Result<(), Error> {
    check::at_least("steps", steps, 2)?;
    check::positive("horizon", horizon)?;
    check::in_range("horizon / steps", horizon / steps as f64, f64::MIN_POSITIVE, MAX_STEP)?;
    Ok(())
}

/// Checks how the path is followed: metres ahead, share of the deceleration for the stop, seconds without progress.
pub(crate) fn check_lead(look_ahead: f64, stopping_share: f64, patience: f64) -> Result<(), Error> {
    check::positive("look_ahead", look_ahead)?;
    check::in_range("stopping_share", stopping_share, 0.05, 1.0)?;
    check::positive("patience", patience)?;
    Ok(())
}
