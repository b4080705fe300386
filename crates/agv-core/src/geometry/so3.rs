//! Rotations of space, as unit quaternions.

use super::{
    LieGroup,
    group::{sealed::Sealed, tangent_space},
    series, wrap_angle,
};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use std::{f64::consts::FRAC_PI_2, ops::Mul};

/// A rotation of space.
///
/// ```
/// use agv_core::geometry::{LieGroup, So3};
/// use agv_core::nalgebra::Vector3;
///
/// let left = So3::from_roll_pitch_yaw(0.0, 0.0, std::f64::consts::FRAC_PI_2);
/// assert!((left.act(&Vector3::x()) - Vector3::y()).norm() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSo3"))]
pub struct So3(UnitQuaternion<f64>);

/// Half of the pitch's distance from ±π/2, in radians, below which rounding alone would tell roll from yaw.
const POLE: f64 = 1e-14;

/// The matrix of the cross product: `skew(a) b = a × b`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

impl So3 {
    /// The rotation by yaw about z, then pitch about the new y, then roll about the new x (REP-103), in radians.
    pub fn from_roll_pitch_yaw(roll: f64, pitch: f64, yaw: f64) -> Self {
        Self(UnitQuaternion::from_euler_angles(roll, pitch, yaw))
    }

    /// Roll in (-π, π], pitch in [-π/2, π/2] and yaw in (-π, π], in radians: the inverse of
    /// [`from_roll_pitch_yaw`](Self::from_roll_pitch_yaw).
    ///
    /// Accurate to rounding up to the poles. At pitch ±π/2 only the sum or the difference of roll and yaw is defined:
    /// roll is then zero.
    pub fn roll_pitch_yaw(&self) -> (f64, f64, f64) {
        // With half angles a = roll/2, b = pitch/2, c = yaw/2 the quaternion gives
        //   (w + y, x - z) = (cos b + sin b) (cos(a - c), sin(a - c)),
        //   (w - y, x + z) = (cos b - sin b) (cos(a + c), sin(a + c)),
        // so no arc sine is needed, which would lose half of the digits near the poles.
        let q = self.0.quaternion();
        let (up, down) = ((q.w + q.j).hypot(q.i - q.k), (q.w - q.j).hypot(q.i + q.k));
        let pitch = 2.0 * up.atan2(down) - FRAC_PI_2;
        let (difference, sum) = ((q.i - q.k).atan2(q.w + q.j), (q.i + q.k).atan2(q.w - q.j));
        if down < POLE {
            (0.0, pitch, wrap_angle(-2.0 * difference))
        } else if up < POLE {
            (0.0, pitch, wrap_angle(2.0 * sum))
        } else {
            (wrap_angle(sum + difference), pitch, wrap_angle(sum - difference))
        }
    }

    /// The rotation that is nearest to a matrix, in the sense of the sum of squared differences of the entries (Horn et al.,
    /// *Closed-form solution of absolute orientation using orthonormal matrices*, 1988; Kabsch 1976), and how clearly it is: the
    /// least part of the matrix that tells it from its neighbours, beside the greatest, in [0, 2]. Where that is zero it is one of
    /// many. None for a matrix that is not finite.
    ///
    /// ```
    /// use agv_core::geometry::So3;
    ///
    /// let rotation = So3::from_roll_pitch_yaw(0.1, 0.2, 0.3);
    /// let (nearest, clearness) = So3::nearest(&(rotation.matrix() * 7.0)).unwrap();
    /// assert!((nearest.matrix() - rotation.matrix()).norm() < 1e-12 && clearness > 1.999);
    /// ```
    pub fn nearest(matrix: &Matrix3<f64>) -> Option<(Self, f64)> {
        if !matrix.iter().all(|entry| entry.is_finite()) {
            return None;
        }
        let svd = matrix.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        // A reflection would be nearer to mirrored or flat matrices: turn the weakest axis back.
        let mut sign = Vector3::repeat(1.0);
        let weakest = svd.singular_values.imin();
        sign[weakest] = (u.determinant() * v_t.determinant()).signum();
        let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&sign) * v_t);
        let greatest = svd.singular_values.max();
        let middle = svd.singular_values.sum() - greatest - svd.singular_values[weakest];
        let gap = (middle + sign[weakest] * svd.singular_values[weakest]).max(0.0);
        let clearness = if greatest > 0.0 { gap / greatest } else { 0.0 };
        Some((Self::from(UnitQuaternion::from_rotation_matrix(&rotation)), clearness))
    }

    /// The rotation as a 3x3 matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        self.0.to_rotation_matrix().into_inner()
    }
}

/// A rotation as it is stored: a unit quaternion.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
#[serde(transparent)]
struct RawSo3(Quaternion<f64>);

#[cfg(feature = "serde")]
impl TryFrom<RawSo3> for So3 {
    type Error = crate::Error;

    fn try_from(RawSo3(quaternion): RawSo3) -> Result<Self, crate::Error> {
        super::check_unit_norm("rotation", quaternion.norm_squared())?;
        Ok(Self(UnitQuaternion::new_unchecked(quaternion)))
    }
}

