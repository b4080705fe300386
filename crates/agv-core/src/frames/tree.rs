//! The tree itself: frames, edges, and what may be added to them.

use super::{
    FrameError,
    history::{History, Insertion},
};
use crate::{
    Error, check,
    geometry::{LieGroup, Se3},
    time::Stamp,
};
use std::collections::BTreeMap;

/// How much of the past a [`FrameTree`] keeps of each moving edge.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FrameTreeParams {
    /// Age, relative to the newest transform of the edge, beyond which transforms are dropped, in seconds.
    pub history: f64,
    /// Most transforms kept per edge; the memory for them is taken when the edge is first seen.
    pub capacity: usize,
}

impl Default for FrameTreeParams {
    /// 10 s as in tf2, at up to 200 transforms a second.
    fn default() -> Self {
        Self { history: 10.0, capacity: 2000 }
    }
}

/// Frames joined by rigid transforms, each frame but the root with one parent.
///
/// Edges are *static* (a sensor's mount) or *moving* (odometry), where stamped transforms may arrive in any order.
/// Look-ups between any two frames of a tree interpolate every moving edge on the way at the stamp that is asked for,
/// along the geodesic of SE(3); they never extrapolate and never allocate. A look-up costs O(depth log history).
///
/// The chain of an indoor vehicle:
///
/// ```
/// use agv_core::frames::{FrameTree, FrameTreeParams};
/// use agv_core::geometry::{Se2, Se3, So3};
/// use agv_core::nalgebra::Vector3;
/// use agv_core::time::Stamp;
///
/// let mut frames = FrameTree::new(FrameTreeParams::default())?;
/// let offset = |x, y, z| Se3::from_parts(Vector3::new(x, y, z), So3::default());
/// frames.set_static("base_footprint", "base_link", offset(0.0, 0.0, 0.1))?;
/// frames.set_static("base_link", "imu_link", offset(0.0, 0.0, 0.05))?;
/// frames.set_static("base_link", "lidar_link", offset(0.05, 0.0, 0.0))?;
/// for (seconds, x) in [(1.0, 0.0), (2.0, 1.0)] {
///     let stamp = Stamp::from_seconds(seconds);
///     frames.insert("map", "odom", stamp, Se2::new(0.0, 5.0, 0.0).into())?;
///     frames.insert("odom", "base_footprint", stamp, Se2::new(x, 0.0, 0.0).into())?;
/// }
///
/// let map_from_lidar = frames.lookup("map", "lidar_link", Stamp::from_seconds(1.5))?;
/// assert!((map_from_lidar.translation() - Vector3::new(0.55, 5.0, 0.1)).norm() < 1e-12);
/// assert!(frames.lookup("map", "lidar_link", Stamp::from_seconds(3.0)).is_err()); // the future is not known
/// # Ok::<(), agv_core::frames::FrameError>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::checkpoint::StoredTree", into = "super::checkpoint::StoredTree")
)]
pub struct FrameTree {
    pub(super) frames: Vec<Frame>,
    /// Frames by name; a tree map, so that nothing depends on a hash's order.
    index: BTreeMap<String, usize>,
    pub(super) params: FrameTreeParams,
}

#[derive(Debug, Clone)]
pub(super) struct Frame {
    pub(super) name: String,
    pub(super) edge: Option<Edge>,
}

#[derive(Debug, Clone)]
pub(super) struct Edge {
    /// Index of the parent frame.
    pub(super) parent: usize,
    pub(super) motion: Motion,
}

#[derive(Debug, Clone)]
pub(super) enum Motion {
    Static(Se3),
    Moving(History),
}

impl FrameTree {
    /// A tree without frames.
    ///
    /// # Errors
    /// [`Error::NotPositive`] for the history, [`Error::TooFew`] for a capacity below 2.
    pub fn new(params: FrameTreeParams) -> Result<Self, Error> {
        check::positive("history", params.history)?;
        check::at_least("capacity", params.capacity, 2)?;
        Ok(Self { frames: Vec::new(), index: BTreeMap::new(), params })
    }

