//! Checks of what callers give, beyond those of the core.

use agv_core::{Error, check, geometry::Se3};

/// Accepts a pose that is finite.
///
/// # Errors
/// [`Error::NotFinite`] with the first value that is not.
pub(crate) fn finite_pose(name: &'static str, pose: &Se3) -> Result<(), Error> {
    check::all_finite(name, pose.translation().iter())?;
    check::all_finite(name, pose.rotation().matrix().iter())
}
