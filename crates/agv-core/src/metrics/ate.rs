//! Absolute trajectory error: how far is the estimate from the reference, as a whole?
//!
//! Sturm et al., *A benchmark for the evaluation of RGB-D SLAM systems*, IROS 2012: poses are paired by time, the
//! estimate is moved rigidly onto the reference (it lives in a map frame of its own), and what remains is the error.

use super::{Statistics, TrajectoryPose};
use crate::{Error, check, time::Stamp};

/// A pose of the reference and one of the estimate, taken at the same time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePair<G> {
    /// When, by the estimate's stamp.
    pub stamp: Stamp,
    /// `world_from_base`.
    pub reference: G,
    /// `map_from_base`.
    pub estimate: G,
}

/// Pairs poses whose stamps differ by at most `tolerance` seconds, the closest first, each pose once at most; in the
/// order of the estimate. Of the reference's poses only the four nearest on either side of a stamp are candidates.
/// O(n log n).
///
/// # Errors
/// [`Error::Negative`] for the tolerance; [`Error::NotFinite`] for a pose.
pub fn associate<G: TrajectoryPose>(
    reference: &[(Stamp, G)],
    estimate: &[(Stamp, G)],
    tolerance: f64,
) -> Result<Vec<PosePair<G>>, Error> {
    check::non_negative("tolerance", tolerance)?;
    if reference.iter().chain(estimate).any(|(_, pose)| !pose.is_finite()) {
        return Err(Error::NotFinite { name: "pose", value: f64::NAN });
    }
    let mut by_time: Vec<usize> = (0..reference.len()).collect();
    by_time.sort_by_key(|&i| reference[i].0);
    // The neighbours within the tolerance, on either side, are all that an estimate may be paired with.
    let mut candidates = Vec::new();
    for (e, (stamp, _)) in estimate.iter().enumerate() {
        let next = by_time.partition_point(|&r| reference[r].0 < *stamp);
        let before = by_time[..next].iter().rev().take_while(|&&r| *stamp - reference[r].0 <= tolerance);
        let after = by_time[next..].iter().take_while(|&&r| reference[r].0 - *stamp <= tolerance);
        // A few on each side: more can only matter where many estimates share the same stamps.
        candidates.extend(before.take(4).chain(after.take(4)).map(|&r| ((*stamp - reference[r].0).abs(), e, r)));
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let (mut partner, mut taken) = (vec![None; estimate.len()], vec![false; reference.len()]);
    for (_, e, r) in candidates {
        if partner[e].is_none() && !taken[r] {
            (partner[e], taken[r]) = (Some(r), true);
        }
    }
    let pairs = estimate
        .iter()
        .zip(partner)
        .filter_map(|(&(stamp, estimate), r)| Some(PosePair { stamp, reference: reference[r?].1, estimate }));
    Ok(pairs.collect())
}

/// How the estimate is moved onto the reference before they are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TrajectoryAlignment {
    /// Not at all: both live in one frame.
    None,
    /// So that the first poses agree, as for odometry.
    FirstPose,
    /// By the rigid motion of least squares over all positions, without scale.
    #[default]
    Rigid,
}

/// What [`absolute_error`] gives.
#[derive(Debug, Clone, PartialEq)]
pub struct AbsoluteError<G> {
    /// The motion that moved the estimate onto the reference: `world_from_map`.
    pub reference_from_estimate: G,
    /// Distances between the positions, in metres.
    pub translation: Statistics,
    /// Angles between the headings, in radians.
    pub rotation: Statistics,
}