    /// Joins `child` to `parent` by a transform that never changes, or replaces such a transform. Frames that are not
    /// known are added.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Empty`] for a name, [`FrameError::Cycle`], [`FrameError::SecondParent`], or
    /// [`FrameError::EdgeKind`] if the edge is a moving one. The tree is then as it was.
    pub fn set_static(&mut self, parent: &str, child: &str, parent_from_child: Se3) -> Result<(), FrameError> {
        if let Some(Edge { motion, .. }) = self.check_edge(parent, child, &parent_from_child)? {
            return match motion {
                Motion::Static(known) => {
                    *known = parent_from_child;
                    Ok(())
                }
                Motion::Moving(_) => Err(FrameError::EdgeKind { child: child.to_owned(), is_static: false }),
            };
        }
        self.join(parent, child, Motion::Static(parent_from_child));
        Ok(())
    }

    /// Adds the transform of a moving edge at `stamp`. Frames that are not known are added.
    ///
    /// Transforms may arrive out of order; one with a stamp that is there replaces it; one older than the history
    /// reaches is dropped, which the outcome tells. Where all stamps step back, as when a log is played again, call
    /// [`clear_moving`](Self::clear_moving) first.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Empty`] for a name, [`FrameError::Cycle`], [`FrameError::SecondParent`], or
    /// [`FrameError::EdgeKind`] if the edge is a static one. The tree is then as it was.
    pub fn insert(
        &mut self,
        parent: &str,
        child: &str,
        stamp: Stamp,
        parent_from_child: Se3,
    ) -> Result<Insertion, FrameError> {
        if let Some(Edge { motion, .. }) = self.check_edge(parent, child, &parent_from_child)? {
            return match motion {
                Motion::Moving(history) => Ok(history.insert(stamp, parent_from_child)),
                Motion::Static(_) => Err(FrameError::EdgeKind { child: child.to_owned(), is_static: true }),
            };
        }
        let history = History::new(stamp, parent_from_child, self.params.history, self.params.capacity);
        self.join(parent, child, Motion::Moving(history));
        Ok(Insertion::Added)
    }

    /// Cuts `child` off its parent, so that it can be joined to another; its own children stay with it.
    ///
    /// # Errors
    /// [`FrameError::UnknownFrame`].
    pub fn detach(&mut self, child: &str) -> Result<(), FrameError> {
        let index = self.find(child)?;
        self.frames[index].edge = None;
        Ok(())
    }

    /// Forgets all moving edges; frames and static edges stay.
    pub fn clear_moving(&mut self) {
        for frame in &mut self.frames {
            frame.edge.take_if(|edge| matches!(edge.motion, Motion::Moving(_)));
        }
    }

    /// Names of all frames, in alphabetical order.
    pub fn frames(&self) -> impl Iterator<Item = &str> {
        self.index.keys().map(String::as_str)
    }

    /// The parent of a frame; `None` for a root.
    ///
    /// # Errors
    /// [`FrameError::UnknownFrame`].
    pub fn parent(&self, frame: &str) -> Result<Option<&str>, FrameError> {
        let edge = self.frames[self.find(frame)?].edge.as_ref();
        Ok(edge.map(|edge| self.frames[edge.parent].name.as_str()))
    }

    pub(super) fn find(&self, name: &str) -> Result<usize, FrameError> {
        self.index.get(name).copied().ok_or_else(|| FrameError::UnknownFrame { frame: name.to_owned() })
    }

