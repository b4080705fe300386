//! Where to look for a key frame among older ones.

use super::{KeyFrameMap, LoopParams};
use agv_core::{
    geometry::{LieGroup, Se3, So3},
    nalgebra::Vector3,
};
use agv_ndt::places::{PlaceMatch, ScanContext};

/// How far apart two places may be whose clouds overlap enough, in metres, beyond the window.
const OVERLAP: f64 = 3.0;

/// Distance that half a turn counts as, in metres, when the nearest key frame of a group is chosen.
const TURN_WORTH: f64 = 1.0;

/// A place to look from, and where the vehicle may be there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    pub(super) anchor: usize,
    pub(super) anchor_from_base: Se3,
}

impl LoopParams {
    /// How far from the expected place to look.
    pub(super) const fn window_at(&self, doubt: f64) -> f64 {
        (self.least_window + doubt).min(self.window)
    }
}

impl KeyFrameMap {
    /// Whether a key frame may close a loop with the last one, and is no farther from it than the window allows.
    fn is_within(&self, index: usize) -> bool {
        let (Some(last), Some(here)) = (self.keys.last(), self.graph.poses().last()) else { return false };
        let (Some(key), Some(pose)) = (self.keys.get(index), self.graph.poses().get(index)) else { return false };
        let loops = &self.params.loops;
        // The last one closes none with itself, however short a loop may be.
        index + 1 < self.keys.len()
            && last.way - key.way >= loops.min_way
            && (pose.translation() - here.translation()).norm() <= loops.window_at(self.doubt) + OVERLAP
    }

    /// Groups of older key frames around where the last one should be: of each the nearest, nearest group first.
    pub(super) fn around(&self) -> Vec<Candidate> {
        let poses = self.graph.poses();
        let Some(here) = poses.last() else { return Vec::new() };
        let within: Vec<usize> = (0..poses.len()).filter(|index| self.is_within(*index)).collect();
        let groups = self.groups(&within);
        let mut nearest: Vec<Option<(f64, usize)>> = vec![None; within.len()];
        for (&index, group) in within.iter().zip(groups) {
            let between = poses[index].between(here);
            let off =
                between.translation().norm() + TURN_WORTH * between.rotation().log().norm() / std::f64::consts::PI;
            if nearest[group].is_none_or(|best| off < best.0) {
                nearest[group] = Some((off, index));
            }
        }
        let mut nearest: Vec<(f64, usize)> = nearest.into_iter().flatten().collect();
        nearest.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.truncate(self.params.loops.candidates);
        nearest
            .into_iter()
            .map(|(_, anchor)| Candidate { anchor, anchor_from_base: poses[anchor].between(here) })
            .collect()
    }

    /// Older key frames that look like the last one, the most alike first; matches and query are scratch.
    pub(super) fn look_alikes(&self, query: &ScanContext, matches: &mut Vec<PlaceMatch>) -> Vec<Candidate> {
        let LoopParams { look_alikes, max_distance, .. } = self.params.loops;
        self.places.find_into(query, |place| self.is_within(place), matches);
        let alike = matches.iter().filter(|found| f64::from(found.distance) <= max_distance).take(look_alikes);
        let turned = |yaw: f64| Se3::from_parts(Vector3::zeros(), So3::from_roll_pitch_yaw(0.0, 0.0, yaw));
        alike.map(|found| Candidate { anchor: found.place, anchor_from_base: turned(found.yaw) }).collect()
    }
}
