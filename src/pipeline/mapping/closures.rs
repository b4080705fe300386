//! Finds of a key frame among older ones, and which of them to believe.

use super::{KeyFrameMap, KeyFrameParams, candidates::Candidate, drift::variances};
use crate::Error;
use agv_core::{
    geometry::{LieGroup, PoseSigma, Se3, observed_information},
    nalgebra::{Matrix6, Vector6},
    roles::{Alignment, Registration},
    sensors::PointCloud,
    solve::RobustKernel,
};
use agv_filters::graph::{PoseGraphSolver, PoseId, Relation};

/// Where a key frame was found among older ones.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Closure {
    pub(super) from: u32,
    pub(super) to: u32,
    pub(super) from_from_to: Se3,
    pub(super) information: Matrix6<f64>,
    pub(super) inlier_ratio: f64,
    /// Projector onto directions that it leaves open, in the frame of `to`.
    pub(super) unobserved: Matrix6<f64>,
}

/// How closures count: their residual's square up to so many standard deviations, and linearly beyond.
pub(super) const KERNEL: RobustKernel = RobustKernel::Huber { scale: 3.0 };

/// Whether a relation hangs on a find, which may be false; what odometry alone says is no outlier.
pub(super) fn is_find(relation: &Relation<Se3>) -> bool {
    relation.kernel != RobustKernel::Square
}

/// Squared residual beyond which a closure contradicts the rest.
pub(super) const CONTRADICTION: f64 = 100.0;

/// Way over which finds wait for others that agree, in metres.
const PATIENCE: f64 = 10.0;

/// Information along a direction that was not observed: none to speak of (a hundred metres), so that rounding leaves no
/// negative one.
pub(super) const NEXT_TO_NONE: f64 = 1e-4;

/// Directions that a find may leave open: along a corridor, and no more.
const MOST_UNSEEN: f64 = 1.5;

/// Looks for the last key frame from a candidate; none if it is not there.
pub(super) fn verify<R: Registration>(
    map: &KeyFrameMap,
    registration: &mut R,
    source: &PointCloud,
    candidate: &Candidate,
    target: &mut PointCloud,
    moved: &mut PointCloud,
) -> Result<Option<Closure>, Error> {
    let loops = &map.params.loops;
    let (poses, anchor) = (map.graph.poses(), candidate.anchor);
    let last = map.keys.len().saturating_sub(1);
    target.clear();
    for index in map.neighbours(anchor) {
        map.keys[index].cloud.transform_into(&poses[anchor].between(&poses[index]), moved);
        target.append(moved)?;
    }
    // A target that the registration refuses is no place to be found at.
    if registration.set_target(&*target).is_err() {
        return Ok(None);
    }
    let found = registration.align(source, &candidate.anchor_from_base)?;
    let expected = poses[anchor].between(&poses[last]);
    let off = (found.target_from_source.translation() - expected.translation()).norm();
    let is_one = found.inlier_ratio >= loops.min_inlier_ratio
        && off <= loops.window_at(map.doubt)
        && found.target_from_source.is_finite();
    Ok(if is_one { closure(&found, anchor, last, &map.params) } else { None })
}

/// What an alignment is worth to the graph.
pub(super) fn closure(found: &Alignment<Se3>, from: usize, to: usize, params: &KeyFrameParams) -> Option<Closure> {
    let seen = found.converged() || found.termination == agv_core::roles::Termination::Degenerate;
    if !seen || found.unobserved.trace() > MOST_UNSEEN {
        return None;
    }
    // Bounded where nothing is known; that is taken out again.
    let covariance = found.covariance(PoseSigma::default()).ok()? + variances(params.loops.floor);
    let information = Se3::inverse_of(&covariance)?;
    let information = (information + information.transpose()) * 0.5;
    let information = observed_information::<Se3>(&information, &found.unobserved) + found.unobserved * NEXT_TO_NONE;
    Se3::check_covariance("information", &information).ok()?;
    let (from, to, inlier_ratio) = (from as u32, to as u32, found.inlier_ratio);
    let (from_from_to, unobserved) = (found.target_from_source, found.unobserved);
    Some(Closure { from, to, from_from_to, information, inlier_ratio, unobserved })
}

/// Where the last key frame would be if a find were right.
fn claimed(closure: &Closure, poses: &[Se3]) -> Option<Se3> {
    let (from, to) = (poses.get(closure.from as usize)?, poses.get(closure.to as usize)?);
    Some(from.compose(&closure.from_from_to).compose(&to.between(poses.last()?)))
}

/// Whether two poses are as near as that.
fn agree(a: &Se3, b: &Se3, limit: PoseSigma) -> bool {
    let off = a.between(b);
    off.translation().norm() <= limit.translation && off.rotation().log().norm() <= limit.rotation
}

