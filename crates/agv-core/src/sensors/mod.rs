//! What sensors report, each with its time, its [`SensorId`] and the pose of the sensor on the vehicle: laser scans and
//! point clouds, [`ImuSample`], [`MarkerObservation`] and [`LandmarkObservation`], and the poses, positions and velocities
//! that other systems find. All of them are an [`Observation`]. A [`PinholeCamera`] turns pixels into rays, and a
//! [`CodeSighting`] is a QR code in its image.
//!
//! Operations on a [`PointCloud`] live in files of their own and keep all channels together: [`VoxelGrid`]
//! down-samples, [`PointCloud::crop_box`] and its neighbours filter in place, [`PointCloud::transform`] moves,
//! [`RangeImage`] views a spinning lidar's cloud as rows and columns, and [`Deskew`] undoes the vehicle's motion during
//! a sweep, of scans and clouds alike.

mod camera;
pub mod cells;
mod cloud_filter;
mod cloud_parts;
mod cloud_transform;
mod code_sighting;
mod deskew;
mod fix;
mod imu;
mod landmark;
mod laser_scan;
mod lens;
mod marker;
mod motion;
mod observation;
mod origin;
mod point_cloud;
mod range_image;
mod range_reading;
mod scan_bins;
mod sensor_id;
mod time_of_flight;
mod triangulation;
mod voxel;

pub use camera::{PinholeCamera, PinholeParams};
pub use code_sighting::CodeSighting;
pub use deskew::Deskew;
pub use fix::{PoseObservation, PositionObservation, VelocityObservation};
pub use imu::{GRAVITY, ImuSample};
pub use landmark::LandmarkObservation;
pub use laser_scan::{Beam, LaserScan, ScanGeometry};
pub use lens::LensDistortion;
pub use marker::MarkerObservation;
pub use motion::{BodyMotion, ConstantTwist, PoseTrack};
pub use observation::Observation;
pub use point_cloud::{LidarReturn, PointCloud, PointSource};
pub use range_image::{RangeImage, RangeImageParams, RowSource};
pub use range_reading::RangeReading;
pub use scan_bins::ScanBins;
pub use sensor_id::SensorId;
pub use time_of_flight::{PhaseShift, PhaseShiftParams, PulsedTimeOfFlight, PulsedTimeOfFlightParams};
pub use triangulation::{Triangulation, TriangulationParams};
pub use voxel::VoxelGrid;