/// Absolute trajectory error of paired poses.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2};
/// use agv_core::metrics::{TrajectoryAlignment, absolute_error, associate};
/// use agv_core::time::Stamp;
///
/// // The same drive, written down in two maps.
/// let world_from_map = Se2::new(4.0, -2.0, 1.0);
/// let estimate: Vec<_> = (0..10)
///     .map(|i| (Stamp::from_seconds(0.1 * f64::from(i)), Se2::new(f64::from(i), f64::from(i * i) / 9.0, 0.2)))
///     .collect();
/// let reference: Vec<_> = estimate.iter().map(|(t, pose)| (*t + 0.004, world_from_map * *pose)).collect();
///
/// let pairs = associate(&reference, &estimate, 0.02)?;
/// let error = absolute_error(&pairs, TrajectoryAlignment::Rigid)?;
/// assert!(error.translation.max() < 1e-12 && error.rotation.max() < 1e-12);
/// assert!(error.reference_from_estimate.minus(&world_from_map).norm() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Empty`] without pairs, [`Error::NotFinite`].
pub fn absolute_error<G: TrajectoryPose>(
    pairs: &[PosePair<G>],
    alignment: TrajectoryAlignment,
) -> Result<AbsoluteError<G>, Error> {
    let first = pairs.first().ok_or(Error::Empty { name: "pose pairs" })?;
    let reference_from_estimate = match alignment {
        TrajectoryAlignment::None => G::identity(),
        TrajectoryAlignment::FirstPose => first.reference.compose(&first.estimate.inverse()),
        TrajectoryAlignment::Rigid => G::fit(pairs.iter().map(|p| (p.reference, p.estimate))),
    };
    let errors = pairs.iter().map(|p| p.reference.between(&reference_from_estimate.compose(&p.estimate)));
    Ok(AbsoluteError {
        reference_from_estimate,
        translation: Statistics::new(errors.clone().map(|e| e.distance()).collect())?,
        rotation: Statistics::new(errors.map(|e| e.angle()).collect())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{LieGroup, Se2, Se3};
    use nalgebra::Vector6;
    use proptest::prelude::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    proptest! {
        /// No small motion of the fitted alignment makes the squared error less: it is the minimum.
        #[test]
        fn the_fit_is_a_minimum(
            truth in prop::array::uniform6(-2.0..2.0_f64),
            positions in prop::collection::vec((prop::array::uniform3(-5.0..5.0_f64), prop::array::uniform3(-0.3..0.3_f64)), 4..20),
            nudge in prop::array::uniform6(-0.01..0.01_f64),
        ) {
            let truth = Se3::exp(&Vector6::from(truth));
            let place = |p: [f64; 3]| Se3::exp(&Vector6::new(p[0], p[1], p[2], 0.0, 0.0, 0.0));
            let pairs: Vec<_> =
                positions.iter().map(|(p, noise)| (truth * place(*p) * place(*noise), place(*p))).collect();
            let cost = |m: &Se3| -> f64 { pairs.iter().map(|(a, b)| (a.translation() - m.act(&b.translation())).norm_squared()).sum() };
            let found = Se3::fit(pairs.iter().copied());
            prop_assert!(cost(&found) <= cost(&found.plus(&Vector6::from(nudge))) + 1e-12);
            // The plane's closed form agrees with space's singular values on flat data.
            let flat: Vec<_> = pairs.iter().map(|(a, b)| (a.to_planar(), b.to_planar())).collect();
            let planar = Se2::fit(flat.iter().copied());
            let spatial = Se3::fit(flat.iter().map(|(a, b)| (Se3::from(*a), Se3::from(*b))));
            let flat_cost = |m: &Se3| -> f64 {
                flat.iter().map(|(a, b)| (Se3::from(*a).translation() - m.act(&Se3::from(*b).translation())).norm_squared()).sum()
            };
            // In space a flat set may be turned over as well, which can only fit better.
            prop_assert!(flat_cost(&spatial) <= flat_cost(&planar.into()) + 1e-9);
        }
    }

    #[test]
    fn pairing_takes_the_closest_once() {
        let poses = |stamps: &[f64]| stamps.iter().map(|t| (at(*t), Se2::new(*t, 0.0, 0.0))).collect::<Vec<_>>();
        // Unordered, and 1.05 and 1.12 both want 1.1.
        let pairs = associate(&poses(&[3.0, 1.1, 1.0, 2.0]), &poses(&[2.04, 1.05, 1.12, 9.0]), 0.06).unwrap();
        let found: Vec<_> = pairs.iter().map(|p| (p.estimate.x(), p.reference.x())).collect();
        assert_eq!(found, [(2.04, 2.0), (1.05, 1.0), (1.12, 1.1)]);
    }

    #[test]
    fn alignments_differ_as_they_say() {
        let pair =
            |x: f64, y: f64| PosePair { stamp: at(x), reference: Se2::new(x, 0.0, 0.0), estimate: Se2::new(x, y, 0.0) };
        let pairs = [pair(0.0, 1.0), pair(1.0, 1.0), pair(2.0, 1.3)];
        let max = |alignment| absolute_error(&pairs, alignment).unwrap().translation.max();
        assert!((max(TrajectoryAlignment::None) - 1.3).abs() < 1e-12);
        assert!((max(TrajectoryAlignment::FirstPose) - 0.3).abs() < 1e-12);
        assert!(max(TrajectoryAlignment::Rigid) < 0.11);
    }

    #[test]
    fn bad_input_is_named() {
        let good = [(at(0.0), Se2::default())];
        let bad = [(at(0.0), Se2::new(f64::NAN, 0.0, 0.0))];
        assert!(matches!(associate(&good, &bad, 0.1), Err(Error::NotFinite { .. })));
        assert!(matches!(associate(&good, &good, f64::NAN), Err(Error::Negative { .. })));
        assert!(matches!(absolute_error::<Se2>(&[], TrajectoryAlignment::Rigid), Err(Error::Empty { .. })));
    }
}
