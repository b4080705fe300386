//! Rigid motions of the plane: the poses of a vehicle on a floor.

use super::{
    LieGroup, So2,
    group::{sealed::Sealed, tangent_space},
    series,
};
use nalgebra::{Isometry2, Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};
use std::ops::Mul;

/// A rigid motion of the plane, or the pose of one frame in another.
///
/// Named `target_from_source`: it maps points of the source frame into the target frame.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2};
/// use agv_core::nalgebra::{Vector2, Vector3};
///
/// let map_from_base = Se2::new(2.0, 1.0, std::f64::consts::FRAC_PI_2);
/// let obstacle_in_map = map_from_base.act(&Vector2::new(1.0, 0.0));
/// assert!((obstacle_in_map - Vector2::new(2.0, 2.0)).norm() < 1e-12);
///
/// // A quarter turn to the left on a circle of 1 m radius: 90° of arc.
/// let arc = Se2::exp(&Vector3::new(std::f64::consts::FRAC_PI_2, 0.0, std::f64::consts::FRAC_PI_2));
/// assert!((arc.translation() - Vector2::new(1.0, 1.0)).norm() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSe2"))]
pub struct Se2 {
    translation: Vector2<f64>,
    rotation: So2,
}

impl Se2 {
    /// The pose at `(x, y)` metres with heading `yaw` radians.
    #[inline]
    pub fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self::from_parts(Vector2::new(x, y), So2::from_angle(yaw))
    }

    /// The pose with this translation, in metres, and rotation.
    #[inline]
    pub const fn from_parts(translation: Vector2<f64>, rotation: So2) -> Self {
        Self { translation, rotation }
    }

    /// Origin of the source frame along the target's x, in metres.
    #[inline]
    pub fn x(&self) -> f64 {
        self.translation.x
    }

    /// Origin of the source frame along the target's y, in metres.
    #[inline]
    pub fn y(&self) -> f64 {
        self.translation.y
    }

    /// Adjoint of its rotation alone: it turns the translation of an increment to the axes of the target, and leaves its turn.
    #[inline]
    pub fn rotation_adjoint(&self) -> Matrix3<f64> {
        let (cos, sin) = (self.rotation.cos(), self.rotation.sin());
        Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
    }

    /// Heading in [-π, π].
    #[inline]
    pub fn yaw(&self) -> f64 {
        self.rotation.angle()
    }

    /// Origin of the source frame in the target frame, in metres.
    #[inline]
    pub const fn translation(&self) -> Vector2<f64> {
        self.translation
    }

    /// Rotation from the source to the target frame.
    #[inline]
    pub const fn rotation(&self) -> So2 {
        self.rotation
    }
}

/// A pose as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSe2 {
    translation: Vector2<f64>,
    rotation: So2,
}

#[cfg(feature = "serde")]
impl TryFrom<RawSe2> for Se2 {
    type Error = crate::Error;

    fn try_from(raw: RawSe2) -> Result<Self, crate::Error> {
        crate::check::all_finite("translation", raw.translation.iter())?;
        Ok(Self::from_parts(raw.translation, raw.rotation))
    }
}

impl Sealed for Se2 {}

impl LieGroup for Se2 {
    const DOF: usize = 3;
    const TRANSLATION_DOF: usize = 2;
    type Tangent = Vector3<f64>;
    type Matrix = Matrix3<f64>;
    type Point = Vector2<f64>;
    type ActJacobian = Matrix2x3<f64>;
    type PointJacobian = Matrix2<f64>;

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

    /// Eq. 156; a body twist held constant, so the arc of an ideal vehicle.
    #[inline]
    fn exp(tangent: &Self::Tangent) -> Self {
        let yaw = tangent.z;
        // Sine and cosine of the half angle give all four terms without cancellation, from one evaluation.
        let (sin, cos) = (0.5 * yaw).sin_cos();
        let rotation = So2::from_half_angle(cos, sin);
        // sin yaw / yaw and (1 - cos yaw) / yaw
        let (a, b) = if yaw.abs() < 1e-150 { (1.0, 0.0) } else { (rotation.sin() / yaw, 2.0 * sin * sin / yaw) };
        let (x, y) = (tangent.x, tangent.y);
        Self { translation: Vector2::new(a * x - b * y, b * x + a * y), rotation }
    }

    /// Eq. 157.
    #[inline]
    fn log(&self) -> Self::Tangent {
        let yaw = self.yaw();
        let (cos, sin) = (self.rotation.cos(), self.rotation.sin());
        // yaw/2 cot(yaw/2), by the form of the cotangent that does not cancel on this side of the circle.
        let a = if cos < 0.0 {
            0.5 * yaw * sin / (1.0 - cos)
        } else if sin.abs() < 1e-150 {
            1.0
        } else {
            0.5 * yaw * (1.0 + cos) / sin
        };
        let b = 0.5 * yaw;
        let t = self.translation;
        Vector3::new(a * t.x + b * t.y, a * t.y - b * t.x, yaw)
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

    /// Eqs. 166 and 167.
    #[inline]
    fn act_jacobians(&self, point: &Self::Point) -> (Self::ActJacobian, Self::PointJacobian) {
        let (c, s) = (self.rotation.cos(), self.rotation.sin());
        let rotated = self.rotation.act(point);
        (Matrix2x3::new(c, -s, -rotated.y, s, c, rotated.x), Matrix2::new(c, -s, s, c))
    }

    /// Eq. 159.
    #[inline]
    fn adjoint(&self) -> Self::Matrix {
        let (c, s) = (self.rotation.cos(), self.rotation.sin());
        Matrix3::new(c, -s, self.translation.y, s, c, -self.translation.x, 0.0, 0.0, 1.0)
    }

    /// Eq. 164.
    fn left_jacobian(tangent: &Self::Tangent) -> Self::Matrix {
        let yaw = tangent.z;
        let (a, b) = (series::sinc(yaw), yaw * series::one_minus_cos(yaw));
        let (c, d) = (series::one_minus_cos(yaw), yaw * series::x_minus_sin(yaw));
        Matrix3::new(a, -b, d * tangent.x + c * tangent.y, b, a, d * tangent.y - c * tangent.x, 0.0, 0.0, 1.0)
    }

    fn left_jacobian_inverse(tangent: &Self::Tangent) -> Self::Matrix {
        // Block inverse: the translation block is the V of Eq. 158, whose inverse is known in closed form.
        let (a, b) = (series::half_cot(tangent.z), 0.5 * tangent.z);
        let jacobian = Self::left_jacobian(tangent);
        let (u, v) = (jacobian.m13, jacobian.m23);
        Matrix3::new(a, b, -(a * u + b * v), -b, a, b * u - a * v, 0.0, 0.0, 1.0)
    }

    tangent_space!();

    fn is_finite(&self) -> bool {
        self.translation.iter().all(|v| v.is_finite()) && self.rotation.is_finite()
    }
}

impl Mul for Se2 {
    type Output = Self;

    #[inline]
    fn mul(self, rhs: Self) -> Self {
        self.compose(&rhs)
    }
}

impl Mul<Vector2<f64>> for Se2 {
    type Output = Vector2<f64>;

    #[inline]
    fn mul(self, point: Vector2<f64>) -> Vector2<f64> {
        self.act(&point)
    }
}

impl From<Isometry2<f64>> for Se2 {
    fn from(isometry: Isometry2<f64>) -> Self {
        Self::from_parts(isometry.translation.vector, isometry.rotation.into())
    }
}

impl From<Se2> for Isometry2<f64> {
    fn from(pose: Se2) -> Self {
        Self::from_parts(pose.translation.into(), pose.rotation.into())
    }
}
