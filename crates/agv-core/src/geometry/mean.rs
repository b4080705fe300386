//! Averages of directions and of poses.
//!
//! Angles and poses do not add up: the mean of 179° and -179° is 180°, not 0°. Directions are averaged as unit vectors
//! (Mardia and Jupp, *Directional statistics*, 2000, section 2.2), poses by the intrinsic mean, the pose `m` for which
//! `Σ wᵢ log(m⁻¹ ∘ xᵢ) = 0`, found by the fixed-point iteration `m ← m ⊕ Σ wᵢ log(m⁻¹ ∘ xᵢ)` (Pennec 2006).

use super::LieGroup;
use crate::{Error, check};

/// The mean of directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CircularMean {
    /// Mean direction in (-π, π], in radians; of no meaning if `resultant_length` is near zero.
    pub angle: f64,
    /// Length of the mean of the unit vectors: 1 if all directions agree, near 0 if they point everywhere.
    pub resultant_length: f64,
}

impl CircularMean {
    /// Circular variance `1 - R`, in [0, 1]; half of the usual variance for narrow distributions.
    pub fn variance(&self) -> f64 {
        1.0 - self.resultant_length
    }

    /// Circular standard deviation `sqrt(-2 ln R)`, in radians: that of a wrapped normal distribution; infinite if the
    /// resultant vanishes.
    pub fn standard_deviation(&self) -> f64 {
        (-2.0 * self.resultant_length.ln()).max(0.0).sqrt()
    }
}

/// Weighted mean of `(angle, weight)` pairs, angles in radians; only the ratios of the weights count.
///
/// ```
/// use agv_core::geometry::circular_mean;
///
/// let mean = circular_mean([(3.1, 1.0), (-3.1, 1.0)])?;
/// assert!((mean.angle.abs() - std::f64::consts::PI).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::NotFinite`] for an angle, [`Error::Negative`] for a weight, [`Error::Empty`] without angles, and
/// [`Error::NotPositive`] if the weights sum to zero.
pub fn circular_mean(angles: impl IntoIterator<Item = (f64, f64)>) -> Result<CircularMean, Error> {
    let (mut cos_sum, mut sin_sum, mut total, mut empty) = (0.0, 0.0, 0.0, true);
    for (angle, weight) in angles {
        let (sin, cos) = check::finite("angle", angle)?.sin_cos();
        let weight = check::non_negative("weight", weight)?;
        (cos_sum, sin_sum, total, empty) = (cos_sum + weight * cos, sin_sum + weight * sin, total + weight, false);
    }
    if empty {
        return Err(Error::Empty { name: "angles" });
    }
    let total = check::positive("sum of weights", total)?;
    let (x, y) = (cos_sum / total, sin_sum / total);
    Ok(CircularMean { angle: super::wrap_angle(y.atan2(x)), resultant_length: x.hypot(y).min(1.0) })
}

/// The mean and the spread of poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseMean<G: LieGroup> {
    /// The intrinsic mean.
    pub mean: G,
    /// `Σ wᵢ τᵢ τᵢᵀ` with `τᵢ = xᵢ ⊖ mean` and weights that sum to one, in the source frame of the mean. The maximum
    /// likelihood estimate; times `n / (n - 1)` with `n = effective_count` it has no bias.
    pub covariance: G::Matrix,
    /// `1 / Σ wᵢ²`: how many poses of equal weight tell as much.
    pub effective_count: f64,
    /// Steps of the fixed-point iteration.
    pub iterations: usize,
    /// Whether the iteration came to rest. It does unless the poses are spread over more than half a turn, where the
    /// mean need not be unique.
    pub converged: bool,
}

/// Most steps of the iteration; four to six are usual.
const MAX_ITERATIONS: usize = 50;

/// Step, relative to the size of the mean and of the spread, at which the iteration rests.
const TOLERANCE: f64 = 1e-13;

/// Weighted mean and covariance of `(pose, weight)` pairs; only the ratios of the weights count.
///
/// Starts at the pose of greatest weight and passes over the poses once per step, so the cost is about six logarithms
/// a pose. The result has the same bits for the same order of poses.
///
/// ```
/// use agv_core::geometry::{Se2, pose_mean};
///
/// let poses = [Se2::new(1.0, 0.0, 3.1), Se2::new(3.0, 0.0, -3.1)];
/// let mean = pose_mean(poses.iter().map(|pose| (*pose, 1.0)))?.mean;
/// assert!((mean.x() - 2.0).abs() < 1e-12 && (mean.yaw().abs() - std::f64::consts::PI).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::NotFinite`] for a pose, [`Error::Negative`] for a weight, [`Error::Empty`] without poses, and
/// [`Error::NotPositive`] if the weights sum to zero.
pub fn pose_mean<G: LieGroup>(poses: impl Iterator<Item = (G, f64)> + Clone) -> Result<PoseMean<G>, Error> {
    let (mut total, mut heaviest) = (0.0, None::<(G, f64)>);
    for (pose, weight) in poses.clone() {
        if !pose.is_finite() {
            return Err(Error::NotFinite { name: "pose", value: f64::NAN });
        }
        total += check::non_negative("weight", weight)?;
        if heaviest.is_none_or(|(_, most)| weight > most) {
            heaviest = Some((pose, weight));
        }
    }
    let (mut mean, _) = heaviest.ok_or(Error::Empty { name: "poses" })?;
    let total = check::positive("sum of weights", total)?;

    let (mut iterations, mut converged) = (0, false);
    while iterations < MAX_ITERATIONS && !converged {
        let mut step = G::tangent_from_slice(&[]);
        let mut spread = 0.0;
        for (pose, weight) in poses.clone() {
            let tangent = pose.minus(&mean);
            step = step + tangent * (weight / total);
            spread += weight / total * norm::<G>(&tangent);
        }
        mean = mean.plus(&step);
        iterations += 1;
        converged = norm::<G>(&step) <= TOLERANCE * (1.0 + spread + norm::<G>(&mean.log()));
    }

    let mut covariance = G::identity_matrix() * 0.0;
    let mut squares = 0.0;
    for (pose, weight) in poses {
        let (tangent, share) = (pose.minus(&mean), weight / total);
        covariance = covariance + G::outer(&tangent, &tangent) * share;
        squares += share * share;
    }
    Ok(PoseMean { mean, covariance, effective_count: 1.0 / squares, iterations, converged })
}

