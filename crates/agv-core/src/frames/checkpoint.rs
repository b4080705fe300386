//! A tree of frames as it is stored, edges by the names of what they join.

use super::{FrameError, FrameTree, FrameTreeParams, Insertion, tree::Motion};
use crate::{Error, geometry::Se3, time::Stamp};

/// A tree, before it is checked.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct StoredTree {
    params: FrameTreeParams,
    /// In the order in which they were added.
    frames: Vec<StoredFrame>,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct StoredFrame {
    name: String,
    edge: Option<StoredEdge>,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct StoredEdge {
    parent: String,
    motion: StoredMotion,
}

#[derive(serde::Serialize, serde::Deserialize)]
enum StoredMotion {
    Static(Se3),
    /// Oldest first.
    Moving(Vec<(Stamp, Se3)>),
}

impl From<FrameTree> for StoredTree {
    fn from(tree: FrameTree) -> Self {
        let frames = tree.frames.iter().map(|frame| {
            let edge = frame.edge.as_ref().map(|edge| StoredEdge {
                parent: tree.frames[edge.parent].name.clone(),
                motion: match &edge.motion {
                    Motion::Static(pose) => StoredMotion::Static(*pose),
                    Motion::Moving(history) => StoredMotion::Moving(history.samples().collect()),
                },
            });
            StoredFrame { name: frame.name.clone(), edge }
        });
        Self { params: tree.params, frames: frames.collect() }
    }
}

impl TryFrom<StoredTree> for FrameTree {
    type Error = FrameError;

    /// Joins the frames anew, so that a stored tree passes the checks that a growing one does.
    fn try_from(stored: StoredTree) -> Result<Self, FrameError> {
        let mut tree = Self::new(stored.params)?;
        for frame in &stored.frames {
            if frame.name.is_empty() {
                return Err(Error::Empty { name: "frame name" }.into());
            }
            tree.add(&frame.name);
        }
        for StoredFrame { name, edge } in &stored.frames {
            match edge {
                None => {}
                Some(StoredEdge { parent, motion: StoredMotion::Static(pose) }) => {
                    tree.set_static(parent, name, *pose)?;
                }
                Some(StoredEdge { parent, motion: StoredMotion::Moving(samples) }) => {
                    if samples.is_empty() {
                        return Err(Error::Empty { name: "transforms of a moving edge" }.into());
                    }
                    for &(stamp, pose) in samples {
                        if tree.insert(parent, name, stamp, pose)? != Insertion::Added {
                            let nanoseconds = stamp.nanoseconds();
                            return Err(Error::TimeBackwards { earlier_ns: nanoseconds, later_ns: nanoseconds }.into());
                        }
                    }
                }
            }
        }
        // A parent that was not among the frames, or two frames of one name.
        crate::check::length("frames", tree.frames.len(), stored.frames.len())?;
        Ok(tree)
    }
}
