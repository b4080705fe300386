//! Places met again: which earlier cloud looks like this one, wherever odometry believes to be.
//!
//! [`ScanContexts`] keeps a descriptor of each cloud and finds those that look alike, whichever way the vehicle faced. What it finds
//! is a guess of a place and of the turn between the two views, for a [`Registration`](agv_core::roles::Registration) to verify:
//! aisles of one hall look alike too.

mod context;
mod contexts;

pub use context::{ScanContext, ScanContextParams};
pub use contexts::{PlaceMatch, ScanContexts};