impl Closure {
    /// The relation that it is to the graph.
    pub(super) fn relation(&self) -> Relation<Se3> {
        Relation::new(PoseId(self.from), PoseId(self.to), self.from_from_to, self.information).with_kernel(KERNEL)
    }

    /// Whether it leaves no direction open: along one, a find is where it was sought, and says nothing.
    pub(super) fn is_whole(&self) -> bool {
        self.unobserved.trace() < 0.5
    }

    /// A tangent in the frame of the last key frame without what the find leaves open of it.
    fn seen_of(&self, tangent: &Vector6<f64>, poses: &[Se3]) -> Vector6<f64> {
        let mut turn = Matrix6::identity();
        if let Some((to, here)) = poses.get(self.to as usize).zip(poses.last()) {
            let rotation = to.between(here).rotation();
            turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation.matrix());
            turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation.matrix());
        }
        tangent - turn.transpose() * (self.unobserved * (turn * tangent))
    }

    /// Whether two finds claim the same place, as far as both can tell.
    fn agrees_with(&self, other: &Self, poses: &[Se3], limit: PoseSigma) -> bool {
        claimed(self, poses).zip(claimed(other, poses)).is_some_and(|(a, b)| {
            let off = other.seen_of(&self.seen_of(&a.between(&b).log(), poses), poses);
            off.fixed_rows::<3>(0).norm() <= limit.translation && off.fixed_rows::<3>(3).norm() <= limit.rotation
        })
    }
}

impl KeyFrameMap {
    /// Whether the last key frame was found where the graph expects it, so that no other place need be looked at.
    pub(super) fn is_expected(&self, closure: &Closure) -> bool {
        let poses = self.graph.poses();
        let claim = claimed(closure, poses);
        let agreement = self.params.loops.agreement;
        closure.is_whole() && claim.zip(poses.last()).is_some_and(|(claim, here)| agree(&claim, here, agreement))
    }

    /// Of finds of the last key frame the one that no other contradicts; none where two places explain it about as
    /// well.
    pub(super) fn unambiguous(&self, found: &[Closure]) -> Option<Closure> {
        let (loops, poses) = (&self.params.loops, self.graph.poses());
        let best = found.iter().max_by(|a, b| a.inlier_ratio.total_cmp(&b.inlier_ratio))?;
        // One that leaves nothing open says more than one that does.
        let whole = found.iter().filter(|other| other.is_whole() && best.agrees_with(other, poses, loops.agreement));
        let best = whole.max_by(|a, b| a.inlier_ratio.total_cmp(&b.inlier_ratio)).unwrap_or(best);
        let rivals = |other: &&Closure| {
            !best.agrees_with(other, poses, loops.agreement) && best.inlier_ratio - other.inlier_ratio < loops.margin
        };
        found.iter().all(|other| !rivals(&other)).then_some(*best)
    }

    /// Whether the graph can explain a find: its squared distance from what is expected is within the gate.
    pub(super) fn explains(&mut self, solver: &mut PoseGraphSolver<Se3>, closure: &Closure) -> Result<bool, Error> {
        solver.optimize(&mut self.graph)?;
        let (from, to) = (PoseId(closure.from), PoseId(closure.to));
        let poses = self.graph.poses();
        let (Some(a), Some(b)) = (poses.get(from.index()), poses.get(to.index())) else { return Ok(false) };
        let off = a.between(b).between(&closure.from_from_to).log();
        let expected = solver.relative_covariance(&self.graph, from, to);
        let Some((expected, measured)) = expected.zip(Se3::inverse_of(&closure.information)) else { return Ok(false) };
        let Some(weight) = Se3::inverse_of(&(expected + measured)) else { return Ok(false) };
        Ok(off.dot(&(weight * off)) <= self.params.loops.gate)
    }

    /// Finds to believe, now that there is one more: itself where it was expected, or with others that agree. If it has
    /// to wait, none.
    pub(super) fn believed(&mut self, closure: &Closure) -> Vec<Closure> {
        let (poses, keys, loops, way) = (self.graph.poses(), &self.keys, &self.params.loops, self.way);
        self.pending.retain(|other| way - keys[other.to as usize].way <= PATIENCE);
        let (Some(claim), Some(here)) = (claimed(closure, poses), poses.last()) else { return Vec::new() };
        if agree(&claim, here, loops.agreement) {
            return vec![*closure];
        }
        let seconds = |other: &Closure| {
            // What is open seconds nothing that is whole.
            other.to != closure.to
                && other.is_whole() == closure.is_whole()
                && closure.agrees_with(other, poses, loops.agreement)
        };
        if self.pending.iter().filter(|other| seconds(other)).count() + 1 < loops.confirmations {
            self.pending.push(*closure);
            return Vec::new();
        }
        let mut believed: Vec<Closure> = self.pending.extract_if(.., |other| seconds(other)).collect();
        believed.push(*closure);
        believed
    }
}
