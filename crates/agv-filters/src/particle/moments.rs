//! Mean and covariance of a weighted set of poses.
//!
//! Position has the ordinary weighted mean; heading the direction of the mean unit vector `(C, S) = Σ w (cos θ, sin θ)`
//! of length `R` (Mardia and Jupp, *Directional Statistics*, section 2.2). The covariance is that of the right increment, so
//! positions are turned into the frame of the mean. Its heading part is `-2 ln R`, the variance of the wrapped normal
//! with that `R`, at most that of the uniform distribution, π²/3; the mixed part uses `sin Δθ` for `Δθ`. Since
//! `E sin²Δθ ≤ 1 - R² ≤ -2 ln R` the matrix is positive semi-definite for any set.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{ParticleSet, gaussian::semidefinite_root, set::chunk_of};
use agv_core::{
    Error, check,
    compute::{CHUNK, Par},
    geometry::{Se2, So2, UncertainPose},
};
use nalgebra::{Matrix2, Matrix3, Vector2};
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::PI;

/// Sums over weighted poses, of which mean and covariance follow.
#[derive(Debug, Clone, Copy)]
pub(super) struct MomentSums {
    /// Of `w`.
    weight: f64,
    /// Of `w (x, y, c, s)`.
    first: [f64; 4],
    /// Of `w x (x, y, c, s)` and of `w y (x, y, c, s)`.
    second: [[f64; 4]; 2],
    /// Moments are taken about it, not about the map's origin: the squares of large coordinates would swamp them.
    pivot: Vector2<f64>,
}

impl ParticleSet {
    /// Weighted mean of the poses, with the covariance of the right increment.
    ///
    /// One pass; the sums are combined in the order of the chunks.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if the squares of the coordinates are not.
    pub fn estimate(&self, par: Par) -> Result<UncertainPose<Se2>, Error> {
        let (poses, weights, pivot, arch) = (self.states(), self.weights(), self.pivot(), Arch::new());
        par.map_reduce(
            self.len().div_ceil(CHUNK),
            |chunk| MomentSums::of(chunk_of(poses, chunk), chunk_of(weights, chunk), pivot, arch),
            |a, b| a.with(&b),
        )
        .unwrap_or_else(|| MomentSums::about(pivot))
        .moments()
    }

    /// A place among the particles.
    pub(super) fn pivot(&self) -> Vector2<f64> {
        self.states().first().map_or_else(Vector2::zeros, Se2::translation)
    }
}

impl MomentSums {
    /// Those of nothing yet.
    pub(super) const fn about(pivot: Vector2<f64>) -> Self {
        Self { weight: 0.0, first: [0.0; 4], second: [[0.0; 4]; 2], pivot }
    }

    /// Those of poses with these weights.
    pub(super) fn of(poses: &[Se2], weights: &[f64], pivot: Vector2<f64>, arch: Arch) -> Self {
        arch.dispatch(Weighted { poses, weights, pivot })
    }

    /// Those of two parts, about the same place, together.
    #[inline]
    pub(super) fn with(&self, other: &Self) -> Self {
        Self {
            weight: self.weight + other.weight,
            first: std::array::from_fn(|i| self.first[i] + other.first[i]),
            second: std::array::from_fn(|k| std::array::from_fn(|i| self.second[k][i] + other.second[k][i])),
            pivot: self.pivot,
        }
    }

    /// Those of all weights times a factor.
    pub(super) fn times(&self, factor: f64) -> Self {
        Self {
            weight: self.weight * factor,
            first: self.first.map(|sum| sum * factor),
            second: self.second.map(|sums| sums.map(|sum| sum * factor)),
            pivot: self.pivot,
        }
    }

    /// The sum of the weights.
    pub(super) const fn weight(&self) -> f64 {
        self.weight
    }

    /// Adds a weighted pose.
    #[inline(always)]
    pub(super) fn add(&mut self, pose: &Se2, w: f64) {
        let (x, y) = (pose.x() - self.pivot.x, pose.y() - self.pivot.y);
        let values = [x, y, pose.rotation().cos(), pose.rotation().sin()];
        let (wx, wy) = (w * x, w * y);
        self.weight += w;
        for (i, value) in values.into_iter().enumerate() {
            self.first[i] += w * value;
            self.second[0][i] += wx * value;
            self.second[1][i] += wy * value;
        }
    }

    /// The moments; the weight is to be positive.
    ///
    /// # Errors
    /// [`Error::NotFinite`] if the squares of the coordinates are not.
    pub(super) fn moments(&self) -> Result<UncertainPose<Se2>, Error> {
        let Self { first: [x, y, c, s], second: [[xx, xy, xc, xs], [_, yy, yc, ys]], .. } =
            self.times(1.0 / self.weight);
        let heading = So2::from_direction(c, s);
        let (cos, sin) = (heading.cos(), heading.sin());
        let in_map = Matrix2::new(xx - x * x, xy - x * y, xy - x * y, yy - y * y);
        // E[(x - x̄) sin(θ - θ̄)], and the same of y.
        let mixed = Vector2::new((xs - x * s) * cos - (xc - x * c) * sin, (ys - y * s) * cos - (yc - y * c) * sin);
        let rotation = Matrix2::new(cos, -sin, sin, cos);
        let (p, k) = (rotation.transpose() * in_map * rotation, rotation.transpose() * mixed);
        let length = c.hypot(s).min(1.0);
        let heading_variance = (-2.0 * length.ln()).min(PI * PI / 3.0);
        let mean = Se2::from_parts(self.pivot + Vector2::new(x, y), heading);
        let covariance = Matrix3::new(p.m11, p.m12, k.x, p.m12, p.m22, k.y, k.x, k.y, heading_variance);
        // Particles that agree in a direction leave rounding there, of either sign: the root leaves it out.
        check::all_finite("covariance of the particles", covariance.iter())?;
        UncertainPose::new(mean, covariance).or_else(|_| {
            let root = semidefinite_root(&covariance);
            UncertainPose::new(mean, root * root.transpose())
        })
    }
}

