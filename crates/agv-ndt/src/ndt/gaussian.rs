//! The points of a voxel as a normal distribution.
//!
//! Magnusson, *The three-dimensional normal distributions transform* (PhD thesis, Örebro 2009), section 6.1: the points `p_i` of
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

use super::eigen::SymmetricEigen;
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
        // n Σ xy - Σ x Σ y is exact in 128 bits, where the difference of rounded sums would cancel.
        let scale = 1.0 / (n as f64 * STEPS * STEPS);
        let [x, y, z] = self.linear;
        let scatter = |sum: u64, a: u64, b: u64| (n * i128::from(sum) - i128::from(a) * i128::from(b)) as f64 * scale;
        let [xx, xy, xz, yy, yz, zz] = self.products;
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
    /// Voxels of 1 m and an eigenvalue ratio of 0.01 (Magnusson 2009, section 6.3; paper 003), six points as PCL takes them,
    /// and 1 cm, the noise of a good lidar.
    fn default() -> Self {
        Self { resolution: 1.0, min_points: 6, min_eigenvalue_ratio: 0.01, min_sigma: 0.01 }
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

/// Covariance and its inverse with eigenvalues raised to `ratio` of the greatest and to `least`; and the greatest.
pub(crate) fn regularized(covariance: &Matrix3<f64>, ratio: f64, least: f64) -> (Matrix3<f64>, Matrix3<f64>, f64) {
    let eigen = SymmetricEigen::new(covariance);
    let greatest = eigen.values[2].max(least);
    let values = eigen.values.map(|value| value.max(ratio * greatest).max(least));
    (eigen.with_values(&values), eigen.with_values(&values.map(f64::recip)), greatest)
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
