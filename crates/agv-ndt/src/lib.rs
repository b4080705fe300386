//! 3D: preprocessing, registration, odometry, mapping, and conversion to 2D.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod convert;
mod error;
pub mod ndt;
pub mod registration;

pub use error::Error;
