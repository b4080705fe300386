//! Registration of points with points: iterated closest points to planes, generalized, and voxelized.

mod objective;
mod params;
mod registration;
mod surface;

pub use params::{PointMetric, PointParams};
pub use registration::PointRegistration;
