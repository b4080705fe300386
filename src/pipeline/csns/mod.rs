//! A 3D navigation system for smart factories (paper 003, *CSNS*): one drive maps the site, and from then on vehicles localise in it,
//! plan on its grid, and drive among what the map does not know.
//!
//! ```text
//! mapping drive:  motions, clouds --> SiteMapper --> Site: 3D map, 2D grid, places
//!
//! wheels, IMU --> InertialOdometry (Kalman filter) --> motion --+
//! cloud --------------------------------------------------------+--> NdtLocalizer --> estimate --+
//!                                  deskewed cloud --> CloudToScan --> costmap over the grid -----+--> Navigation --> motion
//! ```
//!
//! [`Navigation`](super::Navigation) holds the planners: in the paper A* or Dijkstra, and TEB for a chassis that steers.

mod drive;
mod mapper;
mod odometry;

pub use drive::{Csns, CsnsCommand, CsnsSight};
pub use mapper::{Site, SiteMapper, SiteMapperParams, SiteMapperStep};
pub use odometry::InertialOdometry;

#[cfg(test)]
mod tests;
