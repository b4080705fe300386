//! Ready-made compositions of the parts, one file each. They hold roles, not algorithms: every part can be replaced.
//!
//! | composition | from | through | to |
//! |---|---|---|---|
//! | [`Navigator`] | odometry, scans | localizer, global planner, path tracker | motions along a path in a known map |
//! | [`Navigation`] | a pose, what is seen around | global planner, local planner, recoveries | motions among unknown and moving obstacles |
//! | `SiteMapper` | odometry, 3D clouds | registration, ray casting | a 3D map and the grid that planners take |
//! | `KeyFrameMapper` | lidar odometry, 3D clouds | place recognition, registration, pose graph | a corrected trajectory and 3D maps by tile |
//! | `Csns` | wheels, IMU, 3D clouds | Kalman filter, localizer, [`Navigation`] | motions in a mapped site (features `filters` and `ndt`) |
//! | [`Centring`] | a pose | path tracker | motions onto a code |
//!
//! The pose that a [`Navigation`] takes may be a [`Navigator`]'s estimate, or any other.

mod centring;
#[cfg(all(feature = "filters", feature = "ndt"))]
pub mod csns;
#[cfg(all(feature = "filters", feature = "ndt"))]
pub mod mapping;
mod navigation;
mod navigator;

pub use centring::{Centring, CentringParams, CentringStatus, CentringStep};
pub use navigation::{
    GiveUpReason, Navigation, NavigationCommand, NavigationParams, NavigationRequest, NavigationStatus, Recovery,
};
pub use navigator::{NavigationStep, Navigator};
