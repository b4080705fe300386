//! Rotations of the plane, as unit complex numbers.

use super::{
    LieGroup,
    group::{sealed::Sealed, tangent_space},
};
use nalgebra::{Matrix1, Matrix2, UnitComplex, Vector1, Vector2};
use std::ops::Mul;

/// A rotation of the plane.
///
/// Stored as cosine and sine, so that composing and rotating points need no trigonometry.
///
/// ```
/// use agv_core::geometry::{LieGroup, So2};
/// use agv_core::nalgebra::Vector2;
///
/// let quarter = So2::from_angle(std::f64::consts::FRAC_PI_2);
/// assert!((quarter.act(&Vector2::x()) - Vector2::y()).norm() < 1e-12);
/// assert!((quarter.compose(&quarter).angle() - std::f64::consts::PI).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSo2"))]
pub struct So2 {
    cos: f64,
    sin: f64,
}

impl So2 {
    /// The rotation by `angle` radians, counter-clockwise.
    #[inline]
    pub fn from_angle(angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { cos, sin }
    }

    /// The rotation by twice the angle with this cosine and sine.
    #[inline]
    pub(super) fn from_half_angle(cos: f64, sin: f64) -> Self {
        Self { cos: 1.0 - 2.0 * sin * sin, sin: 2.0 * sin * cos }
    }

    /// The rotation that turns the x axis towards `(x, y)`; identity for the zero vector.
    #[inline]
    pub fn from_direction(x: f64, y: f64) -> Self {
        let norm = x.hypot(y);
        if norm > 0.0 { Self { cos: x / norm, sin: y / norm } } else { Self::default() }
    }

    /// Angle in [-π, π], counter-clockwise.
    #[inline]
    pub fn angle(&self) -> f64 {
        self.sin.atan2(self.cos)
    }

    /// Cosine of the angle.
    #[inline]
    pub const fn cos(&self) -> f64 {
        self.cos
    }

    /// Sine of the angle.
    #[inline]
    pub const fn sin(&self) -> f64 {
        self.sin
    }
}

impl Default for So2 {
    fn default() -> Self {
        Self { cos: 1.0, sin: 0.0 }
    }
}

/// A rotation as it is stored. An angle would not do: its sine and cosine need not round back to the same bits.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSo2 {
    cos: f64,
    sin: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawSo2> for So2 {
    type Error = crate::Error;

    fn try_from(raw: RawSo2) -> Result<Self, crate::Error> {
        super::check_unit_norm("rotation", raw.cos * raw.cos + raw.sin * raw.sin)?;
        Ok(Self { cos: raw.cos, sin: raw.sin })
    }
}

impl Sealed for So2 {}

impl LieGroup for So2 {
    const DOF: usize = 1;
    const TRANSLATION_DOF: usize = 0;
    type Tangent = Vector1<f64>;
    type Matrix = Matrix1<f64>;
    type Point = Vector2<f64>;
    type ActJacobian = Vector2<f64>;
    type PointJacobian = Matrix2<f64>;

    fn identity() -> Self {
        Self::default()
    }

    #[inline]
    fn compose(&self, rhs: &Self) -> Self {
        let cos = self.cos * rhs.cos - self.sin * rhs.sin;
        let sin = self.sin * rhs.cos + self.cos * rhs.sin;
        // One Newton step towards unit length: long chains would drift otherwise.
        let scale = 1.5 - 0.5 * (cos * cos + sin * sin);
        Self { cos: cos * scale, sin: sin * scale }
    }

    #[inline]
    fn inverse(&self) -> Self {
        Self { cos: self.cos, sin: -self.sin }
    }

    #[inline]
    fn exp(tangent: &Self::Tangent) -> Self {
        Self::from_angle(tangent.x)
    }

    #[inline]
    fn log(&self) -> Self::Tangent {
        Vector1::new(self.angle())
    }

    #[inline]
    fn act(&self, point: &Self::Point) -> Self::Point {
        Vector2::new(self.cos * point.x - self.sin * point.y, self.sin * point.x + self.cos * point.y)
    }

    /// Eqs. 129 and 130.
    #[inline]
    fn act_jacobians(&self, point: &Self::Point) -> (Self::ActJacobian, Self::PointJacobian) {
        let rotated = self.act(point);
        (Vector2::new(-rotated.y, rotated.x), Matrix2::new(self.cos, -self.sin, self.sin, self.cos))
    }

    fn adjoint(&self) -> Self::Matrix {
        Matrix1::identity()
    }

    fn left_jacobian(_: &Self::Tangent) -> Self::Matrix {
        Matrix1::identity()
    }

    fn left_jacobian_inverse(_: &Self::Tangent) -> Self::Matrix {
        Matrix1::identity()
    }

    tangent_space!();

    fn is_finite(&self) -> bool {
        self.cos.is_finite() && self.sin.is_finite()
    }
}

impl Mul for So2 {
    type Output = Self;

    #[inline]
    fn mul(self, rhs: Self) -> Self {
        self.compose(&rhs)
    }
}

impl From<f64> for So2 {
    fn from(angle: f64) -> Self {
        Self::from_angle(angle)
    }
}

impl From<So2> for f64 {
    fn from(rotation: So2) -> Self {
        rotation.angle()
    }
}

impl From<UnitComplex<f64>> for So2 {
    /// Takes a rotation that may have drifted from unit length a little one step back to it.
    fn from(rotation: UnitComplex<f64>) -> Self {
        let scale = 1.5 - 0.5 * (rotation.re * rotation.re + rotation.im * rotation.im);
        Self { cos: rotation.re * scale, sin: rotation.im * scale }
    }
}

impl From<So2> for UnitComplex<f64> {
    fn from(rotation: So2) -> Self {
        Self::from_cos_sin_unchecked(rotation.cos, rotation.sin)
    }
}
