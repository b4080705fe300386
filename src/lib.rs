//! Navigation algorithms for automated guided vehicles.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub use agv_core as core;
pub use agv_core::nalgebra;
#[cfg(feature = "filters")]
pub use agv_filters as filters;
