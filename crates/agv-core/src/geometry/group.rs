//! The contract that all groups share.

use crate::Error;
use std::fmt::Debug;
use std::ops::{Add, Mul, Neg, Sub};

/// Those methods of [`LieGroup`] that are the same for every group: its tangent space is one of vectors and matrices.
macro_rules! tangent_space {
    () => {
        #[inline]
        fn transpose(matrix: &Self::Matrix) -> Self::Matrix {
            matrix.transpose()
        }

        #[inline]
        fn outer(a: &Self::Tangent, b: &Self::Tangent) -> Self::Matrix {
            a * b.transpose()
        }

        fn check_covariance(name: &'static str, matrix: &Self::Matrix) -> Result<(), crate::Error> {
            crate::check::covariance(name, matrix)
        }

        fn identity_matrix() -> Self::Matrix {
            <Self::Matrix>::identity()
        }

        fn tangent_slice(tangent: &Self::Tangent) -> &[f64] {
            tangent.as_slice()
        }

        fn matrix_slice(matrix: &Self::Matrix) -> &[f64] {
            matrix.as_slice()
        }

        fn tangent_from_slice(entries: &[f64]) -> Self::Tangent {
            <Self::Tangent>::from_iterator(entries.iter().copied().chain(std::iter::repeat(0.0)))
        }

        fn matrix_from_slice(entries: &[f64]) -> Self::Matrix {
            <Self::Matrix>::from_iterator(entries.iter().copied().chain(std::iter::repeat(0.0)))
        }

        fn inverse_of(matrix: &Self::Matrix) -> Option<Self::Matrix> {
            let inverse = matrix.cholesky()?.inverse();
            inverse.iter().all(|v| v.is_finite()).then_some(inverse)
        }

        fn symmetric_eigen(matrix: &Self::Matrix) -> Option<(Self::Tangent, Self::Matrix)> {
            if !matrix.iter().all(|v| v.is_finite()) {
                return None;
            }
            let eigen = matrix.symmetric_eigen();
            Some((eigen.eigenvalues, eigen.eigenvectors))
        }
    };
}
pub(super) use tangent_space;

pub(super) mod sealed {
    /// Only the groups of this crate implement [`LieGroup`](super::LieGroup): their laws are tested here.
    pub trait Sealed {}
}

