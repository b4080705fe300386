//! LOAM-style odometry and mapping by edges and surfaces.

mod aligner;
mod curvature;
mod features;
mod fit;
mod mapping;
mod objective;
mod odometry;
mod params;
mod surfaces;

#[cfg(test)]
mod tests;

pub use features::{Feature, FeatureExtractor, FeatureParams, Features};
pub use mapping::{LocalMap, LocalMapParams};
pub use odometry::LoamOdometry;
pub use params::{LoamParams, LoamSolve, LoamTarget};
