//! 3D: preprocessing, registration, odometry and mapping, and conversion to 2D.
//!
//! # Overview
//! Where was this cloud taken, given another one or a map? [`ndt`] answers with normal distributions in voxels, [`gicp`] with pairs of
//! points; both play the role [`Registration`](agv_core::roles::Registration) and are made of the parts in [`registration`].
//! Where does the lidar go? [`loam`] follows it by edges and surfaces, [`odometry`] by any registration; both play the role
//! [`LidarOdometry`](agv_core::roles::LidarOdometry). [`ndt::NdtLocalizer`] follows a vehicle in a map. [`preprocess`] finds
//! neighbours, normals, ground, clusters and outliers, [`convert`] makes laser scans and grids of clouds.
//!
//! | users have | take |
//! |---|---|
//! | a map, or clouds that are far apart | [`ndt::NdtRegistration`]: fastest, and finds the pose from metres away |
//! | two thin clouds, and a guess within half a metre | [`gicp::PointRegistration`]: a point per 0.25 m of the target is enough |
//! | a vehicle on an even floor | either with [`registration::Freedom::Planar`] |
//! | one cloud after the other | [`loam::LoamOdometry`]: pose and local map in one call per cloud |
//! | the same, and a registration of their own | [`odometry::Follow`] |
//! | two full clouds, and no wish to thin one out | [`ndt::DistributionRegistration`]: distributions of both |
//! | a map, odometry, and clouds | [`ndt::NdtLocalizer`] |
//! | laser scans | [`ndt::NdtScanMatcher`] |
//! | clouds, and planners in the plane | [`convert::CloudToGrid`], [`convert::CloudToScan`] |
//! | a place that was met before, wherever odometry believes to be | [`places::ScanContexts`] |
//! | a map of many vehicles' clouds | [`ndt::NdtMap`], which merges in any order to the same bits |
//! | a map that is larger than memory | [`ndt::NdtTiles`], which loads and unloads squares of it |
//!
//! # Usage
//! ```
//! use agv_core::{geometry::Se3, nalgebra::Vector3, roles::Registration, sensors::{PointCloud, VoxelGrid}};
//! use agv_ndt::ndt::{NdtParams, NdtRegistration};
//!
//! # let wall = |i: i32| [Vector3::new((i % 60) as f32, 0.0, (i / 60) as f32), Vector3::new(0.0, (i % 60) as f32, (i / 60) as f32), Vector3::new((i % 60) as f32, (i / 60) as f32, 0.0)];
//! # let target = PointCloud::from_points((0..3600).flat_map(wall).map(|p| p * 0.1));
//! # let source = target.clone();
//! let mut thinned = PointCloud::default();
//! VoxelGrid::new(0.25)?.filter_into(&source, &mut thinned);
//!
//! let mut ndt = NdtRegistration::new(NdtParams::default())?;
//! ndt.set_target(&target)?;
//! let found = ndt.align(&thinned, &Se3::default())?;
//! if found.converged() {
//!     println!("{:?}, {:.0} % inliers", found.target_from_source, 100.0 * found.inlier_ratio);
//! }
//! # assert!(found.converged());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Conventions
//! Those of `agv-core`: poses are `target_from_source`, increments and information are in the source frame, points are `f32`, sums `f64`.
//! What can happen to correct callers (no overlap, a corridor, a false optimum) is a
//! [`Termination`](agv_core::roles::Termination) in the result.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod checks;
pub mod convert;
mod eigen;
mod error;
pub mod gicp;
pub mod loam;
pub mod ndt;
pub mod odometry;
pub mod places;
pub mod preprocess;
pub mod registration;
#[cfg(test)]
mod scenes;

pub use error::Error;

use agv_core::sensors::cells;
