//! A particle filter over trajectories, each particle with a map of its own: the class of `GMapping`.
//!
//! Given its trajectory a vehicle's map is known, so that particles need be samples of trajectories only (Murphy, *Bayesian map
//! learning in dynamic environments*, 1999). [`Rbpf`] follows Grisetti, Stachniss and Burgard, *Improved techniques for grid mapping
//! with Rao-Blackwellized particle filters*, IEEE T-RO 23 (2007): particles are drawn where the scan fits their map and not where the
//! odometry says, and a new set is drawn only where the weights have become uneven. What is done differently:
//!
//! - A scan is matched by Gauss and Newton's steps to the lines through a map's surfaces, which are kept to a fraction of a cell
//!   (`fit`), and not by climbing over a score.
//! - The motion may come from matching a scan with those before it, once for all particles ([`RbpfParams::scan_odometry`]): wheels
//!   that slip then lead no particle astray, and there need be no odometry at all.
//! - Maps share tiles ([`TileMap`]): drawing a new set costs a counted reference per particle.
//!
//! The same bits for any number of threads.

mod beams;
#[cfg(feature = "serde")]
mod checkpoint;
mod filter;
mod fit;
mod insert;
mod map;
mod params;
mod proposal;
mod results;
mod scan_odometry;
#[cfg(test)]
mod tests;
mod tile;
mod trajectory;
mod view;

#[cfg(feature = "serde")]
pub use checkpoint::RbpfCheckpoint;
pub use filter::{Rbpf, RbpfUpdate};
pub use map::TileMap;
pub use params::{RbpfParams, ScanFitParams};
