//! The trajectories of all particles as one tree: particles that come of one ancestor share its past.
//!
//! Nodes lie in one array, parents before their children. Branches that died out are swept when they fill half of it, so that
//! the memory is that of the living branches, and the time O(1) per node on average.

use agv_core::geometry::Se2;

const NO_PARENT: u32 = u32::MAX;

#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Node {
    pose: Se2,
    parent: u32,
}

/// A tree of poses, and the leaf of each particle.
#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct TrajectoryTree {
    nodes: Vec<Node>,
    leaves: Vec<u32>,
    /// Nodes that were left by the last sweep.
    swept: usize,
}

impl TrajectoryTree {
    /// All of `count` particles begin at this pose.
    pub(super) fn begin(&mut self, pose: Se2, count: usize) {
        *self = Self { nodes: vec![Node { pose, parent: NO_PARENT }], leaves: vec![0; count], swept: 1 };
    }

    /// Every particle goes on to its pose.
    pub(super) fn extend(&mut self, poses: &[Se2]) {
        for (leaf, &pose) in self.leaves.iter_mut().zip(poses) {
            let node = Node { pose, parent: *leaf };
            *leaf = self.nodes.len() as u32;
            self.nodes.push(node);
        }
        if self.nodes.len() > 2 * self.swept + 64 * self.leaves.len() {
            self.sweep();
        }
    }

    /// Particle `i` now comes of `ancestors[i]`.
    pub(super) fn resample(&mut self, ancestors: &[u32]) {
        self.leaves = ancestors.iter().filter_map(|&a| self.leaves.get(a as usize).copied()).collect();
    }

    /// Poses of a particle, the first first.
    pub(super) fn path(&self, particle: usize) -> Vec<Se2> {
        let mut poses = Vec::new();
        let mut at = self.leaves.get(particle).copied();
        while let Some(node) = at.and_then(|i| self.nodes.get(i as usize)) {
            poses.push(node.pose);
            at = (node.parent != NO_PARENT).then_some(node.parent);
        }
        poses.reverse();
        poses
    }

    /// Bytes of nodes and leaves.
    pub(super) const fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>() + self.leaves.capacity() * size_of::<u32>()
    }

    /// Drops what no leaf comes of.
    fn sweep(&mut self) {
        let mut alive = vec![false; self.nodes.len()];
        for &leaf in &self.leaves {
            let mut at = leaf as usize;
            while let Some(seen) = alive.get_mut(at).filter(|seen| !**seen) {
                *seen = true;
                at = self.nodes[at].parent as usize;
            }
        }
        // Parents come first, so that their new places are known.
        let mut places = vec![NO_PARENT; self.nodes.len()];
        let mut kept = 0;
        for old in 0..self.nodes.len() {
            if alive[old] {
                let Node { pose, parent } = self.nodes[old];
                let parent = places.get(parent as usize).copied().unwrap_or(NO_PARENT);
                self.nodes[kept] = Node { pose, parent };
                places[old] = kept as u32;
                kept += 1;
            }
        }
        self.nodes.truncate(kept);
        self.swept = kept;
        for leaf in &mut self.leaves {
            *leaf = places[*leaf as usize];
        }
    }

    /// Whether each leaf leads to a root, over as many nodes as `length`.
    #[cfg(feature = "serde")]
    pub(super) fn is_sound(&self, particles: usize, length: usize) -> bool {
        let before = |(i, node): (usize, &Node)| node.parent == NO_PARENT || (node.parent as usize) < i;
        if length == 0 {
            return self.nodes.is_empty() && self.leaves.is_empty() && self.swept == 0;
        }
        self.nodes.iter().enumerate().all(before)
            && self.swept <= self.nodes.len()
            && self.leaves.len() == particles
            && (0..particles).all(|particle| self.path(particle).len() == length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::compute::Seed;
    use rand::RngExt;

    /// Against whole trajectories, copied at every resampling.
    #[test]
    fn paths_are_those_of_copies_and_memory_is_that_of_the_living() {
        let (mut tree, count) = (TrajectoryTree::default(), 20);
        tree.begin(Se2::default(), count);
        let mut copies = vec![vec![Se2::default()]; count];
        let mut stream = Seed(1).stream(0, 0);
        for step in 0..2000_u32 {
            let poses: Vec<_> = (0..count).map(|i| Se2::new(f64::from(step), i as f64, 0.0)).collect();
            tree.extend(&poses);
            copies.iter_mut().zip(&poses).for_each(|(copy, &pose)| copy.push(pose));
            if step % 3 == 0 {
                let mut ancestors: Vec<u32> = (0..count).map(|_| stream.random_range(0..count as u32)).collect();
                ancestors.sort_unstable();
                tree.resample(&ancestors);
                copies = ancestors.iter().map(|&a| copies[a as usize].clone()).collect();
            }
        }
        for (particle, copy) in copies.iter().enumerate() {
            assert_eq!(&tree.path(particle), copy);
        }
        // One trunk of 2000 nodes and a crown of some generations, at most doubled, and the slack.
        assert!(tree.nodes.len() < 2 * 2600 + 64 * count, "{}", tree.nodes.len());
    }
}
