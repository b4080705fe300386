//! Where do I go: planners on grids and in the neighbourhood of the vehicle.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