fn norm<G: LieGroup>(tangent: &G::Tangent) -> f64 {
    G::tangent_slice(tangent).iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Se2, Se3, So2};
    use nalgebra::{Vector1, Vector6};
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn circular_moments_have_their_known_values() {
        let opposite = circular_mean([(0.3, 1.0), (0.3 + PI, 1.0)]).unwrap();
        assert!(opposite.resultant_length < 1e-15 && (opposite.variance() - 1.0).abs() < 1e-15);
        let same = circular_mean([(-2.0, 0.1), (-2.0, 7.0)]).unwrap();
        assert!((same.angle + 2.0).abs() < 1e-15 && same.standard_deviation() < 1e-7);
        // Two directions at right angles, weighted 3 to 4: the hypotenuse of a 3-4-5 triangle over 7.
        let right = circular_mean([(0.0, 3.0), (FRAC_PI_2, 4.0)]).unwrap();
        assert!((right.resultant_length - 5.0 / 7.0).abs() < 1e-15);
        assert!((right.angle - 4_f64.atan2(3.0)).abs() < 1e-15);
    }

    proptest! {
        /// The mean moves with the poses, and its residuals cancel: the defining properties.
        #[test]
        fn the_mean_is_equivariant_and_centred(
            around in prop::array::uniform6(-1.5..1.5_f64),
            motion in prop::array::uniform6(-1.5..1.5_f64),
            offsets in prop::collection::vec((prop::array::uniform6(-0.4..0.4_f64), 0.1..2.0_f64), 1..12),
        ) {
            let (centre, motion) = (Se3::exp(&Vector6::from(around)), Se3::exp(&Vector6::from(motion)));
            let poses: Vec<_> = offsets.iter().map(|(o, w)| (centre.plus(&Vector6::from(*o)), *w)).collect();
            let found = pose_mean(poses.iter().copied()).unwrap();
            prop_assert!(found.converged, "{found:?}");
            let residual: Vector6<f64> = poses.iter().map(|(p, w)| p.minus(&found.mean) * *w).sum();
            prop_assert!(residual.norm() < 1e-11);
            let moved = pose_mean(poses.iter().map(|(p, w)| (motion * *p, *w))).unwrap();
            prop_assert!(moved.mean.minus(&(motion * found.mean)).norm() < 1e-11);
            prop_assert!((moved.covariance - found.covariance).norm() < 1e-11);
            prop_assert_eq!(Se3::check_covariance("spread", &found.covariance), Ok(()));
        }
    }

    #[test]
    fn narrow_angles_average_as_numbers() {
        let angles = [0.1, 0.2, 0.6];
        let found = pose_mean(angles.iter().map(|a| (So2::from_angle(*a), 2.0))).unwrap();
        assert!((found.mean.angle() - 0.3).abs() < 1e-14);
        assert!((found.covariance[(0, 0)] - 0.14 / 3.0).abs() < 1e-14);
        assert!((found.effective_count - 3.0).abs() < 1e-12);
        assert_eq!(found.mean.log(), Vector1::new(found.mean.angle()));
    }

    #[test]
    fn bad_weights_and_poses_are_named() {
        let pose = Se2::default();
        assert_eq!(circular_mean([]), Err(Error::Empty { name: "angles" }));
        assert_eq!(pose_mean::<Se2>([].into_iter()), Err(Error::Empty { name: "poses" }));
        assert!(matches!(circular_mean([(f64::INFINITY, 1.0)]), Err(Error::NotFinite { name: "angle", .. })));
        let broken = Se2::new(f64::NAN, 0.0, 0.0);
        assert!(matches!(pose_mean([(broken, 1.0)].into_iter()), Err(Error::NotFinite { name: "pose", .. })));
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(
                matches!(circular_mean([(0.0, 1.0), (0.0, bad)]), Err(Error::Negative { name: "weight", .. })),
                "{bad}"
            );
            assert!(
                matches!(pose_mean([(pose, bad)].into_iter()), Err(Error::Negative { name: "weight", .. })),
                "{bad}"
            );
        }
        assert!(matches!(circular_mean([(0.0, 0.0)]), Err(Error::NotPositive { .. })));
        assert!(matches!(pose_mean([(pose, 0.0); 3].into_iter()), Err(Error::NotPositive { .. })));
        assert!(matches!(pose_mean([(pose, f64::MAX); 3].into_iter()), Err(Error::NotPositive { .. })));
    }
}
