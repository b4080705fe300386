//! The contract of all that make a path on a costmap better.

use agv_core::{Error, grid::Costmap, path::Path};

/// What makes a path better to follow.
pub trait PathSmoother {
    /// Writes the better path, reusing the memory of `smooth`. First and last pose stay as they are, and it is clear on this
    /// costmap wherever `path` is.
    ///
    /// # Errors
    /// A path that the smoother cannot take.
    fn smooth_into(&mut self, costmap: &Costmap, path: &Path, smooth: &mut Path) -> Result<(), Error>;
}
