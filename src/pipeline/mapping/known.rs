//! Places that are known already: a key frame that was found at an older one, as near as that, is not kept.
//!
//! What it said is: the way there and the find, one after the other, relate the key frame that was followed with the
//! one that was met, and the find and the way on relate the latter with the next. Where two are related before, that is
//! forgotten: a site that is driven through day after day has the key frames of its places, and their relations, and no
//! more.
//!
//! The next key frame that is kept is related to the last one that was, by the odometry of all the way between, and by
//! a find to the one that was met: if the find is false, and taken out, odometry still holds that key frame. It does
//! not hold the clouds between the meet and that key frame: they are told from the one that was met, and stay where the
//! find put them. And what was forgotten cannot be taken out: where a meet relates nothing, since the two are related
//! before, a find leaves no trace in the graph but by the next key frame that is kept.
//!
//! Of what serves in these relations no part does in more than two: a find in that of the way there and in that of the
//! way on, a step of odometry in one of these and in that of all the way. Each counts half in each, twice as wide:
//! likelihoods to the power of a half, whose product over both is the likelihood itself. What is lost is that both
//! speak of the same pose, which makes the sum less sure, never more (the split of covariance intersection, Julier and
//! Uhlmann 1997).

use super::{
    KeyFrameMap,
    closures::{Closure, KERNEL, NEXT_TO_NONE, is_find},
    drift::variances,
    map::Tracked,
};
use crate::Error;
use agv_core::geometry::{LieGroup, Se3, UncertainPose};
use agv_core::nalgebra::Matrix6;
use agv_filters::graph::{PoseId, Relation};
use agv_ndt::places::ScanContext;

/// How much of a measurement counts in each of two relations that it serves in.
const HALF: f64 = 0.5;

impl KeyFrameMap {
    /// Whether a find of the last key frame makes it one too many.
    pub(super) fn is_known(&self, closure: &Closure) -> bool {
        let off = closure.from_from_to;
        closure.is_whole()
            && closure.to as usize + 1 == self.keys.len()
            && self.params.reach.is_some_and(|reach| {
                off.translation().norm() <= reach.translation && off.rotation().log().norm() <= reach.rotation
            })
            // Before anything is taken away.
            && found(closure).is_ok()
    }

    /// Keeps the last key frame, and follows it.
    pub(super) fn keep_last(&mut self, context: &ScanContext) {
        self.places.push(context);
        self.followed = self.keys.len().saturating_sub(1) as u32;
        if let Some(tracked) = &mut self.tracked {
            (tracked.key_from_base, tracked.kept_from_base) = (UncertainPose::exact(Se3::identity()), None);
        }
        if let Some(place) = self.trajectory.last_mut() {
            (place.key, place.key_from_base) = (self.followed, Se3::identity());
        }
    }

    /// Ties a new pose of the graph to the key frame that is followed, and to the last one that was kept.
    pub(super) fn relate_last(&mut self, tracked: &Tracked) -> Result<(), Error> {
        let to = PoseId(self.graph.poses().len().saturating_sub(1) as u32);
        let Some(last) = self.keys.len().checked_sub(1) else { return Ok(()) };
        let floor = variances(self.params.drift.floor);
        let relation = |from: u32, way: &UncertainPose<Se3>, share: f64| {
            Relation::new(PoseId(from), to, *way.mean(), information(&(way.covariance() + floor)) * share)
        };
        let way = &tracked.key_from_base;
        let Some(kept_from_base) = &tracked.kept_from_base else {
            return Ok(self.graph.add_relation(relation(self.followed, way, 1.0))?);
        };
        self.graph.add_relation(relation(last as u32, kept_from_base, HALF))?;
        Ok(self.graph.add_relation(relation(self.followed, way, HALF).with_kernel(KERNEL))?)
    }

    /// Takes the last key frame away again, and follows the one that it was found at.
    pub(super) fn forget_last(&mut self, closure: &Closure, reached: &Tracked) -> Result<(), Error> {
        let found = found(closure)?;
        self.graph.pop_pose();
        self.keys.pop();
        let (followed, met) = (self.followed, closure.from);
        if followed != met && !self.is_related(followed, met) {
            let followed_from_met = reached.key_from_base.compose(&found.inverse());
            let (from, to, between) = if followed < met {
                (followed, met, followed_from_met)
            } else {
                (met, followed, followed_from_met.inverse())
            };
            let information = information(between.covariance()) * HALF;
            let relation = Relation::new(PoseId(from), PoseId(to), *between.mean(), information);
            self.graph.add_relation(relation.with_kernel(KERNEL))?;
            // A find of the same pair has nothing more to wait for.
            self.pending.retain(|other| (other.from, other.to) != (from, to));
        }
        self.followed = met;
        if let Some(tracked) = &mut self.tracked {
            tracked.key_from_base = found;
            tracked.kept_from_base = Some(reached.kept_from_base.unwrap_or(reached.key_from_base));
        }
        if let Some(place) = self.trajectory.last_mut() {
            (place.key, place.key_from_base) = (met, closure.from_from_to);
        }
        Ok(())
    }

    /// Whether a find relates two key frames, or odometry over less than what makes a loop.
    fn is_related(&self, a: u32, b: u32) -> bool {
        let way = |key: u32| self.keys.get(key as usize).map_or(0.0, |key| key.way);
        let is_near = (way(a) - way(b)).abs() < self.params.loops.min_way;
        self.graph.relations().iter().any(|relation| {
            [(a, b), (b, a)].contains(&(relation.from.0, relation.to.0)) && (is_near || is_find(relation))
        })
    }
}

/// A find with its covariance.
fn found(closure: &Closure) -> Result<UncertainPose<Se3>, Error> {
    let covariance = Se3::inverse_of(&closure.information).unwrap_or_else(Matrix6::identity);
    Ok(UncertainPose::new(closure.from_from_to, (covariance + covariance.transpose()) * 0.5)?)
}

/// What a covariance is worth to the graph: symmetric to the last bit, and none to speak of where there is no inverse.
fn information(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let information = Se3::inverse_of(covariance).unwrap_or_else(|| Matrix6::identity() * NEXT_TO_NONE);
    (information + information.transpose()) * 0.5
}

#[cfg(test)]
mod tests;
