//! Places that are known already: a key frame that was found at an older one, as near as that, is not kept.
//!
//! What it said is: the way there and the find, one after the other, relate the key frame that was followed with the one that was found.
//! The find serves twice, for that relation and for the way on from the key frame that was met, as if it were two: both are a little too
//! sure of it. Where the two were related before, the way there is forgotten: a site that is driven through day after day has the key frames of its places, and their
//! relations, and no more.

use super::{
    KeyFrameMap,
    closures::{Closure, KERNEL},
};
use crate::Error;
use agv_core::geometry::{LieGroup, Se3, UncertainPose};
use agv_core::nalgebra::Matrix6;
use agv_filters::graph::{PoseId, Relation};
use agv_ndt::places::ScanContext;

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
            tracked.key_from_base = UncertainPose::exact(Se3::identity());
        }
        if let Some(place) = self.trajectory.last_mut() {
            (place.key, place.key_from_base) = (self.followed, Se3::identity());
        }
    }

    /// Takes the last key frame away again, and follows the one that it was found at; `key_from_base` is how it was reached from the
    /// one that is followed.
    pub(super) fn forget_last(&mut self, closure: &Closure, key_from_base: &UncertainPose<Se3>) -> Result<(), Error> {
        let found = found(closure)?;
        self.graph.pop_pose();
        self.keys.pop();
        self.closed.remove(&(closure.from, closure.to));
        let (followed, met) = (self.followed, closure.from);
        let is_related =
            |relation: &Relation<Se3>| [(followed, met), (met, followed)].contains(&(relation.from.0, relation.to.0));
        if followed != met && !self.graph.relations().iter().any(is_related) {
            let followed_from_met = key_from_base.compose(&found.inverse());
            let (from, to, between) = if followed < met {
                (followed, met, followed_from_met)
            } else {
                (met, followed, followed_from_met.inverse())
            };
            let relation = Relation::new(PoseId(from), PoseId(to), *between.mean(), information(between.covariance()));
            self.graph.add_relation(relation.with_kernel(KERNEL))?;
            self.closed.insert((from, to));
        }
        self.followed = met;
        if let Some(tracked) = &mut self.tracked {
            tracked.key_from_base = found;
        }
        if let Some(place) = self.trajectory.last_mut() {
            (place.key, place.key_from_base) = (met, closure.from_from_to);
        }
        Ok(())
    }
}

/// A find with its covariance.
fn found(closure: &Closure) -> Result<UncertainPose<Se3>, Error> {
    let covariance = Se3::inverse_of(&closure.information).unwrap_or_else(Matrix6::identity);
    Ok(UncertainPose::new(closure.from_from_to, (covariance + covariance.transpose()) * 0.5)?)
}

/// What a covariance is worth to the graph: symmetric to the last bit, and none to speak of where there is no inverse.
pub(super) fn information(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let information = Se3::inverse_of(covariance).unwrap_or_else(Matrix6::identity);
    (information + information.transpose()) * 0.5
}
