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
/// Offsets from the voxel's corner are counted in 2⁻¹⁶ voxels: products are below 2³², so that 2³² - 1 points fit into 64 bits.
/// The sums stop there, all together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawSums"))]
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
            // As many points fit.
            for (own, theirs) in self.linear.iter_mut().zip(other.linear) {
                *own += theirs;
            }
            for (own, theirs) in self.products.iter_mut().zip(other.products) {
                *own += theirs;
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

    /// Mean, and scatter `Σ (p - mean)(p - mean)ᵀ`, in voxels from the corner; none without points.
    pub(crate) fn moments(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        moments(self.count, self.linear, self.products.map(u128::from))
    }
}

/// Sums over the points of several voxels, from the corner of the lowest: offsets are up to 2⁶ voxels and 2³² - 1 points below
/// 2⁵⁴ in sum, their products below 2⁷⁶. More points are left out, voxel by voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct WideSums {
    count: u32,
    linear: [u64; 3],
    products: [u128; 6],
}

/// Most doublings of a voxel's edge that [`WideSums`] are for.
pub(crate) const MAX_DOUBLINGS: u32 = 6;

impl WideSums {
    /// Points in the voxels.
    pub(crate) const fn count(&self) -> u32 {
        self.count
    }

    /// Adds all points of a voxel whose corner is `shift` voxels from the lowest one's, less than 2⁶ in every direction.
    pub(crate) fn add(&mut self, sums: &VoxelSums, shift: [u64; 3]) {
        let Some(count) = self.count.checked_add(sums.count) else { return };
        self.count = count;
        let n = u64::from(sums.count);
        let [x, y, z] = sums.linear;
        let [a, b, c] = shift.map(|voxels| voxels * STEPS as u64);
        let moved = [x + a * n, y + b * n, z + c * n];
        for (own, theirs) in self.linear.iter_mut().zip(moved) {
            *own += theirs;
        }
        // Σ (x + a)(y + b) = Σ xy + a Σ y + b Σ (x + a)
        let product = |sum: u64, a: u64, y: u64, b: u64, moved_x: u64| {
            u128::from(sum) + u128::from(a) * u128::from(y) + u128::from(b) * u128::from(moved_x)
        };
        let [xx, xy, xz, yy, yz, zz] = sums.products;
        let [x_moved, y_moved, z_moved] = moved;
        let theirs = [
            product(xx, a, x, a, x_moved),
            product(xy, a, y, b, x_moved),
            product(xz, a, z, c, x_moved),
            product(yy, b, y, b, y_moved),
            product(yz, b, z, c, y_moved),
            product(zz, c, z, c, z_moved),
        ];
        for (own, theirs) in self.products.iter_mut().zip(theirs) {
            *own += theirs;
        }
    }

    /// As [`VoxelSums::moments`].
    pub(crate) fn moments(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        moments(self.count, self.linear, self.products)
    }
}

/// Mean, and scatter `Σ (p - mean)(p - mean)ᵀ`, in voxels from the corner; none without points.
#[inline]
fn moments(count: u32, [x, y, z]: [u64; 3], products: [u128; 6]) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let n = i128::from(count);
    if n == 0 {
        return None;
    }
    let scale = 1.0 / (n as f64 * STEPS * STEPS);
    // n Σ xy - Σ x Σ y is exact in integers, where the difference of rounded sums would cancel: both are below 2¹⁰⁹, and mostly
    // below 2⁶³.
    let bits = |value: u128| u128::BITS - value.leading_zeros();
    let (most, furthest) = (products.iter().fold(0, |a, &b| a | b), u128::from(x | y | z));
    let short = bits(n as u128) + bits(most) < u64::BITS && 2 * bits(furthest) < u64::BITS;
    let scatter = |sum: u128, a: u64, b: u64| {
        let difference = if short {
            (i64::from(count) * sum as i64 - a as i64 * b as i64) as f64
        } else {
            (n * sum as i128 - i128::from(a) * i128::from(b)) as f64
        };
        difference * scale
    };
    let [xx, xy, xz, yy, yz, zz] = products;
    let (xy, xz, yz) = (scatter(xy, x, y), scatter(xz, x, z), scatter(yz, y, z));
    let matrix = Matrix3::new(scatter(xx, x, x), xy, xz, xy, scatter(yy, y, y), yz, xz, yz, scatter(zz, z, z));
    // A point lies somewhere in its step: half a step on average.
    let mean = Vector3::new(x as f64, y as f64, z as f64) / (n as f64 * STEPS) + Vector3::repeat(0.5 / STEPS);
    Some((mean, matrix))
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
    /// Least standard deviation along any direction, in metres: from 0.1 mm to a voxel's edge.
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
        // Less than a tenth of a millimetre is more information than `f32` sums hold.
        check::in_range("min_sigma", self.min_sigma, 1e-4, self.resolution)?;
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

