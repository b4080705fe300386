//! The points of a voxel as a normal distribution.
//!
//! Magnusson, *The three-dimensional normal distributions transform* (thesis, Örebro 2009), section 6.1: the points `p_i` of
//! a voxel give
//!
//! ```text
//! mean = Σ p_i / n          covariance = Σ (p_i - mean) (p_i - mean)ᵀ / (n - 1)
//! ```
//!
//! and eigenvalues below a share of the greatest are raised to it, since the points of a wall have a singular covariance.
//!
//! Sums are kept in whole multiples of 2⁻¹⁶ voxels from the voxel's corner, and of their products: integers add in any order to
//! the same bits, so that maps of many vehicles' logs may be merged in any order.

use crate::eigen::SymmetricEigen;
use agv_core::check;
use nalgebra::{Matrix3, Vector3};

/// Steps per voxel along an edge.
pub(crate) const STEPS: f64 = 65_536.0;

/// Sums over the points of one voxel; adding two is exact, and so associative to the bit.
///
/// Offsets from the voxel's corner are counted in 2⁻¹⁶ voxels: products are below 2³², so that 2³² points fit. The sums stop
/// there, all together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct VoxelSums {
    count: u32,
    linear: [u64; 3],
    /// xx, xy, xz, yy, yz, zz.
    products: [u64; 6],
}

impl VoxelSums {
    /// Points in the voxel.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Adds all points of another; nothing if both together are more than 2³² - 1.
    pub fn merge(&mut self, other: &Self) {
        if let Some(count) = self.count.checked_add(other.count) {
            self.count = count;
            for (own, theirs) in self.linear.iter_mut().zip(other.linear) {
                *own = own.saturating_add(theirs);
            }
            for (own, theirs) in self.products.iter_mut().zip(other.products) {
                *own = own.saturating_add(theirs);
            }
        }
    }

    /// Adds a point, given in steps from the corner, each below 2¹⁶.
    #[inline]
    pub(crate) fn add(&mut self, [x, y, z]: [u32; 3]) {
        if let Some(count) = self.count.checked_add(1) {
            self.count = count;
            let (x, y, z) = (u64::from(x), u64::from(y), u64::from(z));
            for (sum, value) in self.linear.iter_mut().zip([x, y, z]) {
                *sum += value;
            }
            for (sum, value) in self.products.iter_mut().zip([x * x, x * y, x * z, y * y, y * z, z * z]) {
                *sum += value;
            }
        }
    }

    /// The sums of the same points from a corner that is `shift` voxels before this one, in every direction.
    pub(crate) fn shifted(&self, shift: [u64; 3]) -> Self {
        let n = u64::from(self.count);
        let [x, y, z] = self.linear;
        let [a, b, c] = shift.map(|voxels| voxels * STEPS as u64);
        let [xx, xy, xz, yy, yz, zz] = self.products;
        Self {
            count: self.count,
            linear: [x + a * n, y + b * n, z + c * n],
            products: [
                xx + 2 * a * x + a * a * n,
                xy + a * y + b * x + a * b * n,
                xz + a * z + c * x + a * c * n,
                yy + 2 * b * y + b * b * n,
                yz + b * z + c * y + b * c * n,
                zz + 2 * c * z + c * c * n,
            ],
        }
    }

    /// Mean, and scatter `Σ (p - mean)(p - mean)ᵀ`, in voxels from the corner; none without points.
    pub(crate) fn moments(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let n = i128::from(self.count);
        if n == 0 {
            return None;
        }
        let scale = 1.0 / (n as f64 * STEPS * STEPS);
        let [x, y, z] = self.linear;
        let [xx, xy, xz, yy, yz, zz] = self.products;
        // n Σ xy - Σ x Σ y is exact in integers, where the difference of rounded sums would cancel. All products are at most the
        // greatest n Σ xx (Cauchy), which mostly needs 64 bits alone.
        let bits = |value: u64| u64::BITS - value.leading_zeros();
        let short = bits(u64::from(self.count)) + bits(xx.max(yy).max(zz)) < u64::BITS - 1;
        let scatter = |sum: u64, a: u64, b: u64| {
            let difference = if short {
                (i64::from(self.count) * sum as i64 - a as i64 * b as i64) as f64
            } else {
                (n * i128::from(sum) - i128::from(a) * i128::from(b)) as f64
            };
            difference * scale
        };
        let (xy, xz, yz) = (scatter(xy, x, y), scatter(xz, x, z), scatter(yz, y, z));
        let matrix = Matrix3::new(scatter(xx, x, x), xy, xz, xy, scatter(yy, y, y), yz, xz, yz, scatter(zz, z, z));
        // A point lies somewhere in its step: half a step on average.
        let mean = Vector3::new(x as f64, y as f64, z as f64) / (n as f64 * STEPS) + Vector3::repeat(0.5 / STEPS);
        Some((mean, matrix))
    }
}

