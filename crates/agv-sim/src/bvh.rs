//! A bounding volume hierarchy over boxes in `D` dimensions: the planar and the spatial world share it.
//!
//! Built once by the binned surface area heuristic (Wald 2007): a node is split where the boxes' areas times their
//! counts add up to least. A ray then visits O(log n) nodes, nearest first. The tree depends on the boxes alone and
//! ties are broken by index, so it is the same on every run.

/// Bins of the split search per axis.
const BINS: usize = 16;
/// Most entries of a leaf.
const LEAF: usize = 3;
/// Depth from which nodes are halved by count, so that the traversal's stack is bounded by `2 * HALVING_DEPTH`.
const HALVING_DEPTH: usize = 32;
/// Stands for an infinite reciprocal, so that zero times it is zero and not NaN.
const HUGE: f64 = 1e290;

/// An axis-aligned box, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds<const D: usize> {
    pub(crate) min: [f64; D],
    pub(crate) max: [f64; D],
}

/// The lesser of two numbers that are not NaN; compiles to one instruction, unlike `f64::min`.
#[inline]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The greater of two numbers that are not NaN.
#[inline]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

impl<const D: usize> Bounds<D> {
    const EMPTY: Self = Self { min: [f64::INFINITY; D], max: [f64::NEG_INFINITY; D] };

    /// The least box around the points.
    pub(crate) fn around(points: impl IntoIterator<Item = [f64; D]>) -> Self {
        points.into_iter().fold(Self::EMPTY, |bounds, p| bounds.union(&Self { min: p, max: p }))
    }

    /// The box grown by `margin` on every side.
    pub(crate) fn grown(mut self, margin: f64) -> Self {
        self.min.iter_mut().for_each(|v| *v -= margin);
        self.max.iter_mut().for_each(|v| *v += margin);
        self
    }

    pub(crate) fn union(mut self, other: &Self) -> Self {
        for axis in 0..D {
            self.min[axis] = lesser(self.min[axis], other.min[axis]);
            self.max[axis] = greater(self.max[axis], other.max[axis]);
        }
        self
    }

    /// Squared gap between two boxes; zero if they overlap.
    pub(crate) fn gap_squared(&self, other: &Self) -> f64 {
        let mut sum = 0.0;
        for axis in 0..D {
            let gap = greater(0.0, greater(self.min[axis] - other.max[axis], other.min[axis] - self.max[axis]));
            sum += gap * gap;
        }
        sum
    }

    fn centre(&self, axis: usize) -> f64 {
        0.5 * (self.min[axis] + self.max[axis])
    }

    /// What the chance of a random line to meet the box is proportional to: perimeter in the plane, area in space.
    fn measure(&self) -> f64 {
        let extent = |axis: usize| greater(0.0, self.max[axis] - self.min[axis]);
        let mut sum = 0.0;
        for axis in 0..D {
            sum += if D == 2 { extent(axis) } else { extent(axis) * extent((axis + 1) % D) };
        }
        sum
    }
}

/// A half-line prepared for box tests.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray<const D: usize> {
    pub(crate) origin: [f64; D],
    pub(crate) direction: [f64; D],
    reciprocal: [f64; D],
}

impl<const D: usize> Ray<D> {
    #[inline]
    pub(crate) fn new(origin: [f64; D], direction: [f64; D]) -> Self {
        let reciprocal = direction.map(|d| if d.abs() > 1.0 / HUGE { 1.0 / d } else { HUGE.copysign(d) });
        Self { origin, direction, reciprocal }
    }

    /// Where the line of the ray enters and leaves the box; in the wrong order if it misses.
    #[inline]
    pub(crate) fn span(&self, bounds: &Bounds<D>) -> (f64, f64) {
        let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..D {
            let a = (bounds.min[axis] - self.origin[axis]) * self.reciprocal[axis];
            let b = (bounds.max[axis] - self.origin[axis]) * self.reciprocal[axis];
            near = greater(near, lesser(a, b));
            far = lesser(far, greater(a, b));
        }
        (near, far)
    }

    /// Where the ray enters the box, if it does before `limit`; zero if it starts inside.
    #[inline]
    fn entry(&self, bounds: &Bounds<D>, limit: f64) -> Option<f64> {
        let (near, far) = self.span(bounds);
        let near = greater(near, 0.0);
        (near <= lesser(far, limit)).then_some(near)
    }
}

#[derive(Debug, Clone, Copy)]
struct Node<const D: usize> {
    bounds: Bounds<D>,
    /// First entry of a leaf, or left child of an inner node; the right child follows it.
    first: u32,
    /// Entries of a leaf; zero for an inner node.
    count: u32,
}

/// The hierarchy. Entries are numbered by their place in the order that [`build`](Self::build) returns.
#[derive(Debug, Clone)]
pub(crate) struct Bvh<const D: usize> {
    nodes: Vec<Node<D>>,
}

