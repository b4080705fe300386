//! Which key frames are neighbours: those that relations tie together near by.
//!
//! Their numbers do not say: where a place that is known lies between them, two that follow one another may be far
//! apart, and where the vehicle left its old way for a metre, one may stand alone among older ones.

use super::{KeyFrameMap, closures::is_find};
use agv_core::geometry::Se3;

/// How far apart two key frames may be that odometry ties to one group, in distances of key frames.
const GAP: f64 = 4.0;

fn distance(a: &Se3, b: &Se3) -> f64 {
    (a.translation() - b.translation()).norm()
}

impl KeyFrameMap {
    /// For each of some key frames, given in rising order, the place among them of the first that it is tied to,
    /// directly or by others.
    ///
    /// A find ties no farther than a meet on a way that is known may be from the key frame before. From farther away it
    /// may look through a rack into the next aisle, which is a place of its own: whoever is found in one is to be
    /// sought in both.
    pub(super) fn groups(&self, members: &[usize]) -> Vec<usize> {
        let (poses, gap) = (self.graph.poses(), GAP * self.params.distance);
        let reach = self.params.reach.map_or(0.0, |reach| reach.translation);
        let near = gap.min(self.params.distance + reach);
        let ties = self.graph.relations().iter().filter_map(|relation| {
            let (from, to) = (relation.from.index(), relation.to.index());
            let (a, b) = (members.binary_search(&from).ok()?, members.binary_search(&to).ok()?);
            let limit = if is_find(relation) { near } else { gap };
            (distance(poses.get(from)?, poses.get(to)?) <= limit).then_some((a, b))
        });
        let ties: Vec<(usize, usize)> = ties.collect();
        let mut first: Vec<usize> = (0..members.len()).collect();
        // A few rounds: most relations come in the order of the drive.
        loop {
            let mut is_settled = true;
            for &(a, b) in &ties {
                is_settled &= first[a] == first[b];
                let least = first[a].min(first[b]);
                (first[a], first[b]) = (least, least);
            }
            if is_settled {
                return first;
            }
        }
    }