/// How the distribution of a voxel is made from its points.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct VoxelParams {
    /// Edge of the voxels, in metres.
    pub resolution: f64,
    /// Voxels with fewer points have no distribution; at least 3.
    pub min_points: u32,
    /// Least ratio of an eigenvalue to the greatest, in (0, 1].
    pub min_eigenvalue_ratio: f64,
    /// Least standard deviation along any direction, in metres.
    pub min_sigma: f64,
}

impl Default for VoxelParams {
    /// Voxels of 1 m and an eigenvalue ratio of 0.01 (Magnusson 2009, section 6.3; paper 003), and 1 cm, the noise of a good
    /// lidar. Eight points and not PCL's six: a voxel that a beam grazes has a surface that is none.
    fn default() -> Self {
        Self { resolution: 1.0, min_points: 8, min_eigenvalue_ratio: 0.01, min_sigma: 0.01 }
    }
}

impl VoxelParams {
    /// Checks every field.
    pub(crate) fn validate(&self) -> Result<(), agv_core::Error> {
        check::in_range("resolution", self.resolution, 0.01, 1000.0)?;
        check::at_least("min_points", self.min_points as usize, 3)?;
        check::positive("min_eigenvalue_ratio", self.min_eigenvalue_ratio)?;
        check::in_range("min_eigenvalue_ratio", self.min_eigenvalue_ratio, 0.0, 1.0)?;
        check::positive("min_sigma", self.min_sigma)?;
        Ok(())
    }
}

/// A normal distribution in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaussian3 {
    /// Mean, in metres.
    pub mean: Vector3<f64>,
    /// Covariance, in square metres.
    pub covariance: Matrix3<f64>,
    /// Inverse of the covariance.
    pub information: Matrix3<f64>,
}

/// The covariance with eigenvalues raised to `ratio` of the greatest and to `least`, and its inverse.
///
/// Eigenvalues by the trigonometric formula (Smith 1961). Only the direction that is raised, or the one that is not, is needed as
/// a vector, and a cross product gives it; where two eigenvalues are too close for that, Jacobi's rotations do.
pub(crate) fn regularized(covariance: &Matrix3<f64>, ratio: f64, least: f64) -> (Matrix3<f64>, Matrix3<f64>) {
    let [low, middle, high] = eigenvalues(covariance);
    let limit = (ratio * high).max(least);
    let raised = if low >= limit {
        Some(*covariance)
    } else if middle >= limit {
        // A surface: its normal is raised.
        direction(covariance, low, high).map(|n| covariance + n * n.transpose() * (limit - low))
    } else if high > limit {
        // A pole: all but its axis are raised.
        direction(covariance, high, high).map(|n| Matrix3::identity() * limit + n * n.transpose() * (high - limit))
    } else {
        Some(Matrix3::identity() * limit)
    };
    let raised = raised.unwrap_or_else(|| {
        let eigen = SymmetricEigen::new(covariance);
        eigen.with_values(&eigen.values.map(|value| value.max(limit)))
    });
    (raised, inverse(&raised))
}

/// Eigenvalues of a symmetric matrix, from the least to the greatest.
fn eigenvalues(m: &Matrix3<f64>) -> [f64; 3] {
    let mean = m.trace() / 3.0;
    let (a, b, c) = (m.m11 - mean, m.m22 - mean, m.m33 - mean);
    let off = m.m21 * m.m21 + m.m31 * m.m31 + m.m32 * m.m32;
    let p = ((a * a + b * b + c * c + 2.0 * off) / 6.0).sqrt();
    if p <= 0.0 {
        return [mean; 3];
    }
    let determinant =
        a * (b * c - m.m32 * m.m32) - m.m21 * (m.m21 * c - m.m32 * m.m31) + m.m31 * (m.m21 * m.m32 - b * m.m31);
    let angle = (determinant / (2.0 * p * p * p)).clamp(-1.0, 1.0).acos() / 3.0;
    let (sin, cos) = angle.sin_cos();
    // cos(angle + 2π/3), without a second call.
    let (high, low) = (mean + 2.0 * p * cos, mean - p * (cos + 3.0_f64.sqrt() * sin));
    [low, 3.0 * mean - high - low, high]
}

/// Unit eigenvector of the eigenvalue: the longest cross product of two rows of `m - value I`. `None` if another eigenvalue is so
/// close, compared with the greatest, that the direction would be rounding.
fn direction(m: &Matrix3<f64>, value: f64, greatest: f64) -> Option<Vector3<f64>> {
    let shifted = m - Matrix3::identity() * value;
    let (a, b, c) = (shifted.column(0), shifted.column(1), shifted.column(2));
    let candidates = [a.cross(&b), a.cross(&c), b.cross(&c)];
    let longest = candidates.iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
    let norm = longest.norm();
    (norm > 1e-6 * greatest * greatest).then(|| longest / norm)
}