impl<const D: usize> Bvh<D> {
    /// Builds the tree over `boxes`; the owner then stores its entries in the order returned, so that leaves are
    /// contiguous in memory. Takes O(n log n).
    pub(crate) fn build(boxes: &[Bounds<D>]) -> (Self, Vec<usize>) {
        let mut order: Vec<usize> = (0..boxes.len()).collect();
        if boxes.is_empty() {
            return (Self { nodes: Vec::new() }, order);
        }
        let mut nodes = vec![Node { bounds: Bounds::EMPTY, first: 0, count: 0 }];
        split(boxes, &mut order, 0, 0, 0, &mut nodes);
        // Rounding in the box test must not lose what touches a box's face.
        for node in &mut nodes {
            let scale = node.bounds.min.iter().chain(&node.bounds.max).fold(1.0, |m, v| greater(m, v.abs()));
            node.bounds = node.bounds.grown(1e-12 * scale);
        }
        (Self { nodes }, order)
    }

    /// The nearest hit up to `limit`. `test(entry, limit)` gives the distance at which the ray meets an entry, if it
    /// does before `limit`.
    #[inline]
    pub(crate) fn cast(
        &self,
        ray: &Ray<D>,
        mut limit: f64,
        mut test: impl FnMut(usize, f64) -> Option<f64>,
    ) -> Option<(f64, usize)> {
        let mut best = None;
        let mut stack = [(0_u32, 0.0_f64); 2 * HALVING_DEPTH];
        let mut depth = 0;
        let root = self.nodes.first()?;
        let mut current = ray.entry(&root.bounds, limit).map(|_| 0_u32);
        loop {
            let Some(index) = current else {
                // Back up to the nearest node that was put off and may still hold something nearer.
                if depth == 0 {
                    return best;
                }
                depth -= 1;
                let (index, entry) = stack[depth];
                current = (entry <= limit).then_some(index);
                continue;
            };
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for entry in node.first as usize..(node.first + node.count) as usize {
                    if let Some(distance) = test(entry, limit) {
                        limit = distance;
                        best = Some((distance, entry));
                    }
                }
                current = None;
                continue;
            }
            let (left, right) = (node.first, node.first + 1);
            let entries = (
                ray.entry(&self.nodes[left as usize].bounds, limit),
                ray.entry(&self.nodes[right as usize].bounds, limit),
            );
            current = match entries {
                (Some(a), Some(b)) => {
                    let (near, far, put_off) = if a <= b { (left, right, b) } else { (right, left, a) };
                    // The depth is bounded by construction, see HALVING_DEPTH.
                    stack[depth] = (far, put_off);
                    depth += 1;
                    Some(near)
                }
                (Some(_), None) => Some(left),
                (None, Some(_)) => Some(right),
                (None, None) => None,
            };
        }
    }

    /// The least of `distance(entry)` over all entries, or `limit` if none is below it. `query` bounds the body that
    /// distances are measured from.
    pub(crate) fn nearest(&self, query: &Bounds<D>, limit: f64, mut distance: impl FnMut(usize) -> f64) -> f64 {
        let mut best = limit;
        let mut stack = [0_u32; 2 * HALVING_DEPTH];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 && best > 0.0 {
            depth -= 1;
            let node = &self.nodes[stack[depth] as usize];
            if node.bounds.gap_squared(query) > best * best {
                continue;
            }
            if node.count > 0 {
                for entry in node.first as usize..(node.first + node.count) as usize {
                    best = lesser(best, distance(entry));
                }
            } else {
                stack[depth] = node.first;
                stack[depth + 1] = node.first + 1;
                depth += 2;
            }
        }
        best
    }
}

/// Fills node `slot` with `order[..]`, whose first entry has the place `first`, and its descendants.
fn split<const D: usize>(
    boxes: &[Bounds<D>],
    order: &mut [usize],
    first: usize,
    slot: usize,
    depth: usize,
    nodes: &mut Vec<Node<D>>,
) {
    let bounds = order.iter().fold(Bounds::EMPTY, |b, &i| b.union(&boxes[i]));
    if order.len() <= LEAF {
        nodes[slot] = Node { bounds, first: first as u32, count: order.len() as u32 };
        return;
    }
    let middle = partition(boxes, order, depth);
    let left = nodes.len();
    nodes[slot] = Node { bounds, first: left as u32, count: 0 };
    nodes.extend([Node { bounds, first: 0, count: 0 }; 2]);
    let (low, high) = order.split_at_mut(middle);
    split(boxes, low, first, left, depth + 1, nodes);
    split(boxes, high, first + middle, left + 1, depth + 1, nodes);
}

