//! Where am I, and what does the place look like: simultaneous localisation and mapping with laser scans.
//!
//! [`rbpf`] holds a particle filter over whole trajectories, each particle with a map of its own ([`Rbpf`]).

pub mod rbpf;

#[cfg(feature = "serde")]
pub use rbpf::RbpfCheckpoint;
pub use rbpf::{Rbpf, RbpfParams, RbpfUpdate, ScanFitParams, TileMap};