impl Sealed for So3 {}

impl LieGroup for So3 {
    const DOF: usize = 3;
    const TRANSLATION_DOF: usize = 0;
    type Tangent = Vector3<f64>;
    type Matrix = Matrix3<f64>;
    type Point = Vector3<f64>;
    type ActJacobian = Matrix3<f64>;
    type PointJacobian = Matrix3<f64>;

    fn identity() -> Self {
        Self::default()
    }

    #[inline]
    fn compose(&self, rhs: &Self) -> Self {
        let product = self.0.into_inner() * rhs.0.into_inner();
        // One Newton step towards unit length, as for `So2`.
        let scale = 1.5 - 0.5 * product.norm_squared();
        Self(UnitQuaternion::new_unchecked(product * scale))
    }

    #[inline]
    fn inverse(&self) -> Self {
        Self(self.0.inverse())
    }

    /// Eq. 132 in its quaternion form (Eq. 110).
    #[inline]
    fn exp(tangent: &Self::Tangent) -> Self {
        let half = 0.5 * tangent.norm();
        Self(UnitQuaternion::new_unchecked(Quaternion::from_parts(half.cos(), tangent * (0.5 * series::sinc(half)))))
    }

    /// Eq. 133 in its quaternion form (Eq. 111).
    #[inline]
    fn log(&self) -> Self::Tangent {
        // q and -q are one rotation: take the one with the shorter turn.
        let sign = if self.0.w < 0.0 { -1.0 } else { 1.0 };
        let (w, v) = (sign * self.0.w, self.0.vector() * sign);
        let norm = v.norm();
        let half = norm.atan2(w);
        v * (2.0 / if norm > 0.5 { norm / half } else { series::sinc(half) })
    }

    #[inline]
    fn act(&self, point: &Self::Point) -> Self::Point {
        self.0.transform_vector(point)
    }

    /// Eqs. 150 and 151.
    #[inline]
    fn act_jacobians(&self, point: &Self::Point) -> (Self::ActJacobian, Self::PointJacobian) {
        let rotation = self.matrix();
        (-rotation * skew(point), rotation)
    }

    /// Eq. 139.
    fn adjoint(&self) -> Self::Matrix {
        self.matrix()
    }

    /// Eq. 145.
    fn left_jacobian(tangent: &Self::Tangent) -> Self::Matrix {
        let angle = tangent.norm();
        let w = skew(tangent);
        Matrix3::identity() + w * series::one_minus_cos(angle) + w * w * series::x_minus_sin(angle)
    }

    /// Eq. 146.
    fn left_jacobian_inverse(tangent: &Self::Tangent) -> Self::Matrix {
        let w = skew(tangent);
        Matrix3::identity() - w * 0.5 + w * w * series::half_cot_remainder(tangent.norm())
    }

    tangent_space!();

    fn is_finite(&self) -> bool {
        self.0.coords.iter().all(|v| v.is_finite())
    }
}

impl Mul for So3 {
    type Output = Self;

    #[inline]
    fn mul(self, rhs: Self) -> Self {
        self.compose(&rhs)
    }
}

impl From<UnitQuaternion<f64>> for So3 {
    /// Takes a rotation that may have drifted from unit length a little one step back to it.
    fn from(rotation: UnitQuaternion<f64>) -> Self {
        let q = rotation.into_inner();
        Self(UnitQuaternion::new_unchecked(q * (1.5 - 0.5 * q.norm_squared())))
    }
}

impl From<So3> for UnitQuaternion<f64> {
    fn from(rotation: So3) -> Self {
        rotation.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// No other rotation is nearer, whether the matrix is a stretched rotation, a mirrored or a flat one.
        #[test]
        fn no_rotation_is_nearer_than_the_nearest(
            entries in prop::array::uniform9(-2.0..2.0_f64),
            flat in any::<bool>(),
            other in prop::array::uniform3(-3.0..3.0_f64),
        ) {
            let mut matrix = Matrix3::from_row_slice(&entries);
            if flat {
                matrix.fill_column(2, 0.0);
            }
            let (nearest, clearness) = So3::nearest(&matrix).unwrap();
            let off = |rotation: So3| (rotation.matrix() - matrix).norm_squared();
            let other = Vector3::from(other);
            for step in [other, other * 1e-3] {
                prop_assert!(off(nearest) <= off(nearest.plus(&step)) * (1.0 + 1e-12), "{step}");
            }
            prop_assert!((0.0..=2.0 + 1e-12).contains(&clearness));
        }
    }

    #[test]
    fn what_has_no_nearest_rotation_is_said() {
        assert!(So3::nearest(&Matrix3::repeat(f64::NAN)).is_none());
        // Along an axis nothing says how far to turn about it; a mirror in a point leaves every half turn.
        let axis = Matrix3::from_diagonal(&Vector3::new(3.0, 0.0, 0.0));
        for undecided in [Matrix3::zeros(), axis, -Matrix3::identity()] {
            let (rotation, clearness) = So3::nearest(&undecided).unwrap();
            assert!(rotation.is_finite() && clearness < 1e-12, "{undecided}");
        }
    }
}