/// Reorders so that the entries before the returned place go left; both sides get at least one.
fn partition<const D: usize>(boxes: &[Bounds<D>], order: &mut [usize], depth: usize) -> usize {
    let centres = Bounds::around(order.iter().map(|&i| std::array::from_fn(|axis| boxes[i].centre(axis))));
    let widest = (0..D).max_by(|&a, &b| {
        (centres.max[a] - centres.min[a]).total_cmp(&(centres.max[b] - centres.min[b])).then(b.cmp(&a))
    });
    if depth < HALVING_DEPTH {
        let best = (0..D).filter_map(|axis| best_bin(boxes, order, &centres, axis)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, axis, bin)) = best {
            order.sort_by_key(|&i| (bin_of(&centres, axis, &boxes[i]) > bin, i));
            return order.partition_point(|&i| bin_of(&centres, axis, &boxes[i]) <= bin);
        }
    }
    let axis = widest.unwrap_or(0);
    order.sort_by(|&a, &b| boxes[a].centre(axis).total_cmp(&boxes[b].centre(axis)).then(a.cmp(&b)));
    order.len() / 2
}

fn bin_of<const D: usize>(centres: &Bounds<D>, axis: usize, entry: &Bounds<D>) -> usize {
    let extent = centres.max[axis] - centres.min[axis];
    (((entry.centre(axis) - centres.min[axis]) / extent * BINS as f64) as usize).min(BINS - 1)
}

/// Cost, axis and last bin on the left of the best split along `axis`; none if all centres coincide there.
fn best_bin<const D: usize>(
    boxes: &[Bounds<D>],
    order: &[usize],
    centres: &Bounds<D>,
    axis: usize,
) -> Option<(f64, usize, usize)> {
    if centres.max[axis] <= centres.min[axis] {
        return None;
    }
    let mut bins = [(Bounds::EMPTY, 0_usize); BINS];
    for &index in order {
        let bin = &mut bins[bin_of(centres, axis, &boxes[index])];
        *bin = (bin.0.union(&boxes[index]), bin.1 + 1);
    }
    let cost = |part: &[(Bounds<D>, usize)]| {
        let (bounds, count) = part.iter().fold((Bounds::EMPTY, 0), |a, b| (a.0.union(&b.0), a.1 + b.1));
        (count > 0).then(|| bounds.measure() * count as f64)
    };
    (0..BINS - 1)
        .filter_map(|bin| {
            let (left, right) = bins.split_at(bin + 1);
            Some((cost(left)? + cost(right)?, axis, bin))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn boxes() -> impl Strategy<Value = Vec<Bounds<2>>> {
        // Coarse coordinates make coinciding boxes, flat boxes and touching faces common.
        let entry = (-8_i32..8, -8_i32..8, 0_i32..4, 0_i32..4).prop_map(|(x, y, w, h)| Bounds {
            min: [f64::from(x), f64::from(y)],
            max: [f64::from(x + w), f64::from(y + h)],
        });
        prop::collection::vec(entry, 0..60)
    }

    proptest! {
        /// The tree finds the entry that a loop over all boxes finds, axis-parallel rays on faces included.
        #[test]
        fn casting_agrees_with_brute_force(boxes in boxes(), x in -9_i32..9, y in -9_i32..9, turn in 0_u32..32) {
            let (bvh, order) = Bvh::build(&boxes);
            let angle = f64::from(turn) * std::f64::consts::PI / 16.0;
            let direction = if turn % 8 == 0 { [angle.cos().round(), angle.sin().round()] } else { [angle.cos(), angle.sin()] };
            let ray = Ray::new([f64::from(x), f64::from(y)], direction);
            let found = bvh.cast(&ray, 30.0, |entry, limit| ray.entry(&boxes[order[entry]], limit).filter(|t| *t < limit));
            let all = boxes.iter().filter_map(|b| ray.entry(b, 30.0)).min_by(f64::total_cmp);
            prop_assert_eq!(found.map(|(t, _)| t), all);
        }

        #[test]
        fn nearest_agrees_with_brute_force(boxes in boxes(), x in -20.0..20.0_f64, y in -20.0..20.0_f64) {
            let (bvh, order) = Bvh::build(&boxes);
            let query = Bounds { min: [x, y], max: [x + 1.0, y + 0.5] };
            let found = bvh.nearest(&query, 12.0, |entry| boxes[order[entry]].gap_squared(&query).sqrt());
            let all = boxes.iter().map(|b| b.gap_squared(&query).sqrt()).fold(12.0, f64::min);
            prop_assert_eq!(found, all);
        }
    }

    /// Coinciding boxes cannot be told apart by any plane: the depth must stay bounded all the same.
    #[test]
    fn coinciding_boxes_are_halved() {
        let boxes = vec![Bounds { min: [0.0; 3], max: [1.0; 3] }; 5000];
        let (bvh, order) = Bvh::build(&boxes);
        let ray = Ray::new([-1.0, 0.5, 0.5], [1.0, 0.0, 0.0]);
        assert_eq!(order.len(), 5000);
        assert_eq!(
            bvh.cast(&ray, 9.0, |e, limit| ray.entry(&boxes[e], limit).filter(|t| *t < limit)).map(|h| h.0),
            Some(1.0)
        );
    }
}
