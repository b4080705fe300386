//! Ready-made compositions of the parts, one file each. They hold roles, not algorithms: every part can be replaced.

mod centring;
mod navigator;

pub use centring::{Centring, CentringParams, CentringStatus, CentringStep};
pub use navigator::{NavigationStep, Navigator};