/// The sums over a chunk, compiled once for each instruction set.
struct Weighted<'a> {
    poses: &'a [Se2],
    weights: &'a [f64],
    pivot: Vector2<f64>,
}

impl WithSimd for Weighted<'_> {
    type Output = MomentSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> MomentSums {
        // Two sums side by side: an addition waits for the one before.
        let mut sums = [MomentSums::about(self.pivot); 2];
        let (poses, last_pose) = self.poses.as_chunks::<2>();
        let (weights, last_weight) = self.weights.as_chunks::<2>();
        for (poses, weights) in poses.iter().zip(weights) {
            for ((sums, pose), &w) in sums.iter_mut().zip(poses).zip(weights) {
                sums.add(pose, w);
            }
        }
        for (pose, &w) in last_pose.iter().zip(last_weight) {
            sums[0].add(pose, w);
        }
        sums[0].with(&sums[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::LieGroup;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        /// Whatever the set, the covariance is one.
        #[test]
        fn covariances_are_positive_semi_definite(poses in prop::collection::vec((-9.0..9.0_f64, -9.0..9.0_f64, -3.2..3.2_f64), 1..40)) {
            let set = ParticleSet::new(poses.iter().map(|&(x, y, yaw)| Se2::new(x, y, yaw)).collect()).unwrap();
            let estimate = set.estimate(Par::Seq).unwrap();
            let covariance = *estimate.covariance();
            prop_assert!(covariance.symmetric_eigenvalues().min() > -1e-9, "{covariance}");
            prop_assert_eq!(covariance, covariance.transpose());
        }

        /// For a narrow set the moments are those of the right increments at the mean.
        #[test]
        fn narrow_sets_have_the_moments_of_their_increments(x in -900.0..900.0_f64, yaw in -3.2..3.2_f64,
            offsets in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 2..30)) {
            let centre = Se2::new(x, 7.0, yaw);
            let set = ParticleSet::new(offsets.iter().map(|&(a, b, c)| centre.plus(&(Vector3::new(a, b, c) * 1e-3))).collect()).unwrap();
            let estimate = set.estimate(Par::Seq).unwrap();
            let increments: Vec<_> = set.states().iter().map(|pose| pose.minus(estimate.mean())).collect();
            let mean = increments.iter().sum::<Vector3<f64>>() / increments.len() as f64;
            let covariance = increments.iter().map(|d| d * d.transpose()).sum::<Matrix3<f64>>() / increments.len() as f64;
            prop_assert!(mean.norm() < 2e-6, "{mean}");
            prop_assert!((covariance - estimate.covariance()).abs().max() < 5e-9, "{covariance} {}", estimate.covariance());
        }
    }

    #[test]
    fn headings_average_on_the_circle() {
        let set = ParticleSet::new(vec![Se2::new(0.0, 0.0, 3.1), Se2::new(2.0, 0.0, -3.1)]).unwrap();
        let estimate = set.estimate(Par::Seq).unwrap();
        assert!((estimate.mean().yaw().abs() - PI).abs() < 1e-12);
        assert_eq!(estimate.mean().x(), 1.0);
    }

    #[test]
    fn opposite_headings_are_as_uncertain_as_all() {
        let set = ParticleSet::new(vec![Se2::new(0.0, 0.0, 0.0), Se2::new(0.0, 0.0, PI)]).unwrap();
        assert_eq!(set.estimate(Par::Seq).unwrap().covariance().m33, PI * PI / 3.0);
    }

    #[test]
    fn particles_that_agree_leave_no_spread() {
        for pose in [Se2::new(1234.5, -0.1, 2.2), Se2::new(0.1, 1e7, -1.0)] {
            let estimate = ParticleSet::new(vec![pose; 777]).unwrap().estimate(Par::Seq).unwrap();
            assert!(estimate.mean().minus(&pose).norm() < 1e-9 && estimate.covariance().amax() < 1e-9);
        }
        // On a line, in a direction of its own.
        let line = (0..100).map(|i| Se2::new(0.3 * f64::from(i), 0.7 * f64::from(i), 0.4)).collect();
        assert!(ParticleSet::new(line).unwrap().estimate(Par::Seq).is_ok());
        let far = vec![Se2::new(1e300, 0.0, 0.0), Se2::new(-1e300, 0.0, 0.0)];
        assert!(ParticleSet::new(far).unwrap().estimate(Par::Seq).is_err());
    }
}
