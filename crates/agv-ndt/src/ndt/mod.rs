//! The normal distributions transform.

mod distributions;
mod fit;
mod gaussian;
mod kernel;
mod level;
mod localizer;
mod map;
mod mixture;
mod objective;
mod params;
mod planar;
mod registration;
mod search;
mod tile;
mod tiles;

pub use distributions::DistributionRegistration;
pub use gaussian::{Gaussian3, VoxelParams, VoxelSums};
pub use localizer::{DriftParams, NdtLocalizer, NdtLocalizerParams, SearchParams};
pub use map::NdtMap;
pub use params::NdtParams;
pub use planar::{NdtScanMatcher, NdtScanMatcherParams};
pub use registration::{NdtRegistration, NdtReport};
pub use search::VoxelSearch;
pub use tile::NdtTile;
pub use tiles::NdtTiles;
