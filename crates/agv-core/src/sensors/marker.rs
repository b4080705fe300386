//! Markers that tell who they are and how they lie: QR codes and other printed tags.

use super::origin::{Origin, has_origin};
use crate::{
    geometry::{LieGroup, UncertainPose},
    time::Stamp,
};

/// A marker that a camera saw, with its pose in the sensor frame: planar (`Se2`, a floor code under the vehicle, paper
/// 001 section 3) or in space (`Se3`, a tag on a wall).
///
/// What a camera saw at one time is one observation: hand its markers to a filter together, as a slice.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, UncertainPose};
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::sensors::MarkerObservation;
/// use agv_core::time::Stamp;
///
/// // 5 mm and half a degree, by a camera 0.4 m ahead of the vehicle's centre.
/// let spread = Matrix3::from_diagonal(&Vector3::new(25e-6, 25e-6, 76e-6));
/// let seen = UncertainPose::new(Se2::new(0.1, 0.0, 0.2), spread)?;
/// let code = MarkerObservation::new(Stamp::default(), 23, seen).with_mount(Se2::new(0.4, 0.0, 0.0))?;
///
/// let map_from_base = code.map_from_base(&UncertainPose::exact(Se2::new(7.0, 2.0, 0.2)));
/// assert!(map_from_base.mean().minus(&Se2::new(6.5, 2.0, 0.0)).norm() < 1e-12);
/// // The heading's error swings the vehicle around the code, half a metre away: 25e-6 + 0.5² 76e-6.
/// assert!((map_from_base.covariance()[(1, 1)] - 44e-6).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
pub struct MarkerObservation<G: LieGroup> {
    origin: Origin<G>,
    id: u32,
    sensor_from_marker: UncertainPose<G>,
}

has_origin!(MarkerObservation<G>, G);

impl<G: LieGroup> MarkerObservation<G> {
    /// The marker that reads `id`, with its measured pose; by the only camera, at the vehicle's origin.
    pub fn new(stamp: Stamp, id: u32, sensor_from_marker: UncertainPose<G>) -> Self {
        Self { origin: Origin::new(stamp), id, sensor_from_marker }
    }

    /// Number that was read.
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// Measured pose of the marker in the sensor frame.
    pub const fn sensor_from_marker(&self) -> &UncertainPose<G> {
        &self.sensor_from_marker
    }

    /// Measured pose of the marker on the vehicle.
    pub fn base_from_marker(&self) -> UncertainPose<G> {
        self.sensor_from_marker.transport_target(&self.origin.base_from_sensor)
    }

    /// Where the vehicle is, given where the marker lies; the errors of the two are taken as independent.
    pub fn map_from_base(&self, map_from_marker: &UncertainPose<G>) -> UncertainPose<G> {
        map_from_marker.compose(&self.base_from_marker().inverse())
    }
}
