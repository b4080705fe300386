//! Codes and landmarks as they really lie; cameras report them as [`MarkerObservation`](agv_core::sensors::MarkerObservation)
//! and [`LandmarkObservation`](agv_core::sensors::LandmarkObservation).

use crate::Error;
use agv_core::{check, geometry::Se2};
use nalgebra::Vector2;

/// A QR code on the floor: it tells who it is, where it lies and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloorCode {
    /// Number that is printed.
    pub id: u32,
    /// Pose of the code in the map: its centre, and the direction of its top edge's right.
    pub map_from_code: Se2,
}

impl FloorCode {
    /// Codes on a lattice: `columns` by `rows` from `map_from_first` on, `pitch` metres apart, numbered row by row from
    /// zero; all turned like the first.
    ///
    /// # Errors
    /// A pitch that is not finite and positive, a pose that is not finite, or more than a million codes.
    pub fn lattice(map_from_first: Se2, columns: u32, rows: u32, pitch: f64) -> Result<Vec<Self>, Error> {
        check::positive("pitch", pitch)?;
        check::all_finite("map_from_first", &[map_from_first.x(), map_from_first.y(), map_from_first.yaw()])?;
        check::in_range("codes", f64::from(columns) * f64::from(rows), 0.0, 1e6)?;
        let code = |id: u32| {
            let offset = Se2::new(f64::from(id % columns) * pitch, f64::from(id / columns) * pitch, 0.0);
            Self { id, map_from_code: map_from_first * offset }
        };
        Ok((0..columns * rows).map(code).collect())
    }
}

/// A landmark on a wall or pillar: it tells who it is and where, not how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Landmark {
    /// Its number.
    pub id: u32,
    /// Its place in the map, in metres.
    pub position: Vector2<f64>,
}

pub(crate) fn finite_pose(name: &'static str, pose: &Se2) -> Result<(), Error> {
    Ok(check::all_finite(name, &[pose.x(), pose.y(), pose.yaw()])?)
}
