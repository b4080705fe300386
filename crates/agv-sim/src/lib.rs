//! A deterministic simulator: worlds, sensors and vehicles with ground truth, for examples, tests and benches.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
