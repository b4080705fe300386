//! Errors of a trajectory against relative poses that are known to be right.
//!
//! Kümmerle, Steder, Dornhege, Ruhnke, Grisetti, Stachniss and Kleiner, *On measuring the accuracy of SLAM algorithms*,
//! Autonomous Robots 27 (2009): for relations `δ*ᵢⱼ` between moments `i` and `j` the error is `δᵢⱼ ⊖ δ*ᵢⱼ`, split into its
//! translation and its rotation. Unlike the absolute error it does not punish one early turn all the way to the end.

use super::{Statistics, TrajectoryPose};
use crate::{Error, check, time::Stamp};

/// The true pose of the base at one moment, seen from its pose at another.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Relation<G> {
    /// The moment that is seen from.
    pub from: Stamp,
    /// The moment that is seen.
    pub to: Stamp,
    /// Pose of the base at `to` in the base frame at `from`.
    pub from_from_to: G,
}

/// What [`relation_errors`] gives. The paper's tables state mean and standard deviation of these.
#[derive(Debug, Clone, PartialEq)]
pub struct RelationErrors {
    /// Absolute translational errors, in metres.
    pub translation: Statistics,
    /// Squared translational errors, in square metres.
    pub translation_squared: Statistics,
    /// Absolute rotational errors, in radians.
    pub rotation: Statistics,
    /// Squared rotational errors, in square radians.
    pub rotation_squared: Statistics,
    /// Relations of which the trajectory lacks a moment.
    pub missing: usize,
}

/// Compares a trajectory, in any order of time, with relations. A moment is met by the pose with the nearest stamp,
/// at most `tolerance` seconds away; of equal stamps the first counts. O(n log n).
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::metrics::{Relation, relation_errors};
/// use agv_core::time::Stamp;
///
/// let at = Stamp::from_seconds;
/// let trajectory = [(at(0.0), Se2::default()), (at(1.0), Se2::new(1.1, 0.0, 0.0))];
/// let truth = [Relation { from: at(0.0), to: at(1.0), from_from_to: Se2::new(1.0, 0.0, 0.0) }];
/// let errors = relation_errors(&trajectory, &truth, 0.0)?;
/// assert!((errors.translation.mean() - 0.1).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
///
/// # Errors
/// [`Error::Negative`] for the tolerance, [`Error::NotFinite`] for a pose or a relation, [`Error::Empty`] if not one
/// relation is met.
pub fn relation_errors<G: TrajectoryPose>(
    trajectory: &[(Stamp, G)],
    relations: &[Relation<G>],
    tolerance: f64,
) -> Result<RelationErrors, Error> {
    check::non_negative("tolerance", tolerance)?;
    if trajectory.iter().map(|t| &t.1).chain(relations.iter().map(|r| &r.from_from_to)).any(|pose| !pose.is_finite()) {
        return Err(Error::NotFinite { name: "pose", value: f64::NAN });
    }
    let mut by_time: Vec<&(Stamp, G)> = trajectory.iter().collect();
    by_time.sort_by_key(|(stamp, _)| *stamp); // stable: the first of equal stamps stays first
    let find = |stamp: Stamp| -> Option<G> {
        let next = by_time.partition_point(|(s, _)| *s < stamp);
        // The neighbours are the first pose at or after the stamp, and the first of those just before it.
        let after = by_time.get(next);
        let before = next.checked_sub(1).map(|last| {
            let first = by_time.partition_point(|(s, _)| *s < by_time[last].0);
            &by_time[first]
        });
        let off = |p: &&&(Stamp, G)| (p.0 - stamp).abs();
        let nearest = after.into_iter().chain(before).min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (off(&nearest) <= tolerance).then_some(nearest.1)
    };
    let (mut translation, mut rotation) = (Vec::new(), Vec::new());
    for relation in relations {
        if let (Some(from), Some(to)) = (find(relation.from), find(relation.to)) {
            let error = relation.from_from_to.between(&from.between(&to));
            translation.push(error.distance());
            rotation.push(error.angle());
        }
    }
    let missing = relations.len() - translation.len();
    let squared = |values: &[f64]| Statistics::new(values.iter().map(|v| v * v).collect());
    Ok(RelationErrors {
        translation_squared: squared(&translation)?,
        rotation_squared: squared(&rotation)?,
        translation: Statistics::new(translation)?,
        rotation: Statistics::new(rotation)?,
        missing,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{LieGroup, Se2};

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// One wrong turn of a quarter at 2 s: every relation but those across it is met, wherever the trajectory went.
    #[test]
    fn one_turn_spoils_only_the_relations_across_it() {
        let truth: Vec<_> = (0..5).map(|i| (at(f64::from(i)), Se2::new(f64::from(i), 0.0, 0.0))).collect();
        let quarter = Se2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let turned =
            truth.iter().map(|(t, p)| (*t, if *t > at(2.0) { quarter * *p } else { *p })).rev().collect::<Vec<_>>();
        let relations: Vec<_> = truth
            .windows(2)
            .map(|w| Relation { from: w[0].0, to: w[1].0, from_from_to: w[0].1.between(&w[1].1) })
            .collect();
        let errors = relation_errors(&turned, &relations, 0.0).unwrap();
        assert_eq!((errors.missing, errors.translation.count()), (0, 4));
        assert!(errors.rotation.percentile(66.0) < 1e-12);
        assert!((errors.rotation.max() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert!((errors.rotation_squared.max() - errors.rotation.max().powi(2)).abs() < 1e-15);
        // From (2, 0) the pose at 3 s should be 1 m ahead and is seen at (0, 3): (-3, 3) from where it should be.
        assert!((errors.translation.max() - 18_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn moments_are_met_within_the_tolerance() {
        let trajectory =
            [(at(0.0), Se2::default()), (at(1.0), Se2::new(1.0, 0.0, 0.0)), (at(1.0), Se2::new(9.0, 0.0, 0.0))];
        let relation = |to| Relation { from: at(0.0), to: at(to), from_from_to: Se2::new(1.0, 0.0, 0.0) };
        let relations = [relation(1.0), relation(0.96), relation(1.04), relation(1.2)];
        let errors = relation_errors(&trajectory, &relations, 0.05).unwrap();
        assert_eq!((errors.missing, errors.translation.max()), (1, 0.0));
    }

    #[test]
    fn bad_input_is_named() {
        let relation = Relation { from: at(0.0), to: at(0.0), from_from_to: Se2::default() };
        let nan = Se2::new(0.0, f64::NAN, 0.0);
        assert!(matches!(relation_errors(&[], &[relation], 0.0), Err(Error::Empty { .. })));
        assert!(matches!(relation_errors(&[(at(0.0), nan)], &[relation], 0.0), Err(Error::NotFinite { .. })));
        assert!(matches!(
            relation_errors(&[(at(0.0), Se2::default())], &[relation], -1.0),
            Err(Error::Negative { .. })
        ));
    }
}