    /// Old key frames whose clouds together make the place of one of them. That one comes first, then those that are
    /// tied to it, the nearest first: at most twice [`neighbours`](super::LoopParams::neighbours), for either side, and
    /// none farther away than so many as that take where they are twice as far apart as
    /// [`distance`](super::KeyFrameParams::distance).
    pub(super) fn neighbours(&self, anchor: usize) -> Vec<usize> {
        let (poses, loops) = (self.graph.poses(), &self.params.loops);
        let (Some(here), Some(last)) = (poses.get(anchor), self.keys.last()) else { return Vec::new() };
        let reach = 2.0 * loops.neighbours as f64 * self.params.distance;
        let off = |index: usize| distance(&poses[index], here);
        // What was seen just now is no place from before.
        let is_old = |index: usize| last.way - self.keys[index].way >= loops.min_way;
        let near: Vec<usize> = (0..self.keys.len() - 1).filter(|&index| is_old(index) && off(index) <= reach).collect();
        let groups = self.groups(&near);
        let Some(own) = near.binary_search(&anchor).ok().map(|place| groups[place]) else { return Vec::new() };
        let tied = near.into_iter().zip(groups).filter(|(_, group)| *group == own);
        let mut tied: Vec<(f64, usize)> = tied.map(|(index, _)| (off(index), index)).collect();
        tied.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        tied.truncate(2 * loops.neighbours + 1);
        tied.into_iter().map(|(_, index)| index).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::mapping::{KeyFrame, KeyFrameParams, closures::Closure};
    use agv_core::{
        geometry::Se2,
        nalgebra::{Matrix6, Vector3},
        sensors::PointCloud,
    };
    use agv_filters::graph::{PoseId, Relation};

    /// Key frames at these places, each related to the one before but where `cut` says so, after ways of a metre each,
    /// and a last one far on.
    fn map(places: &[[f64; 2]], cut: &[u32]) -> KeyFrameMap {
        let mut map = KeyFrameMap::new(KeyFrameParams::default()).unwrap();
        let cloud = PointCloud::from_points([Vector3::new(1.0, 2.0, 3.0)]);
        for (i, [x, y]) in places.iter().enumerate() {
            let to = map.graph.add_pose(Se2::new(*x, *y, 0.0).into()).unwrap();
            map.keys.push(KeyFrame { cloud: cloud.clone(), way: i as f64 });
            if to.0 > 0 && !cut.contains(&to.0) {
                let relation = Relation::new(PoseId(to.0 - 1), to, Se3::default(), Matrix6::identity());
                map.graph.add_relation(relation).unwrap();
            }
        }
        map.way = 1000.0;
        map.graph.add_pose(Se2::new(50.0, 0.0, 0.0).into()).unwrap();
        map.keys.push(KeyFrame { cloud, way: 1000.0 });
        map
    }

    fn find(from: u32, to: u32, from_from_to: Se2) -> Closure {
        let (information, unobserved) = (Matrix6::identity(), Matrix6::zeros());
        Closure { from, to, from_from_to: from_from_to.into(), information, inlier_ratio: 0.9, unobserved }
    }

    /// A lane that was driven until it was known, and went on in another one six metres aside: the numbers go on as if
    /// nothing were between.
    #[test]
    fn what_follows_far_away_is_no_neighbour() {
        let places: Vec<_> = (0..10).map(|i| [f64::from(i % 5), if i < 5 { 0.0 } else { 6.0 }]).collect();
        let map = map(&places, &[]);
        assert_eq!(map.neighbours(4), [4, 3, 2, 1, 0]);
        assert_eq!(map.neighbours(5), [5, 6, 7, 8, 9]);
        assert_eq!(map.groups(&[3, 4, 5, 6]), [0, 0, 2, 2]);
    }

    /// One key frame that stands alone among older ones, to which it is tied, is of their place; one that nothing ties
    /// to them is not.
    #[test]
    fn what_is_tied_near_by_is_a_neighbour() {
        let mut map =
            map(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [30.0, 0.0], [31.0, 0.0], [1.2, 0.8], [0.8, -0.8]], &[3, 5, 6]);
        assert_eq!(map.neighbours(5), [5]);
        map.graph.add_relation(find(1, 5, Se2::new(0.2, 0.8, 0.0)).relation()).unwrap();
        assert_eq!(map.neighbours(5), [5, 1, 2, 0]);
        assert_eq!(map.neighbours(6), [6]);
        assert_eq!(map.neighbours(7), [0_usize; 0], "the last one is no place from before");
    }

    /// Two lanes three metres apart that one find ties together through the racks: the vehicle between them is sought
    /// in both.
    #[test]
    fn lanes_that_see_each_other_are_two_places() {
        let places: Vec<_> = (0..10).map(|i| [f64::from(i % 5), if i < 5 { 0.0 } else { 3.0 }]).collect();
        let mut map = map(&places, &[5]);
        map.graph.add_relation(find(2, 7, Se2::new(0.0, 3.0, 0.0)).relation()).unwrap();
        map.graph.set_pose(PoseId(10), Se2::new(2.0, 1.4, 0.0).into()).unwrap();
        let anchors: Vec<usize> = map.around().iter().map(|candidate| candidate.anchor).collect();
        assert_eq!(anchors, [2, 7]);
        assert_eq!(map.neighbours(2), [2, 1, 3, 0, 4]);
        // However short a loop may be, it has two ends.
        map.params.loops.min_way = 0.0;
        let anchors: Vec<usize> = map.around().iter().map(|candidate| candidate.anchor).collect();
        assert_eq!(anchors, [2, 7]);
        assert_eq!(map.neighbours(10), [0_usize; 0]);
    }
}
