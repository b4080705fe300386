//! Landmarks of which range and direction are measured: reflectors, barcode tubes, pillars.

use super::origin::{Origin, has_origin};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2, UncertainVector, wrap_angle},
    time::Stamp,
};
use nalgebra::{Matrix2, Vector2};

/// A landmark that a sensor saw, by range and bearing in the sensor frame, with or without knowing which.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainVector};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::LandmarkObservation;
/// use agv_core::time::Stamp;
///
/// let measured = UncertainVector::from_sigmas(Vector2::new(4.0, 0.25), &Vector2::new(0.1, 0.01))?;
/// let tube = LandmarkObservation::new(Stamp::default(), Some(9), measured)?;
/// assert_eq!((tube.id(), tube.range(), tube.bearing()), (Some(9), 4.0, 0.25));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawLandmark"))]
pub struct LandmarkObservation {
    origin: Origin<Se2>,
    id: Option<u32>,
    range_bearing: UncertainVector<2>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawLandmark {
    origin: Origin<Se2>,
    id: Option<u32>,
    range_bearing: UncertainVector<2>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawLandmark> for LandmarkObservation {
    type Error = Error;

    fn try_from(raw: RawLandmark) -> Result<Self, Error> {
        let fresh = Self::new(raw.origin.stamp, raw.id, raw.range_bearing)?;
        Ok(Self { origin: raw.origin, ..fresh })
    }
}

has_origin!(LandmarkObservation, Se2);

impl LandmarkObservation {
    /// A landmark at a range in metres and a bearing in radians, counter-clockwise from the sensor's x axis; by the only
    /// sensor of its kind, at the vehicle's origin. `id` is none where the sensor cannot tell which it is.
    ///
    /// # Errors
    /// [`Error::Negative`] for the range. The bearing is wrapped into (-π, π].
    pub fn new(stamp: Stamp, id: Option<u32>, range_bearing: UncertainVector<2>) -> Result<Self, Error> {
        let range = check::non_negative("range", range_bearing.mean().x)?;
        let wrapped = Vector2::new(range, wrap_angle(range_bearing.mean().y));
        let range_bearing = UncertainVector::new(wrapped, *range_bearing.covariance())?;
        Ok(Self { origin: Origin::new(stamp), id, range_bearing })
    }

    /// Which landmark it is, if the sensor knows.
    pub const fn id(&self) -> Option<u32> {
        self.id
    }

    /// Range in metres and bearing in (-π, π] radians, with their covariance.
    pub const fn range_bearing(&self) -> &UncertainVector<2> {
        &self.range_bearing
    }

    /// Measured distance from the sensor, in metres.
    pub fn range(&self) -> f64 {
        self.range_bearing.mean().x
    }

    /// Measured direction in the sensor frame, in radians, counter-clockwise from its x axis.
    pub fn bearing(&self) -> f64 {
        self.range_bearing.mean().y
    }

    /// Place of the landmark in the base frame, in metres; its covariance to first order.
    pub fn position_in_base(&self) -> UncertainVector<2> {
        let mount = self.origin.base_from_sensor;
        let (range, (sin, cos)) = (self.range(), self.bearing().sin_cos());
        let along = mount.rotation().act(&Vector2::new(cos, sin));
        let across = mount.rotation().act(&Vector2::new(-sin, cos));
        let jacobian = Matrix2::from_columns(&[along, across * range]);
        // Only the spread travels linearly.
        self.range_bearing.transformed(&jacobian).with_mean(mount.translation() + along * range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::Seed;
    use rand_distr::{Distribution, StandardNormal};

    fn at(range: f64, bearing: f64) -> UncertainVector<2> {
        UncertainVector::from_sigmas(Vector2::new(range, bearing), &Vector2::new(0.05, 0.01)).unwrap()
    }

    /// The place's covariance against 4000 drawn readings: each entry within four standard errors.
    #[test]
    fn the_place_has_the_covariance_of_drawn_readings() {
        let mount = Se2::new(0.3, -0.1, 0.7);
        let observe =
            |reading| LandmarkObservation::new(Stamp::default(), None, reading).unwrap().with_mount(mount).unwrap();
        let mean = observe(at(5.0, 2.0)).position_in_base();
        let mut stream = Seed(8).stream(0, 0);
        let mut scatter = Matrix2::zeros();
        for _ in 0..4000 {
            let [a, b]: [f64; 2] = [StandardNormal.sample(&mut stream), StandardNormal.sample(&mut stream)];
            let error = observe(at(5.0 + 0.05 * a, 2.0 + 0.01 * b)).position_in_base().mean() - mean.mean();
            scatter += error * error.transpose() / 4000.0;
        }
        let scale = |i: usize, j: usize| (mean.covariance()[(i, i)] * mean.covariance()[(j, j)]).sqrt();
        for (i, j) in [(0, 0), (0, 1), (1, 1)] {
            assert!((scatter[(i, j)] - mean.covariance()[(i, j)]).abs() < 0.09 * scale(i, j), "{i} {j}");
        }
    }

    #[test]
    fn readings_are_wrapped_or_refused() {
        let seen = LandmarkObservation::new(Stamp::default(), None, at(1.0, 6.0)).unwrap();
        assert!((seen.bearing() - (6.0 - std::f64::consts::TAU)).abs() < 1e-12);
        assert!(LandmarkObservation::new(Stamp::default(), None, at(-0.1, 0.0)).is_err());
        assert!(seen.with_mount(Se2::new(f64::NAN, 0.0, 0.0)).is_err());
    }
}
