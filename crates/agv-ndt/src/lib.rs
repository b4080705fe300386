//! 3D: preprocessing, registration, odometry, mapping, and conversion to 2D.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod cells;
pub mod convert;
mod eigen;
mod error;
pub mod gicp;
pub mod ndt;
pub mod preprocess;
pub mod registration;
#[cfg(test)]
mod scenes;

pub use error::Error;
