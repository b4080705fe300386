//! Why frames cannot be joined or looked up.

use crate::Error;

/// Why a [`FrameTree`](super::FrameTree) refused an edge or a look-up. It names the frames, so making one allocates.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// A value was refused.
    #[error(transparent)]
    Core(#[from] Error),
    /// A frame that the tree does not know.
    #[error("frame `{frame}` is not known")]
    UnknownFrame {
        /// The frame that was asked for.
        frame: String,
    },
    /// An edge would make a frame its own ancestor.
    #[error("`{child}` below `{parent}` would close a cycle of frames")]
    Cycle {
        /// The parent that was given.
        parent: String,
        /// The child that was given.
        child: String,
    },
    /// A frame has one parent only.
    #[error("frame `{child}` has the parent `{parent}` already, it cannot have `{second}` as well")]
    SecondParent {
        /// The child that was given.
        child: String,
        /// Its parent.
        parent: String,
        /// The parent that was given.
        second: String,
    },
    /// An edge is either static or moving.
    #[error("the edge above frame `{child}` is {}", if *.is_static { "static: it takes no stamps" } else { "moving: each transform needs its stamp" })]
    EdgeKind {
        /// Frame below the edge.
        child: String,
        /// Whether the edge that is there is static.
        is_static: bool,
    },
    /// No chain of transforms joins two frames.
    #[error("frames `{target}` and `{source_frame}` are not connected")]
    NotConnected {
        /// Target of the look-up.
        target: String,
        /// Source of the look-up.
        source_frame: String,
    },
    /// A transform is not known at the time that was asked for.
    #[error("frame `{frame}` is known from {earliest_ns} ns to {latest_ns} ns, not at {wanted_ns} ns")]
    Extrapolation {
        /// Frame below the edge that is not known then.
        frame: String,
        /// The stamp that was asked for, in nanoseconds.
        wanted_ns: i64,
        /// The oldest stamp that is known, in nanoseconds.
        earliest_ns: i64,
        /// The newest stamp that is known, in nanoseconds.
        latest_ns: i64,
    },
}
