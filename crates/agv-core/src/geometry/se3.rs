//! Rigid motions of space: the poses of sensors, and of vehicles on ramps.

use super::{
    LieGroup, Se2, So3,
    group::{sealed::Sealed, tangent_space},
    series,
    so3::skew,
};
use nalgebra::{Isometry3, Matrix3, Matrix3x6, Matrix6, Vector2, Vector3, Vector6};
use std::ops::Mul;

/// A rigid motion of space, or the pose of one frame in another.
///
/// Named `target_from_source`, as [`Se2`].
///
/// ```
/// use agv_core::geometry::{LieGroup, Se3, So3};
/// use agv_core::nalgebra::Vector3;
///
/// // A lidar 2 m up, pitched down by 10°.
/// let base_from_lidar = Se3::from_parts(Vector3::new(0.3, 0.0, 2.0), So3::from_roll_pitch_yaw(0.0, 10_f64.to_radians(), 0.0));
/// let floor = base_from_lidar.act(&Vector3::new(2.0 / 10_f64.to_radians().sin(), 0.0, 0.0));
/// assert!(floor.z.abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSe3"))]
pub struct Se3 {
    translation: Vector3<f64>,
    rotation: So3,
}

impl Se3 {
    /// The pose with this translation, in metres, and rotation.
    #[inline]
    pub const fn from_parts(translation: Vector3<f64>, rotation: So3) -> Self {
        Self { translation, rotation }
    }

    /// Origin of the source frame in the target frame, in metres.
    #[inline]
    pub const fn translation(&self) -> Vector3<f64> {
        self.translation
    }

    /// Rotation from the source to the target frame.
    #[inline]
    pub const fn rotation(&self) -> So3 {
        self.rotation
    }

    /// The pose seen from above: x, y and yaw.
    pub fn to_planar(&self) -> Se2 {
        let (_, _, yaw) = self.rotation.roll_pitch_yaw();
        Se2::new(self.translation.x, self.translation.y, yaw)
    }
}

/// A 6x6 matrix with the same block on the diagonal and one block above it.
fn upper(diagonal: &Matrix3<f64>, corner: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(diagonal);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(corner);
    matrix
}

/// Q(ρ, θ) of Eq. 180 (Barfoot 2017, Eq. 7.86).
fn q_block(rho: &Vector3<f64>, theta: &Vector3<f64>) -> Matrix3<f64> {
    let angle = theta.norm();
    let (v, w) = (skew(rho), skew(theta));
    let (wv, vw) = (w * v, v * w);
    let wvw = wv * w;
    let a = series::x_minus_sin(angle);
    let b = series::cos_remainder(angle);
    let c = 0.5 * (b - 3.0 * series::sin_remainder(angle));
    v * 0.5 + (wv + vw + wvw) * a + (w * wv + vw * w - wvw * 3.0) * b + (wvw * w + w * wvw) * c
}

/// A pose as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSe3 {
    translation: Vector3<f64>,
    rotation: So3,
}

#[cfg(feature = "serde")]
impl TryFrom<RawSe3> for Se3 {
    type Error = crate::Error;

    fn try_from(raw: RawSe3) -> Result<Self, crate::Error> {
        crate::check::all_finite("translation", raw.translation.iter())?;
        Ok(Self::from_parts(raw.translation, raw.rotation))
    }
}

impl Sealed for Se3 {}

impl LieGroup for Se3 {
    const DOF: usize = 6;
    const TRANSLATION_DOF: usize = 3;
    type Tangent = Vector6<f64>;
    type Matrix = Matrix6<f64>;
    type Point = Vector3<f64>;
    type ActJacobian = Matrix3x6<f64>;
    type PointJacobian = Matrix3<f64>;

    fn identity() -> Self {
        Self::default()
    }

    #[inline]
    fn compose(&self, rhs: &Self) -> Self {
        Self { translation: self.act(&rhs.translation), rotation: self.rotation.compose(&rhs.rotation) }
    }

    #[inline]
    fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { translation: -rotation.act(&self.translation), rotation }
    }

    /// Eq. 172.
    fn exp(tangent: &Self::Tangent) -> Self {
        let (rho, theta) = (tangent.fixed_rows::<3>(0).into_owned(), tangent.fixed_rows::<3>(3).into_owned());
        Self { translation: So3::left_jacobian(&theta) * rho, rotation: So3::exp(&theta) }
    }

    /// Eq. 173.
    fn log(&self) -> Self::Tangent {
        let theta = self.rotation.log();
        let rho = So3::left_jacobian_inverse(&theta) * self.translation;
        Vector6::new(rho.x, rho.y, rho.z, theta.x, theta.y, theta.z)
    }

    /// Subtracts the translations before it turns them: far from the origin the general form would cancel.
    #[inline]
    fn between(&self, other: &Self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            translation: rotation.act(&(other.translation - self.translation)),
            rotation: rotation.compose(&other.rotation),
        }
    }

    #[inline]
    fn act(&self, point: &Self::Point) -> Self::Point {
        self.rotation.act(point) + self.translation
    }

    /// Eqs. 182 and 183.
    fn act_jacobians(&self, point: &Self::Point) -> (Self::ActJacobian, Self::PointJacobian) {
        let rotation = self.rotation.matrix();
        let mut pose = Matrix3x6::zeros();
        pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-rotation * skew(point)));
        (pose, rotation)
    }

    /// Eq. 175.
    fn adjoint(&self) -> Self::Matrix {
        let rotation = self.rotation.matrix();
        upper(&rotation, &(skew(&self.translation) * rotation))
    }

    /// Eq. 179.
    fn left_jacobian(tangent: &Self::Tangent) -> Self::Matrix {
        let (rho, theta) = (tangent.fixed_rows::<3>(0).into_owned(), tangent.fixed_rows::<3>(3).into_owned());
        upper(&So3::left_jacobian(&theta), &q_block(&rho, &theta))
    }

    /// Eq. 181.
    fn left_jacobian_inverse(tangent: &Self::Tangent) -> Self::Matrix {
        let (rho, theta) = (tangent.fixed_rows::<3>(0).into_owned(), tangent.fixed_rows::<3>(3).into_owned());
        let inverse = So3::left_jacobian_inverse(&theta);
        upper(&inverse, &(-inverse * q_block(&rho, &theta) * inverse))
    }

    tangent_space!();

    fn is_finite(&self) -> bool {
        self.translation.iter().all(|v| v.is_finite()) && self.rotation.is_finite()
    }
}

impl Mul for Se3 {
    type Output = Self;

    #[inline]
    fn mul(self, rhs: Self) -> Self {
        self.compose(&rhs)
    }
}

impl Mul<Vector3<f64>> for Se3 {
    type Output = Vector3<f64>;

    #[inline]
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.act(&point)
    }
}

impl From<Se2> for Se3 {
    /// The planar pose on the floor: z, roll and pitch are zero.
    fn from(pose: Se2) -> Self {
        let t: Vector2<f64> = pose.translation();
        Self::from_parts(Vector3::new(t.x, t.y, 0.0), So3::from_roll_pitch_yaw(0.0, 0.0, pose.yaw()))
    }
}

impl From<Isometry3<f64>> for Se3 {
    fn from(isometry: Isometry3<f64>) -> Self {
        Self::from_parts(isometry.translation.vector, isometry.rotation.into())
    }
}

impl From<Se3> for Isometry3<f64> {
    fn from(pose: Se3) -> Self {
        Self::from_parts(pose.translation.into(), pose.rotation.into())
    }
}