/// A Lie group of rotations or rigid motions, with right increments.
///
/// Implemented by [`So2`](super::So2), [`Se2`](super::Se2), [`So3`](super::So3) and [`Se3`](super::Se3). Methods are
/// small and inlined: write algorithms generically where they hold for every group (pose graphs, averages, covariance
/// transport), and concretely where they do not.
///
/// Equation numbers are those of Solà et al., *A micro Lie theory for state estimation in robotics*.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2};
///
/// fn midpoint<G: LieGroup>(a: &G, b: &G) -> G {
///     a.plus(&(b.minus(a) * 0.5))
/// }
/// let middle = midpoint(&Se2::new(0.0, 0.0, 3.0), &Se2::new(0.0, 0.0, -3.0));
/// assert!((middle.yaw().abs() - std::f64::consts::PI).abs() < 1e-12);
/// ```
pub trait LieGroup: Copy + Debug + PartialEq + Default + Send + Sync + sealed::Sealed + 'static {
    /// Degrees of freedom.
    const DOF: usize;
    /// Entries of a tangent that are translation, in metres; they come first.
    const TRANSLATION_DOF: usize;
    /// Vector of `DOF` entries, translation first.
    type Tangent: Copy
        + Debug
        + PartialEq
        + Send
        + Sync
        + Add<Output = Self::Tangent>
        + Sub<Output = Self::Tangent>
        + Neg<Output = Self::Tangent>
        + Mul<f64, Output = Self::Tangent>;
    /// Square matrix over the tangent space: a Jacobian or a covariance.
    type Matrix: Copy
        + Debug
        + PartialEq
        + Send
        + Sync
        + Add<Output = Self::Matrix>
        + Sub<Output = Self::Matrix>
        + Neg<Output = Self::Matrix>
        + Mul<f64, Output = Self::Matrix>
        + Mul<Output = Self::Matrix>
        + Mul<Self::Tangent, Output = Self::Tangent>;
    /// Point that the group acts on, in metres.
    type Point: Copy + Debug + PartialEq + Send + Sync;
    /// Jacobian of a moved point with respect to the motion: one row per coordinate, `DOF` columns.
    type ActJacobian: Copy + Debug + PartialEq + Send + Sync;
    /// Jacobian of a moved point with respect to the point: square.
    type PointJacobian: Copy + Debug + PartialEq + Send + Sync;

    /// The motion that moves nothing.
    fn identity() -> Self;

    /// `self ∘ rhs`: first `rhs`, then `self`. `a_from_c = a_from_b.compose(&b_from_c)`.
    fn compose(&self, rhs: &Self) -> Self;

    /// The motion that undoes this one.
    fn inverse(&self) -> Self;

    /// Exponential map (Eq. 23).
    fn exp(tangent: &Self::Tangent) -> Self;

    /// Logarithm (Eq. 24): the shortest tangent whose exponential this is; at half a turn one of the two.
    fn log(&self) -> Self::Tangent;

    /// The point of the source frame, seen in the target frame.
    fn act(&self, point: &Self::Point) -> Self::Point;

    /// Jacobians of [`act`](Self::act): with respect to the motion and to the point (Eqs. 130, 150, 166 and 182).
    fn act_jacobians(&self, point: &Self::Point) -> (Self::ActJacobian, Self::PointJacobian);

    /// Ad, the matrix that moves tangents from the source to the target frame (Eq. 29):
    /// `x ∘ exp(τ) = exp(Ad τ) ∘ x`.
    fn adjoint(&self) -> Self::Matrix;

    /// Jl(τ), left Jacobian of the exponential (Eq. 71).
    fn left_jacobian(tangent: &Self::Tangent) -> Self::Matrix;

    /// Inverse of [`left_jacobian`](Self::left_jacobian). Singular at rotations by multiples of a full turn but zero.
    fn left_jacobian_inverse(tangent: &Self::Tangent) -> Self::Matrix;

    /// Transpose of a tangent-space matrix.
    fn transpose(matrix: &Self::Matrix) -> Self::Matrix;

    /// `a bᵀ`, the product of two tangents that covariances are sums of.
    fn outer(a: &Self::Tangent, b: &Self::Tangent) -> Self::Matrix;

    /// Accepts a symmetric, positive semi-definite tangent-space matrix: [`check::covariance`](crate::check::covariance).
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::NotCovariance`].
    fn check_covariance(name: &'static str, matrix: &Self::Matrix) -> Result<(), Error>;

    /// The unit matrix of the tangent space.
    fn identity_matrix() -> Self::Matrix;

    /// Entries of a tangent, in order.
    fn tangent_slice(tangent: &Self::Tangent) -> &[f64];

    /// Entries of a tangent-space matrix, column by column.
    fn matrix_slice(matrix: &Self::Matrix) -> &[f64];

    /// A tangent from `DOF` entries; missing ones are zero.
    fn tangent_from_slice(entries: &[f64]) -> Self::Tangent;

    /// A tangent-space matrix from `DOF²` entries, column by column; missing ones are zero.
    fn matrix_from_slice(entries: &[f64]) -> Self::Matrix;

    /// Inverse of a symmetric, positive definite tangent-space matrix: information from a covariance, and back. `None`
    /// if it is not definite or not finite; of an asymmetric one the lower half counts.
    ///
    /// ```
    /// use agv_core::geometry::{LieGroup, Se2};
    ///
    /// let covariance = Se2::matrix_from_slice(&[0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.25]);
    /// let information = Se2::inverse_of(&covariance).unwrap();
    /// assert!((information[(1, 1)] - 100.0).abs() < 1e-12);
    /// assert_eq!(Se2::inverse_of(&-covariance), None);
    /// ```
    fn inverse_of(matrix: &Self::Matrix) -> Option<Self::Matrix>;

    /// Eigenvalues of a symmetric tangent-space matrix, in no order, and its eigenvectors, in the columns. `None` if it is
    /// not finite.
    fn symmetric_eigen(matrix: &Self::Matrix) -> Option<(Self::Tangent, Self::Matrix)>;

    /// Whether all numbers in it are finite.
    fn is_finite(&self) -> bool;

    /// Jr(τ) = Jl(-τ), right Jacobian of the exponential (Eqs. 67 and 76).
    #[inline]
    fn right_jacobian(tangent: &Self::Tangent) -> Self::Matrix {
        Self::left_jacobian(&-*tangent)
    }

    /// Inverse of [`right_jacobian`](Self::right_jacobian); the Jacobian of [`log`](Self::log) (Eq. 79).
    #[inline]
    fn right_jacobian_inverse(tangent: &Self::Tangent) -> Self::Matrix {
        Self::left_jacobian_inverse(&-*tangent)
    }

    /// `self ⊕ tangent = self ∘ exp(tangent)` (Eq. 25).
    #[inline]
    fn plus(&self, tangent: &Self::Tangent) -> Self {
        self.compose(&Self::exp(tangent))
    }

    /// `self ⊖ origin = log(origin⁻¹ ∘ self)` (Eq. 26): the tangent at `origin` that leads to `self`.
    #[inline]
    fn minus(&self, origin: &Self) -> Self::Tangent {
        origin.between(self).log()
    }

    /// `self⁻¹ ∘ other`: with `world_from_a.between(&world_from_b)` the pose `a_from_b`.
    #[inline]
    fn between(&self, other: &Self) -> Self {
        self.inverse().compose(other)
    }

    /// Jacobians of [`compose`](Self::compose): with respect to `self` (Eq. 64, `Ad(rhs)⁻¹`) and to `rhs` (Eq. 65, the
    /// unit matrix).
    ///
    /// Here and below a Jacobian maps the right increment of an argument to that of the result.
    ///
    /// ```
    /// use agv_core::geometry::{LieGroup, Se2};
    /// use agv_core::nalgebra::Vector3;
    ///
    /// let (a, b) = (Se2::new(1.0, 2.0, 0.5), Se2::new(0.3, -0.1, 1.2));
    /// let step = Vector3::new(1e-6, -2e-6, 3e-6);
    /// let (by_a, _) = a.compose_jacobians(&b);
    /// let moved = a.plus(&step).compose(&b).minus(&a.compose(&b));
    /// assert!((moved - by_a * step).norm() < 1e-15);
    /// ```
    #[inline]
    fn compose_jacobians(&self, rhs: &Self) -> (Self::Matrix, Self::Matrix) {
        (rhs.inverse().adjoint(), Self::identity_matrix())
    }

    /// Jacobian of [`inverse`](Self::inverse): `-Ad` (Eq. 62).
    #[inline]
    fn inverse_jacobian(&self) -> Self::Matrix {
        -self.adjoint()
    }

    /// Jacobians of [`between`](Self::between): with respect to `self` (`-Ad(other⁻¹ ∘ self)`) and to `other` (the unit
    /// matrix).
    #[inline]
    fn between_jacobians(&self, other: &Self) -> (Self::Matrix, Self::Matrix) {
        (-other.between(self).adjoint(), Self::identity_matrix())
    }

    /// Jacobian of [`log`](Self::log): `Jr⁻¹(log self)` (Eq. 79).
    #[inline]
    fn log_jacobian(&self) -> Self::Matrix {
        Self::right_jacobian_inverse(&self.log())
    }

    /// The motion a `fraction` of the way to `other` along the geodesic: 0 gives `self`, 1 gives `other`.
    #[inline]
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        self.plus(&(other.minus(self) * fraction))
    }
}
