//! A pose with more beside it: odometry scales, biases, a sensor's latency.

use super::{Manifold, PlanarState};
use crate::particle::ParticleState;
use agv_core::geometry::{LieGroup, Se2};
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

/// A pose in the plane and `A` reals, for error-state filters of `3 + A` degrees of freedom, `A` from one to six.
///
/// The first three components of an increment are the right increment of the pose, along the axes of the vehicle.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::{SMatrix, Vector1};
/// use agv_filters::kalman::{AugmentedPose, Ekf, Gate, PoseReading};
///
/// // With the scale of the odometry's turns, which a reading of the pose corrects where the two are correlated.
/// let start = AugmentedPose { map_from_base: Se2::default(), extra: Vector1::new(0.0) };
/// let mut spread = SMatrix::<f64, 4, 4>::identity() * 1e-2;
/// (spread[(2, 3)], spread[(3, 2)]) = (5e-3, 5e-3);
/// let mut ekf = Ekf::new(start, spread)?;
/// let reading = PoseReading::new(agv_core::nalgebra::Matrix3::identity() * 1e-4)?;
/// ekf.update(&reading, &Se2::new(0.0, 0.0, 0.1).into(), &Gate::OPEN)?;
/// assert!((ekf.state().extra[0] - 0.05).abs() < 1e-3);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AugmentedPose<const A: usize> {
    /// The pose.
    pub map_from_base: Se2,
    /// What else is estimated.
    pub extra: SVector<f64, A>,
}

impl<const A: usize> ParticleState for AugmentedPose<A> {
    fn is_finite(&self) -> bool {
        LieGroup::is_finite(&self.map_from_base) && super::matrix::is_finite(&self.extra)
    }
}

/// `3 + A` is no constant that stable Rust could compute.
macro_rules! augmented_pose_is_a_manifold {
    ($($extra:literal: $dof:literal),*) => {$(
        impl Manifold<$dof> for AugmentedPose<$extra> {
            #[inline]
            fn boxplus(&self, increment: &SVector<f64, $dof>) -> Self {
                Self {
                    map_from_base: self.map_from_base.plus(&increment.fixed_rows::<3>(0).into_owned()),
                    extra: self.extra + increment.fixed_rows::<$extra>(3),
                }
            }

            #[inline]
            fn boxminus(&self, origin: &Self) -> SVector<f64, $dof> {
                let mut increment = SVector::<f64, $dof>::zeros();
                increment.fixed_rows_mut::<3>(0).copy_from(&self.map_from_base.minus(&origin.map_from_base));
                increment.fixed_rows_mut::<$extra>(3).copy_from(&(self.extra - origin.extra));
                increment
            }

            #[inline]
            fn reset_jacobian(correction: &SVector<f64, $dof>) -> Option<SMatrix<f64, $dof, $dof>> {
                let of_pose: Vector3<f64> = correction.fixed_rows::<3>(0).into_owned();
                let mut reset = SMatrix::<f64, $dof, $dof>::identity();
                reset.fixed_view_mut::<3, 3>(0, 0).copy_from(&Se2::right_jacobian(&of_pose));
                Some(reset)
            }
        }

        impl PlanarState<$dof> for AugmentedPose<$extra> {
            #[inline]
            fn position(&self) -> Vector2<f64> {
                self.map_from_base.translation()
            }

            #[inline]
            fn yaw(&self) -> f64 {
                self.map_from_base.yaw()
            }

            #[inline]
            fn pose(&self) -> Se2 {
                self.map_from_base
            }

            #[inline]
            fn lift<const M: usize>(&self, by_pose: &SMatrix<f64, M, 3>) -> SMatrix<f64, M, $dof> {
                let mut by_state = SMatrix::<f64, M, $dof>::zeros();
                by_state.fixed_columns_mut::<3>(0).copy_from(&self.map_from_base.lift(by_pose));
                by_state
            }
        }
    )*};
}
augmented_pose_is_a_manifold!(1: 4, 2: 5, 3: 6, 4: 7, 5: 8, 6: 9);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Landmark, laws};
    use nalgebra::Vector6;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_laws_of_a_manifold_hold(x in prop::array::uniform6(-3.0..3.0_f64), step in prop::array::uniform6(-2.0..2.0_f64)) {
            let state = AugmentedPose { map_from_base: Se2::new(x[0], x[1], x[2]), extra: Vector3::new(x[3], x[4], x[5]) };
            prop_assert!(laws::manifold(&state, &Vector6::from(step)) < 1e-8);
            let landmark = Landmark::new(Vector2::new(9.0, 1.0), &Vector2::new(0.1, 0.1)).unwrap();
            prop_assert!(laws::measurement_jacobian(&landmark, &state) < 1e-8);
        }
    }

    #[test]
    fn what_is_no_number_is_seen() {
        let state = AugmentedPose { map_from_base: Se2::default(), extra: Vector2::new(0.0, f64::NAN) };
        assert!(!ParticleState::is_finite(&state));
    }
}
