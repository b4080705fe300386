//! Ready-made compositions of the parts, one file each. They hold roles, not algorithms: every part can be replaced.

mod navigator;

pub use navigator::{NavigationStep, Navigator};
