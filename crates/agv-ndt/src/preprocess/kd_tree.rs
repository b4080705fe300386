//! Nearest points: a balanced kd-tree in one list.
//!
//! Points are put in the order of the tree, each half by the median of its longest side, so that a node is a range of the list and
//! needs a split value only (Bentley 1975; Friedman, Bentley and Finkel 1977). Building is O(n log n), a query O(log n) on average
//! and without allocation; ties go to the point that came first, so that the answers do not depend on the tree.

use agv_core::sensors::PointSource;
use nalgebra::Vector3;

/// Points per leaf.
const LEAF: usize = 8;

/// Most neighbours that a query gives.
pub const MAX_NEIGHBOURS: usize = 32;

/// A kd-tree over the finite points of a cloud.
///
/// ```
/// use agv_core::{nalgebra::Vector3, sensors::PointCloud};
/// use agv_ndt::preprocess::KdTree;
///
/// let cloud = PointCloud::from_points((0..100).map(|i| Vector3::new(i as f32, 0.0, 0.0)));
/// let mut tree = KdTree::default();
/// tree.rebuild(&cloud);
/// let found = tree.nearest(&Vector3::new(41.7, 1.0, 0.0), 2.0).ok_or("none")?;
/// assert_eq!(found.index, 42);
/// assert!(tree.nearest(&Vector3::new(0.0, 9.0, 0.0), 2.0).is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct KdTree {
    points: Vec<Entry>,
    nodes: Vec<Node>,
    /// Points of the cloud, with those that are not finite.
    source_len: usize,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Entry {
    position: [f32; 3],
    /// Place in the cloud.
    index: u32,
}

/// A range of the list that is cut in the middle.
#[derive(Debug, Clone, Copy, Default)]
struct Node {
    axis: u8,
    value: f32,
}

/// A point near a query.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Neighbour {
    /// Place of the point in the cloud.
    pub index: u32,
    /// Squared distance, in square metres.
    pub squared_distance: f32,
}

impl Neighbour {
    fn before(self, other: Self) -> bool {
        (self.squared_distance, self.index) < (other.squared_distance, other.index)
    }
}

impl KdTree {
    /// Takes the finite points of a cloud; the memory is used again.
    pub fn rebuild(&mut self, cloud: &(impl PointSource + ?Sized)) {
        self.points.clear();
        self.nodes.clear();
        self.source_len = cloud.len();
        for index in 0..cloud.len() {
            let point = cloud.point(index);
            if point.iter().all(|v| v.is_finite()) {
                self.points.push(Entry { position: point.into(), index: index as u32 });
            }
        }
        split(&mut self.points, &mut self.nodes, 0);
    }

    /// Points in the tree.
    pub const fn len(&self) -> usize {
        self.points.len()
    }

    /// Points of the cloud that the tree was built of, with those that are not finite: neighbours' indices are below.
    pub const fn source_len(&self) -> usize {
        self.source_len
    }

    /// Whether there are no points.
    pub const fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The nearest point, if it is no farther than `reach` metres.
    pub fn nearest(&self, query: &Vector3<f32>, reach: f32) -> Option<Neighbour> {
        let mut found = [Neighbour::default(); 1];
        (self.nearest_into(query, reach, &mut found) == 1).then_some(found[0])
    }

    /// Writes the nearest points no farther than `reach` metres to `out`, nearest first, and says how many there are:
    /// none within a reach that is negative or NaN.
    pub fn nearest_into(&self, query: &Vector3<f32>, reach: f32, out: &mut [Neighbour]) -> usize {
        if reach.is_nan() || reach < 0.0 {
            return 0;
        }
        let mut search = Search { query: (*query).into(), reach: reach * reach, found: 0, out };
        if !self.points.is_empty() && !search.out.is_empty() {
            search.visit(&self.points, &self.nodes, 0);
        }
        search.found
    }
}

/// Puts a range in order and notes its cuts; the children of node `i` are `2 i + 1` and `2 i + 2`.
fn split(points: &mut [Entry], nodes: &mut Vec<Node>, node: usize) {
    if points.len() <= LEAF {
        return;
    }
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for entry in &*points {
        for axis in 0..3 {
            low[axis] = low[axis].min(entry.position[axis]);
            high[axis] = high[axis].max(entry.position[axis]);
        }
    }
    let width = |axis: usize| high[axis] - low[axis];
    let axis = (1..3).fold(0, |best, axis| if width(axis) > width(best) { axis } else { best });
    let middle = points.len() / 2;
    let order = |a: &Entry, b: &Entry| a.position[axis].total_cmp(&b.position[axis]).then(a.index.cmp(&b.index));
    points.select_nth_unstable_by(middle, order);
    if nodes.len() <= node {
        nodes.resize(node + 1, Node::default());
    }
    nodes[node] = Node { axis: axis as u8, value: points[middle].position[axis] };
    let (left, right) = points.split_at_mut(middle);
    split(left, nodes, 2 * node + 1);
    split(right, nodes, 2 * node + 2);
}

