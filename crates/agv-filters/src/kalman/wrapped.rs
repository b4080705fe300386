//! Vectors of numbers and angles.

use super::{Manifold, PlanarState};
use crate::particle::ParticleState;
use agv_core::geometry::wrap_angle;
use nalgebra::{SMatrix, SVector, Vector2};
use std::ops::Deref;

/// `N` reals of which those whose bit is set in `ANGLES` are angles, kept in (-π, π].
///
/// A state with a heading and any augmentation: odometry scale, gyro bias, latency. As a [`PlanarState`] its first two
/// components are the position and its first angle is the heading. Reads as an `SVector`.
///
/// ```
/// use agv_core::nalgebra::{Vector3, Vector4};
/// use agv_filters::kalman::{Manifold, Wrapped};
///
/// /// x, y, heading and the bias of the gyro.
/// type State = Wrapped<4, 0b0100>;
/// let state = State::from(Vector4::new(1.0, 2.0, 3.1, 0.01));
/// let turned = state.boxplus(&Vector4::new(0.0, 0.0, 0.1, 0.0));
/// assert!((turned[2] + 3.083).abs() < 1e-3);
/// assert!((turned.boxminus(&state)[2] - 0.1).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(from = "SVector<f64, N>", into = "SVector<f64, N>")
)]
pub struct Wrapped<const N: usize, const ANGLES: u32>(SVector<f64, N>);

/// A pose in the plane `(x, y, yaw)` whose increments are along the axes of the map, in metres and radians.
pub type PlanarPose = Wrapped<3, 0b100>;

impl<const N: usize, const ANGLES: u32> Wrapped<N, ANGLES> {
    /// Whether the component is an angle.
    #[inline]
    pub const fn is_angle(index: usize) -> bool {
        index < 32 && (ANGLES >> index) & 1 == 1
    }

    /// The same components as a plain vector.
    #[inline]
    pub const fn vector(&self) -> &SVector<f64, N> {
        &self.0
    }

    /// Where the heading stands.
    const YAW: usize = ANGLES.trailing_zeros() as usize;

    #[inline]
    fn wrap(mut vector: SVector<f64, N>) -> SVector<f64, N> {
        for (index, value) in vector.iter_mut().enumerate() {
            if Self::is_angle(index) {
                *value = wrap_angle(*value);
            }
        }
        vector
    }
}

impl<const N: usize, const ANGLES: u32> From<SVector<f64, N>> for Wrapped<N, ANGLES> {
    #[inline]
    fn from(vector: SVector<f64, N>) -> Self {
        Self(Self::wrap(vector))
    }
}

impl<const N: usize, const ANGLES: u32> From<Wrapped<N, ANGLES>> for SVector<f64, N> {
    #[inline]
    fn from(state: Wrapped<N, ANGLES>) -> Self {
        state.0
    }
}

impl<const N: usize, const ANGLES: u32> Deref for Wrapped<N, ANGLES> {
    type Target = SVector<f64, N>;

    #[inline]
    fn deref(&self) -> &SVector<f64, N> {
        &self.0
    }
}

impl<const N: usize, const ANGLES: u32> ParticleState for Wrapped<N, ANGLES> {
    #[inline]
    fn is_finite(&self) -> bool {
        self.0.iter().all(|value| value.is_finite())
    }
}

impl<const N: usize, const ANGLES: u32> Manifold<N> for Wrapped<N, ANGLES> {
    #[inline]
    fn boxplus(&self, increment: &SVector<f64, N>) -> Self {
        Self(Self::wrap(self.0 + increment))
    }

    #[inline]
    fn boxminus(&self, origin: &Self) -> SVector<f64, N> {
        Self::wrap(self.0 - origin.0)
    }
}

impl<const N: usize, const ANGLES: u32> PlanarState<N> for Wrapped<N, ANGLES> {
    #[inline]
    fn position(&self) -> Vector2<f64> {
        const { assert!(Self::YAW >= 2 && Self::YAW < N, "a planar state is a position and, behind it, a heading") };
        Vector2::new(self.0[0], self.0[1])
    }

    #[inline]
    fn yaw(&self) -> f64 {
        const { assert!(Self::YAW < N, "a planar state has a heading") };
        self.0[Self::YAW]
    }

    #[inline]
    fn lift<const M: usize>(&self, by_pose: &SMatrix<f64, M, 3>) -> SMatrix<f64, M, N> {
        let mut by_state = SMatrix::<f64, M, N>::zeros();
        for (column, index) in [0, 1, Self::YAW].into_iter().enumerate() {
            by_state.set_column(index, &by_pose.column(column));
        }
        by_state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::laws;
    use nalgebra::{Vector3, Vector4};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_laws_of_a_manifold_hold(x in prop::array::uniform4(-3.1..3.1_f64), step in prop::array::uniform4(-3.0..3.0_f64)) {
            let state = Wrapped::<4, 0b1010>::from(Vector4::from(x));
            prop_assert!(laws::manifold(&state, &Vector4::from(step)) < 1e-9);
            prop_assert!(laws::manifold(&Vector4::from(x), &Vector4::from(step)) < 1e-9);
            let pose = agv_core::geometry::Se2::new(x[0], x[1], x[2]);
            prop_assert!(laws::manifold(&pose, &Vector3::new(step[0], step[1], step[2])) < 1e-8);
        }
    }

    #[test]
    fn angles_are_wrapped_wherever_they_stand() {
        let state = Wrapped::<4, 0b1001>::from(Vector4::new(4.0, 4.0, 4.0, -4.0));
        assert!((state[0] - (4.0 - std::f64::consts::TAU)).abs() < 1e-12 && state[1] == 4.0 && state[2] == 4.0);
        assert!((state[3] - (std::f64::consts::TAU - 4.0)).abs() < 1e-12);
        let pose = Wrapped::<5, 0b01000>::from(nalgebra::SVector::<f64, 5>::new(1.0, 2.0, 0.5, 3.0, 0.1));
        assert_eq!((pose.position(), pose.yaw()), (Vector2::new(1.0, 2.0), 3.0));
    }
}
