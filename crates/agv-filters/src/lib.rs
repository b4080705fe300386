//! Where am I: Kalman filters, Monte Carlo localisation, markers and SLAM.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