/// Sums as they are stored.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawSums {
    count: u32,
    linear: [u64; 3],
    products: [u64; 6],
}

/// Refuses sums that no points have: more than every point at the far corner would give, or a negative scatter.
#[cfg(feature = "serde")]
impl TryFrom<RawSums> for VoxelSums {
    type Error = agv_core::Error;

    fn try_from(RawSums { count, linear, products }: RawSums) -> Result<Self, agv_core::Error> {
        let (n, most) = (u64::from(count), STEPS as u64 - 1);
        let bounded = |sums: &[u64], max: u64| {
            let greatest = sums.iter().copied().fold(0, u64::max);
            // Two numbers that differ may be the same in `f64`.
            let value = if greatest > max { (greatest as f64).max((max as f64).next_up()) } else { 0.0 };
            check::in_range("sum of a voxel", value, 0.0, max as f64)
        };
        bounded(&linear, n * most)?;
        bounded(&products, n * most * most)?;
        let sums = Self { count, linear, products };
        if let Some((_, scatter)) = sums.moments() {
            check::covariance("scatter of a voxel", &scatter)?;
        }
        Ok(sums)
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

        /// Sums of two voxels, each from its own corner, are those of all points from the first one's.
        #[test]
        fn wide_sums_are_those_from_the_common_corner(
            a in points(), b in points(), shift in prop::array::uniform3(0..64_u64), copies in 1..100_000_u32,
        ) {
            let mut wide = WideSums::default();
            let many = |points: &[[u32; 3]]| {
                let VoxelSums { count, linear, products } = sums(points);
                let copy = |sum: u64| sum * u64::from(copies);
                VoxelSums { count: count * copies, linear: linear.map(copy), products: products.map(copy) }
            };
            wide.add(&many(&a), [0; 3]);
            wide.add(&many(&b), shift);
            let (mean, scatter) = wide.moments().unwrap();
            let at = |p: &[u32; 3], shift: [u64; 3]| {
                Vector3::from([0, 1, 2].map(|i| (f64::from(p[i]) + 0.5) / STEPS + shift[i] as f64))
            };
            let points: Vec<_> = a.iter().map(|p| at(p, [0; 3])).chain(b.iter().map(|p| at(p, shift))).collect();
            let expected = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
            prop_assert_eq!(wide.count() as usize, points.len() * copies as usize);
            prop_assert!((mean - expected).norm() < 1e-10);
            let expected: Matrix3<f64> = points.iter().map(|p| (p - expected) * (p - expected).transpose()).sum();
            prop_assert!((scatter / f64::from(copies) - expected).norm() < 1e-10 * expected.norm());
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

    /// As many points as are counted, all in the far corner, and one more: neither a wrap nor a negative scatter.
    #[test]
    fn full_voxels_neither_wrap_nor_lie() {
        let (n, most) = (u64::from(u32::MAX), STEPS as u64 - 1);
        let full = VoxelSums { count: u32::MAX, linear: [n * most; 3], products: [n * most * most; 6] };
        let mut more = full;
        more.add([1, 2, 3]);
        more.merge(&sums(&[[4, 5, 6]]));
        assert_eq!(more, full);
        assert_eq!(full.moments().unwrap().1, Matrix3::zeros());
        let mut wide = WideSums::default();
        wide.add(&full, [63; 3]);
        wide.add(&full, [0; 3]);
        let (mean, scatter) = wide.moments().unwrap();
        assert_eq!((wide.count(), scatter), (u32::MAX, Matrix3::zeros()));
        assert!((mean - Vector3::repeat(64.0)).norm() < 1e-4);
        // Half of as many at either end.
        let half = VoxelSums { count: 1 << 31, linear: [0; 3], products: [0; 6] };
        let mut ends = WideSums::default();
        ends.add(&half, [0; 3]);
        ends.add(&VoxelSums { count: u32::MAX >> 1, ..half }, [63; 3]);
        let expected = 63.0 * 63.0 * 0.25 * f64::from(u32::MAX);
        let (_, scatter) = ends.moments().unwrap();
        assert!(scatter.iter().all(|entry| (entry / expected - 1.0).abs() < 1e-9), "{scatter}");
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
            VoxelParams { min_sigma: 9e-5, ..good },
            VoxelParams { min_sigma: 1.1, ..good },
            VoxelParams { min_sigma: f64::INFINITY, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
