//! Which directions of a pose may change.

use agv_core::geometry::{LieGroup, Se3};
use nalgebra::{Matrix6, Vector3};

/// What of a pose may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Freedom {
    /// All six degrees of freedom.
    #[default]
    Full,
    /// x, y and the turn about z, of the target frame: a vehicle on an even floor. Height, roll and pitch stay the guess's.
    Planar,
}

impl Freedom {
    /// The projector onto the right increments that are free at `pose`. In the plane it is the same for every pose that can be
    /// reached: turns about z keep what is horizontal.
    pub fn projector(self, pose: &Se3) -> Matrix6<f64> {
        match self {
            Self::Full => Matrix6::identity(),
            Self::Planar => {
                let up = pose.rotation().inverse().act(&Vector3::z());
                let vertical = up * up.transpose();
                let mut projector = Matrix6::identity();
                let mut line = projector.fixed_view_mut::<3, 3>(0, 0);
                line -= vertical;
                projector.fixed_view_mut::<3, 3>(3, 3).copy_from(&vertical);
                projector
            }
        }
    }
}
