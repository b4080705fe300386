//! In a map that is there: finding the place, following it without changing the map, and going on with it.

use super::{
    GraphSlam,
    closures::{self, Keys, Seeker},
    key_scan::{apart, usable_points_into},
};
use crate::matching::SearchWindow;
use agv_core::{
    check,
    geometry::{LieGroup, Se2, angle_difference},
    roles::{Alignment, AlignmentError},
    sensors::LaserScan,
};
use std::f64::consts::PI;

/// Key scans that are this near to one that was tried need not be tried, in metres.
const SPACING: f64 = 2.0;

/// The key scan that a vehicle was found by, if it was.
type Found = Result<Option<(usize, Alignment<Se2>)>, AlignmentError>;

impl GraphSlam {
    /// Whether the map stays as it is: scans are then matched against the key scans around the vehicle, and none is added.
    pub const fn is_frozen(&self) -> bool {
        self.frozen
    }

    /// Keeps the map as it is from now on (pure localisation), or goes on with it.
    ///
    /// # Errors
    /// None that a state without faults has.
    pub fn set_frozen(&mut self, frozen: bool) -> Result<(), AlignmentError> {
        if self.frozen == frozen || self.keys.is_empty() {
            self.frozen = frozen;
            return Ok(());
        }
        let here = self.map_from_base();
        self.frozen = frozen;
        // What is added is related to a key scan nearby, and is a drive of its own: the ones before end elsewhere.
        self.drive += u32::from(!frozen);
        self.settle(&here).inspect_err(|_| {
            self.frozen = !frozen;
            self.drive -= u32::from(!frozen);
        })
    }

    /// Finds the vehicle by a scan: after a start in a map that was loaded, or after it was carried away. Around a guess that is good to
    /// the window of the parameters' closures, or, without one, anywhere near a key scan, looking anywhere.
    ///
    /// Where it was found, none if nowhere, and the state is then as it was. Scans go on from there; unless the map is
    /// [frozen](Self::set_frozen), they add to it.
    ///
    /// # Errors
    /// A guess that is not finite.
    pub fn relocate(
        &mut self,
        scan: &LaserScan,
        guess: Option<&Se2>,
    ) -> Result<Option<Alignment<Se2>>, AlignmentError> {
        if let Some(guess) = guess {
            check::all_finite("guess", &[guess.x(), guess.y(), guess.yaw()])?;
        }
        let mut points = Vec::new();
        usable_points_into(scan, &self.params, &mut self.derived.squares, &mut points);
        let poses = self.graph.poses();
        let mut anchors: Vec<usize> = Vec::new();
        let (window, starts) = if let Some(guess) = guess {
            anchors.extend(self.nearest(guess));
            (self.params.closure.window, vec![*guess; anchors.len()])
        } else {
            for (index, pose) in poses.iter().enumerate() {
                let off = |other: &usize| (poses[*other].translation() - pose.translation()).norm();
                let turned = |other: &usize| angle_difference(poses[*other].yaw(), pose.yaw()).abs();
                if anchors.iter().all(|other| off(other) > SPACING || turned(other) > 0.5 * PI) {
                    anchors.push(index);
                }
            }
            let distance = self.params.closure.window.distance.min(SPACING);
            (SearchWindow { distance, angle: PI }, anchors.iter().map(|anchor| poses[*anchor]).collect())
        };
        let keys = Keys { scans: &self.keys, poses };
        let look = |i: usize| {
            // Not often enough for memory to be kept.
            let mut seeker = Seeker::new(&self.params)?;
            let found =
                closures::look_around(keys, anchors[i], &points, &starts[i], window, &self.params, &mut seeker)?;
            Ok(found.map(|found| (anchors[i], found)))
        };
        let better = |a: Found, b: Found| {
            let (a, b) = (a?, b?);
            let score = |found: &Option<(usize, Alignment<Se2>)>| found.as_ref().map_or(-1.0, |(_, found)| found.score);
            Ok(if score(&b) > score(&a) { b } else { a })
        };
        let Some((anchor, found)) = self.derived.par.map_reduce(anchors.len(), look, better).transpose()?.flatten()
        else {
            return Ok(None);
        };
        let here = poses[anchor].compose(&found.target_from_source);
        let begun = u32::from(!self.frozen);
        self.drive += begun;
        self.settle(&here).inspect_err(|_| self.drive -= begun)?;
        (self.last_odometry, self.last_motion) = (None, Se2::default());
        self.pending.clear();
        Ok(Some(found))
    }

    /// The key scan that sees most of what can be seen from a pose.
    fn nearest(&self, map_from_base: &Se2) -> Option<usize> {
        let far = |pose: &Se2| apart(pose, map_from_base);
        let poses = self.graph.poses().iter().enumerate();
        poses.min_by(|a, b| far(a.1).total_cmp(&far(b.1))).map(|(index, _)| index)
    }

    /// Makes the key scan nearest to a pose the anchor, and the target of those around it; nothing where that fails.
    fn settle(&mut self, map_from_base: &Se2) -> Result<(), AlignmentError> {
        let Some(nearest) = self.nearest(map_from_base) else { return Ok(()) };
        let before = (self.anchor, self.anchor_from_base, self.since_key);
        self.anchor = nearest as u32;
        self.anchor_from_base = self.graph.poses()[nearest].between(map_from_base);
        // Odometry does not know the way from the new anchor to here.
        self.since_key = None;
        let aimed = self.aim();
        if aimed.is_err() {
            (self.anchor, self.anchor_from_base, self.since_key) = before;
        }
        Ok(aimed?)
    }

    /// In a map that stays: another anchor where one is nearer by more than the way between key scans.
    pub(super) fn follow(&mut self) -> Result<(), AlignmentError> {
        let is_far = self.anchor_from_base.translation().norm() >= self.params.key_distance
            || self.anchor_from_base.yaw().abs() >= self.params.key_angle;
        if !is_far {
            return Ok(());
        }
        let here = self.map_from_base();
        match self.nearest(&here) {
            Some(nearest) if nearest as u32 != self.anchor => self.settle(&here),
            _ => Ok(()),
        }
    }

    /// Key scans that the front end matches against: the last ones of this drive, and those around the anchor where they are too few.
    pub(super) fn chain(&self) -> Vec<usize> {
        let most = self.params.chain;
        let mut chain: Vec<usize> = Vec::new();
        if !self.frozen {
            let own = self.keys.iter().enumerate().rev().take_while(|(_, key)| key.drive == self.drive);
            chain.extend(own.take(most).map(|(index, _)| index));
        }
        let old = self.frozen || self.keys.first().is_some_and(|key| key.drive != self.drive);
        if old && chain.len() < most {
            let poses = self.graph.poses();
            let here = poses[self.anchor as usize];
            let far = |index: &usize| apart(&poses[*index], &here);
            let first_own = chain.last().copied().unwrap_or(self.keys.len());
            let mut others: Vec<usize> = (0..first_own).collect();
            others.sort_by(|a, b| far(a).total_cmp(&far(b)).then(a.cmp(b)));
            chain.extend(others.into_iter().take(most - chain.len()));
        }
        chain
    }
}