/// Inverse of a symmetric, well conditioned matrix.
fn inverse(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (xx, xy, xz) = (m.m22 * m.m33 - m.m32 * m.m32, m.m31 * m.m32 - m.m21 * m.m33, m.m21 * m.m32 - m.m31 * m.m22);
    let (yy, yz, zz) = (m.m11 * m.m33 - m.m31 * m.m31, m.m21 * m.m31 - m.m11 * m.m32, m.m11 * m.m22 - m.m21 * m.m21);
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) / (m.m11 * xx + m.m21 * xy + m.m31 * xz)
}

#[cfg(feature = "serde")]
impl VoxelSums {
    /// Refuses sums that no points have: more than every point at the far corner would give, or a negative scatter.
    pub(crate) fn check(&self) -> Result<(), agv_core::Error> {
        let (n, most) = (f64::from(self.count), STEPS - 1.0);
        for &sum in &self.linear {
            check::in_range("sum of a voxel", sum as f64, 0.0, n * most)?;
        }
        for &sum in &self.products {
            check::in_range("sum of a voxel", sum as f64, 0.0, n * most * most)?;
        }
        if let Some((_, scatter)) = self.moments() {
            check::covariance("scatter of a voxel", &scatter)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sums(points: &[[u32; 3]]) -> VoxelSums {
        let mut sums = VoxelSums::default();
        for &point in points {
            sums.add(point);
        }
        sums
    }

    fn points() -> impl Strategy<Value = Vec<[u32; 3]>> {
        prop::collection::vec(prop::array::uniform3(0..65_536_u32), 4..40)
    }

    proptest! {
        #[test]
        fn moments_are_those_of_the_points(points in points()) {
            let (mean, scatter) = sums(&points).moments().unwrap();
            let points: Vec<_> = points.iter().map(|p| Vector3::from(p.map(|v| (f64::from(v) + 0.5) / STEPS))).collect();
            let expected = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
            prop_assert!((mean - expected).norm() < 1e-12);
            let expected: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
            prop_assert!((scatter - expected).norm() < 1e-9);
        }

        /// Sums of eight voxels, each from its own corner, are those of one voxel of twice the edge.
        #[test]
        fn shifted_sums_are_those_from_the_common_corner(points in points(), shift in prop::array::uniform3(0..4_u64)) {
            let moved: Vec<_> = points.iter().map(|p| [0, 1, 2].map(|i| p[i] + shift[i] as u32 * 65_536)).collect();
            prop_assert_eq!(sums(&points).shifted(shift), sums(&moved));
        }

        #[test]
        fn merging_adds_in_any_order(a in points(), b in points()) {
            let (mut ab, mut ba) = (sums(&a), sums(&b));
            ab.merge(&sums(&b));
            ba.merge(&sums(&a));
            prop_assert_eq!(ab, ba);
            prop_assert_eq!(ab, sums(&[a, b].concat()));
        }

        /// The quick way is that of the eigenvalues and vectors, for surfaces, poles, dots and volumes.
        #[test]
        fn raised_eigenvalues_are_those_of_the_definition(
            turn in prop::array::uniform3(-3.0..3.0_f64), scales in prop::array::uniform3(-9.0..0.0_f64), ratio in 0.001..0.5_f64,
        ) {
            let rotation = nalgebra::Rotation3::new(Vector3::from(turn)).into_inner();
            let matrix = rotation * Matrix3::from_diagonal(&Vector3::from(scales.map(|s| 10_f64.powf(s)))) * rotation.transpose();
            let matrix = (matrix + matrix.transpose()) * 0.5;
            let (raised, information) = regularized(&matrix, ratio, 1e-5);
            let eigen = SymmetricEigen::new(&matrix);
            let limit = (ratio * eigen.values[2]).max(1e-5);
            let expected = eigen.with_values(&eigen.values.map(|value| value.max(limit)));
            prop_assert!((raised - expected).norm() < 1e-6 * expected.norm(), "{} {}", raised, expected);
            prop_assert!((raised * information - Matrix3::identity()).norm() < 1e-9);
        }
    }

    #[test]
    fn degenerate_covariances_become_the_least_one() {
        for matrix in [Matrix3::zeros(), Matrix3::identity() * 1e-12] {
            assert!((regularized(&matrix, 0.01, 1e-4).0 - Matrix3::identity() * 1e-4).norm() < 1e-9);
        }
        assert_eq!(VoxelSums::default().moments(), None);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = VoxelParams::default();
        assert_eq!(good.validate(), Ok(()));
        for bad in [
            VoxelParams { resolution: 0.0, ..good },
            VoxelParams { resolution: f64::NAN, ..good },
            VoxelParams { resolution: 1e9, ..good },
            VoxelParams { min_points: 2, ..good },
            VoxelParams { min_eigenvalue_ratio: 0.0, ..good },
            VoxelParams { min_eigenvalue_ratio: 1.1, ..good },
            VoxelParams { min_sigma: 0.0, ..good },
            VoxelParams { min_sigma: f64::INFINITY, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