    /// The edge above `child` if it is there and leads to `parent`; an error if the edge must not be.
    fn check_edge(&mut self, parent: &str, child: &str, pose: &Se3) -> Result<Option<&mut Edge>, FrameError> {
        if parent.is_empty() || child.is_empty() {
            return Err(Error::Empty { name: "frame name" }.into());
        }
        if !pose.is_finite() {
            return Err(Error::NotFinite { name: "transform", value: f64::NAN }.into());
        }
        let cycle = || FrameError::Cycle { parent: parent.to_owned(), child: child.to_owned() };
        if parent == child {
            return Err(cycle());
        }
        let Some(&child_index) = self.index.get(child) else { return Ok(None) };
        if let Some(known) = self.frames[child_index].edge.as_ref().map(|edge| edge.parent) {
            if self.frames[known].name != parent {
                return Err(FrameError::SecondParent {
                    child: child.to_owned(),
                    parent: self.frames[known].name.clone(),
                    second: parent.to_owned(),
                });
            }
            return Ok(self.frames[child_index].edge.as_mut());
        }
        // A new edge closes a cycle if the child is an ancestor of its parent.
        let mut above = self.index.get(parent).copied();
        while let Some(index) = above {
            if index == child_index {
                return Err(cycle());
            }
            above = self.frames[index].edge.as_ref().map(|edge| edge.parent);
        }
        Ok(None)
    }

    fn join(&mut self, parent: &str, child: &str, motion: Motion) {
        let parent = self.add(parent);
        let child = self.add(child);
        self.frames[child].edge = Some(Edge { parent, motion });
    }

    pub(super) fn add(&mut self, name: &str) -> usize {
        if let Some(&known) = self.index.get(name) {
            return known;
        }
        self.frames.push(Frame { name: name.to_owned(), edge: None });
        self.index.insert(name.to_owned(), self.frames.len() - 1);
        self.frames.len() - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree() -> FrameTree {
        let mut tree = FrameTree::new(FrameTreeParams::default()).unwrap();
        tree.set_static("a", "b", Se3::default()).unwrap();
        tree.insert("b", "c", Stamp::default(), Se3::default()).unwrap();
        tree
    }

    #[test]
    fn bad_edges_are_named_and_leave_the_tree_alone() {
        let mut tree = tree();
        let (unit, now) = (Se3::default(), Stamp::default());
        let nan = Se3::from(crate::geometry::Se2::new(f64::NAN, 0.0, 0.0));
        let name = str::to_owned;
        let cycle = |parent, child| Err(FrameError::Cycle { parent: name(parent), child: name(child) });
        assert_eq!(tree.set_static("c", "a", unit), cycle("c", "a"));
        assert_eq!(tree.set_static("d", "d", unit), cycle("d", "d"));
        let second = FrameError::SecondParent { child: name("c"), parent: name("b"), second: name("a") };
        assert_eq!(tree.insert("a", "c", now, unit), Err(second));
        assert_eq!(tree.insert("a", "b", now, unit), Err(FrameError::EdgeKind { child: name("b"), is_static: true }));
        assert_eq!(tree.set_static("b", "c", unit), Err(FrameError::EdgeKind { child: name("c"), is_static: false }));
        assert!(matches!(tree.set_static("a", "new", nan), Err(FrameError::Core(Error::NotFinite { .. }))));
        assert!(matches!(tree.insert("", "new", now, unit), Err(FrameError::Core(Error::Empty { .. }))));
        assert_eq!(tree.frames().collect::<Vec<_>>(), ["a", "b", "c"]);
        assert_eq!(tree.parent("c"), Ok(Some("b")));
        assert_eq!(tree.parent("d"), Err(FrameError::UnknownFrame { frame: name("d") }));
    }

    #[test]
    fn bad_parameters_are_named() {
        for history in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let params = FrameTreeParams { history, ..FrameTreeParams::default() };
            assert!(matches!(FrameTree::new(params), Err(Error::NotPositive { name: "history", .. })), "{history}");
        }
        assert!(FrameTree::new(FrameTreeParams { capacity: 1, ..FrameTreeParams::default() }).is_err());
    }

    #[test]
    fn a_detached_frame_may_find_another_parent() {
        let mut tree = tree();
        tree.detach("c").unwrap();
        tree.set_static("a", "c", Se3::default()).unwrap();
        tree.clear_moving();
        assert_eq!((tree.parent("c"), tree.parent("b")), (Ok(Some("a")), Ok(Some("a"))));
    }
}
