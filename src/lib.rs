//! Navigation algorithms for automated guided vehicles.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[cfg(feature = "control")]
pub use agv_control as control;
pub use agv_core as core;
pub use agv_core::nalgebra;
