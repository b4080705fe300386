//! Spaces that a state lives in: where a correction is added, and how two states differ.
//!
//! A heading is no number: 179° and -179° are two degrees apart. The filters know of a state only how a small vector
//! of `N` reals is added to it and which vector leads from one to another (Hertzberg, Wagner, Frese and Schröder 2013,
//! *Integrating generic sensor fusion algorithms with sound state representations through encapsulation of manifolds*):
//!
//! ```text
//! x ⊞ 0 = x        x ⊞ (y ⊟ x) = y        (x ⊞ δ) ⊟ x = δ  for small δ
//! ```
//!
//! The covariance of a belief is that of `δ`. With vectors of numbers and angles ([`Wrapped`](super::Wrapped)) the filters
//! are the textbook's; with [`Se2`] or [`Se3`] the same filters are error-state filters with right increments.

use crate::particle::ParticleState;
use agv_core::geometry::{LieGroup, Se2, Se3};
use nalgebra::{SMatrix, SVector, Vector2};
use std::fmt::Debug;

/// A state with `N` degrees of freedom.
///
/// Implement it for a state of your own that is neither a vector, a [`Wrapped`](super::Wrapped) one nor a pose;
/// [`laws::manifold`](super::laws::manifold) checks it.
pub trait Manifold<const N: usize>: ParticleState + Debug + PartialEq {
    /// `x ⊞ δ`: the state moved by an increment.
    fn boxplus(&self, increment: &SVector<f64, N>) -> Self;

    /// `x ⊟ origin`: the increment that leads from `origin` to this state.
    fn boxminus(&self, origin: &Self) -> SVector<f64, N>;

    /// Jacobian by which increments at `x` become increments at `x ⊞ correction`; none where it is the unit matrix, as for
    /// vectors. Applied to the covariance after a correction: the reset of an error-state filter (Solà 2017, *Quaternion
    /// kinematics for the error-state Kalman filter*, section 6.3).
    #[inline]
    fn reset_jacobian(_correction: &SVector<f64, N>) -> Option<SMatrix<f64, N, N>> {
        None
    }
}

impl<const N: usize> Manifold<N> for SVector<f64, N> {
    #[inline]
    fn boxplus(&self, increment: &Self) -> Self {
        self + increment
    }

    #[inline]
    fn boxminus(&self, origin: &Self) -> Self {
        self - origin
    }
}

/// Right increments.
macro_rules! group_is_a_manifold {
    ($($group:ty: $dof:literal),*) => {$(
        impl Manifold<$dof> for $group {
            #[inline]
            fn boxplus(&self, increment: &SVector<f64, $dof>) -> Self {
                self.plus(increment)
            }

            #[inline]
            fn boxminus(&self, origin: &Self) -> SVector<f64, $dof> {
                self.minus(origin)
            }

            #[inline]
            fn reset_jacobian(correction: &SVector<f64, $dof>) -> Option<SMatrix<f64, $dof, $dof>> {
                Some(<$group>::right_jacobian(correction))
            }
        }
    )*};
}
group_is_a_manifold!(Se2: 3, Se3: 6);

/// A state that holds the pose of a vehicle on a floor, whatever else it holds: what measurements of the pose, of a
/// position or of a landmark need to know of it.
pub trait PlanarState<const N: usize>: Manifold<N> {
    /// Position in the map, in metres.
    fn position(&self) -> Vector2<f64>;

    /// Heading in the map, in radians.
    fn yaw(&self) -> f64;

    /// The pose `map_from_base`.
    #[inline]
    fn pose(&self) -> Se2 {
        let position = self.position();
        Se2::new(position.x, position.y, self.yaw())
    }

    /// Jacobian with respect to the state's increment, from that with respect to `(x, y, yaw)` in the map.
    fn lift<const M: usize>(&self, by_pose: &SMatrix<f64, M, 3>) -> SMatrix<f64, M, N>;
}

impl PlanarState<3> for Se2 {
    #[inline]
    fn position(&self) -> Vector2<f64> {
        self.translation()
    }

    #[inline]
    fn yaw(&self) -> f64 {
        Self::yaw(self)
    }

    #[inline]
    fn pose(&self) -> Self {
        *self
    }

    /// A right increment moves along the axes of the vehicle.
    #[inline]
    fn lift<const M: usize>(&self, by_pose: &SMatrix<f64, M, 3>) -> SMatrix<f64, M, 3> {
        by_pose * self.rotation_adjoint()
    }
}
