//! What local planners share, and the plainest of them.

mod tracked;

pub use tracked::{Tracked, TrackedParams};
