//! Where am I, and what does the place look like: simultaneous localisation and mapping with laser scans or landmarks.
//!
//! [`graph`] ties scans together in a pose graph, closes loops and draws the map from the corrected poses ([`GraphSlam`]).
//!
//! [`landmark`] maps landmarks by an extended Kalman filter ([`LandmarkSlam`]).
//!
//! [`rbpf`] holds a particle filter over whole trajectories, each particle with a map of its own ([`Rbpf`]).

pub mod graph;
pub mod landmark;
pub mod rbpf;

pub use graph::{GraphSlam, GraphSlamParams};
pub use landmark::{LandmarkSlam, LandmarkSlamParams};
#[cfg(feature = "serde")]
pub use rbpf::RbpfCheckpoint;
pub use rbpf::{Rbpf, RbpfParams, RbpfUpdate, ScanFitParams, TileMap};
