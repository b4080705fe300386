//! What a sensor says of a landmark, and what it ought to say.
//!
//! A landmark at `l` lies at `q = base_from_sensor⁻¹ (X⁻¹ l)` in the frame of a sensor on a vehicle at `X`. Read is its place `q`, its
//! distance and direction, or its distance alone:
//!
//! ```text
//! range  (1 + s) |q|          bearing  atan2(q_y, q_x)          s: scale of the ranges
//! ```

use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainVector, wrap_angle},
    sensors::LandmarkObservation,
};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use std::ops::RangeInclusive;

/// Longest motion and farthest sighting, in metres: beyond, the numbers have no meaning.
pub(super) const LARGEST: f64 = 1e6;

/// Least variance of a sighting, in m² and in rad²: what is surer than a nanometre weighs as much as all else together.
const LEAST: f64 = 1e-18;

/// Shares by which ranges may be too long.
pub(super) const SCALES: RangeInclusive<f64> = -0.9..=10.0;

/// The least variance of a reading, and their sum.
fn variances<const N: usize>(covariance: &SMatrix<f64, N, N>) -> Result<[f64; 2], Error> {
    check::positive_definite("covariance of a sighting", covariance)?;
    Ok([covariance.diagonal().min(), covariance.trace()])
}

/// What a sensor measures of a landmark, with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum LandmarkReading {
    /// Distance in metres, and direction in radians, counter-clockwise from the sensor's x axis.
    RangeBearing(UncertainVector<2>),
    /// Place in the sensor's frame, in metres: a tree found in a scan.
    Place(UncertainVector<2>),
    /// Distance in metres: a radio beacon.
    Range(UncertainVector<1>),
}

/// A landmark that a sensor saw.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LandmarkSighting {
    /// Which landmark it is, if the sensor knows.
    pub id: Option<u32>,
    /// Where the sensor sits on the vehicle.
    pub base_from_sensor: Se2,
    /// What it measured.
    pub reading: LandmarkReading,
}

impl From<&LandmarkObservation> for LandmarkSighting {
    fn from(observation: &LandmarkObservation) -> Self {
        Self {
            id: observation.id(),
            base_from_sensor: observation.base_from_sensor(),
            reading: LandmarkReading::RangeBearing(*observation.range_bearing()),
        }
    }
}

/// A reading beside what is expected of it: `residual ≈ by_seen δq + by_scale δs + noise`, in the first `rows` rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected {
    pub(super) rows: usize,
    pub(super) residual: Vector2<f64>,
    pub(super) by_seen: Matrix2<f64>,
    pub(super) by_scale: Vector2<f64>,
    pub(super) noise: Matrix2<f64>,
}

impl LandmarkSighting {
    /// A sighting by a sensor at the vehicle's origin.
    pub fn new(id: Option<u32>, reading: LandmarkReading) -> Self {
        Self { id, base_from_sensor: Se2::default(), reading }
    }

    /// The same with the sensor somewhere else on the vehicle.
    #[must_use]
    pub const fn with_mount(self, base_from_sensor: Se2) -> Self {
        Self { base_from_sensor, ..self }
    }

    /// Refuses ranges below zero, what is absurdly far or uncertain, noise-free readings, and mounts that are not finite.
    pub(super) fn validate(&self) -> Result<(), Error> {
        if !self.base_from_sensor.is_finite() {
            return Err(Error::NotFinite { name: "mount", value: f64::NAN });
        }
        check::in_range("distance of the mount", self.base_from_sensor.translation().norm(), 0.0, LARGEST)?;
        let (distance, [least, variance]) = match &self.reading {
            LandmarkReading::RangeBearing(v) => (v.mean().x, variances(v.covariance())?),
            LandmarkReading::Place(v) => (v.mean().norm(), variances(v.covariance())?),
            LandmarkReading::Range(v) => (v.mean().x, variances(v.covariance())?),
        };
        check::in_range("distance of a sighting", distance, 0.0, LARGEST)?;
        check::in_range("least variance of a sighting", least, LEAST, LARGEST * LARGEST)?;
        check::in_range("variance of a sighting", variance, 0.0, LARGEST * LARGEST).map(|_| ())
    }

    /// Place in the sensor's frame with its covariance, if the reading tells it; `scale` is that of the ranges.
    pub(super) fn place(&self, scale: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        match &self.reading {
            LandmarkReading::Place(v) => Some((*v.mean(), *v.covariance())),
            LandmarkReading::RangeBearing(v) => {
                let (range, (sin, cos)) = (v.mean().x / (1.0 + scale), v.mean().y.sin_cos());
                let jacobian = Matrix2::new(cos / (1.0 + scale), -sin * range, sin / (1.0 + scale), cos * range);
                let noise = jacobian * v.covariance() * jacobian.transpose();
                Some((Vector2::new(cos, sin) * range, symmetric(&noise)))
            }
            LandmarkReading::Range(_) => None,
        }
    }

    /// What is expected of it if the landmark lies at `seen` in the sensor's frame; none on top of the sensor, where neither
    /// distance nor direction has a slope.
    pub(super) fn expect(&self, seen: &Vector2<f64>, scale: f64) -> Option<Expected> {
        let (squared, distance) = (seen.norm_squared(), seen.norm());
        let along = seen / distance;
        let stretch = 1.0 + scale;
        let expected = match &self.reading {
            LandmarkReading::Place(v) => Expected {
                rows: 2,
                residual: v.mean() - seen,
                by_seen: Matrix2::identity(),
                by_scale: Vector2::zeros(),
                noise: *v.covariance(),
            },
            LandmarkReading::RangeBearing(v) => Expected {
                rows: 2,
                residual: Vector2::new(v.mean().x - stretch * distance, wrap_angle(v.mean().y - seen.y.atan2(seen.x))),
                by_seen: Matrix2::new(stretch * along.x, stretch * along.y, -seen.y / squared, seen.x / squared),
                by_scale: Vector2::new(distance, 0.0),
                noise: *v.covariance(),
            },
            LandmarkReading::Range(v) => Expected {
                rows: 1,
                residual: Vector2::new(v.mean().x - stretch * distance, 0.0),
                by_seen: Matrix2::new(stretch * along.x, stretch * along.y, 0.0, 0.0),
                by_scale: Vector2::new(distance, 0.0),
                noise: Matrix2::new(v.covariance()[(0, 0)], 0.0, 0.0, 1.0),
            },
        };
        expected.by_seen.iter().all(|v| v.is_finite()).then_some(expected)
    }
}

/// Without the rounding that makes the two halves differ.
pub(super) fn symmetric<const N: usize>(matrix: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (matrix + matrix.transpose()) * 0.5
}

impl LandmarkReading {
    /// A distance with its standard deviation, both in metres.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::Negative`] for the deviation.
    pub fn range(range: f64, sigma: f64) -> Result<Self, Error> {
        UncertainVector::from_sigmas(SVector::from([range]), &SVector::from([sigma])).map(Self::Range)
    }

    /// A distance in metres and a direction in radians, with their standard deviations.
    ///
    /// # Errors
    /// [`Error::NotFinite`], or [`Error::Negative`] for a deviation.
    pub fn range_bearing(range: f64, bearing: f64, sigmas: [f64; 2]) -> Result<Self, Error> {
        UncertainVector::from_sigmas(Vector2::new(range, bearing), &sigmas.into()).map(Self::RangeBearing)
    }
}