/// A query under way.
struct Search<'a> {
    query: [f32; 3],
    /// Squared distance that a point must not exceed.
    reach: f32,
    found: usize,
    out: &'a mut [Neighbour],
}

impl Search<'_> {
    fn visit(&mut self, points: &[Entry], nodes: &[Node], node: usize) {
        if points.len() <= LEAF {
            for entry in points {
                let d = [0, 1, 2].map(|axis| entry.position[axis] - self.query[axis]);
                let squared_distance = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                if squared_distance <= self.reach {
                    self.take(Neighbour { index: entry.index, squared_distance });
                }
            }
            return;
        }
        // Ranges are cut exactly as when the tree was built, so that the node is there.
        let Node { axis, value } = nodes[node];
        let (left, right) = points.split_at(points.len() / 2);
        let aside = self.query[usize::from(axis)] - value;
        let children = [(left, 2 * node + 1), (right, 2 * node + 2)];
        let [near, far] = if aside < 0.0 { children } else { [children[1], children[0]] };
        self.visit(near.0, nodes, near.1);
        if aside * aside <= self.reach {
            self.visit(far.0, nodes, far.1);
        }
    }

    /// Keeps the nearest ones in order.
    fn take(&mut self, neighbour: Neighbour) {
        if self.found == self.out.len() {
            if !neighbour.before(self.out[self.found - 1]) {
                return;
            }
        } else {
            self.found += 1;
        }
        let mut place = self.found - 1;
        while place > 0 && neighbour.before(self.out[place - 1]) {
            self.out[place] = self.out[place - 1];
            place -= 1;
        }
        self.out[place] = neighbour;
        if self.found == self.out.len() {
            self.reach = self.reach.min(self.out[self.found - 1].squared_distance);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::sensors::PointCloud;
    use proptest::prelude::*;

    proptest! {
        /// The nearest points are those of a look at all of them, ties included.
        #[test]
        fn the_nearest_are_those_of_brute_force(
            points in prop::collection::vec(prop::array::uniform3(-5..5_i32), 0..200),
            query in prop::array::uniform3(-6.0..6.0_f32), reach in 0.0..6.0_f32, count in 1..20_usize,
        ) {
            let points: Vec<_> = points.into_iter().map(|p| Vector3::from(p.map(|v| v as f32 * 0.5))).collect();
            let query = Vector3::from(query);
            let mut all: Vec<_> = points.iter().enumerate().map(|(index, p)| {
                let d = p - query;
                Neighbour { index: index as u32, squared_distance: d.x * d.x + d.y * d.y + d.z * d.z }
            }).filter(|n| n.squared_distance <= reach * reach).collect();
            all.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.index.cmp(&b.index)));
            all.truncate(count);
            let mut tree = KdTree::default();
            tree.rebuild(&PointCloud::from_points(points));
            let mut found = vec![Neighbour::default(); count];
            let len = tree.nearest_into(&query, reach, &mut found);
            prop_assert_eq!(&found[..len], &all[..]);
            prop_assert_eq!(tree.nearest(&query, reach), all.first().copied());
        }
    }

    #[test]
    fn points_that_are_not_finite_are_nobodys_neighbours() {
        let mut tree = KdTree::default();
        let points = [f32::NAN, 1.0, f32::INFINITY].map(|x| Vector3::new(x, 0.0, 0.0));
        tree.rebuild(&PointCloud::from_points(points));
        assert_eq!((tree.len(), tree.nearest(&Vector3::zeros(), f32::INFINITY).map(|n| n.index)), (1, Some(1)));
        assert_eq!(tree.nearest(&Vector3::repeat(f32::NAN), 9.0), None);
        assert!(
            [-2.0, f32::NAN, f32::NEG_INFINITY].iter().all(|&reach| tree.nearest(&Vector3::zeros(), reach).is_none())
        );
        assert_eq!(tree.source_len(), 3);
        tree.rebuild(&PointCloud::default());
        assert!(tree.is_empty() && tree.nearest(&Vector3::zeros(), 1.0).is_none());
    }
}
