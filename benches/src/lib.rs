//! Inputs shared by the benches.

pub mod maps;
pub mod window;
