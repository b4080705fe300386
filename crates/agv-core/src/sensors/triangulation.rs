//! Range from a laser triangulation sensor.
//!
//! A laser at the origin lights a point at distance `r`; a camera a baseline `b` away sees the spot through a lens of
//! focal length `f` at the image offset `x` (paper 000, section 1.1.3, Fig. 3). Similar triangles give
//!
//! ```text
//! r = f b / x            dr = r² / (f b) dx
//! ```
//!
//! so the error grows with the square of the range, which is why such sensors serve the near field only.

use super::RangeReading;
use crate::{Error, check};

/// Geometry of a triangulation sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TriangulationParams {
    /// Distance between laser and lens, in metres.
    pub baseline: f64,
    /// Focal length of the lens, in metres.
    pub focal_length: f64,
    /// Standard deviation of the spot's offset on the image plane, in metres.
    pub offset_sigma: f64,
}

impl Default for TriangulationParams {
    /// A compact indoor scanner: 50 mm baseline, 16 mm lens, 1 µm sub-pixel spot noise.
    fn default() -> Self {
        Self { baseline: 0.05, focal_length: 0.016, offset_sigma: 1e-6 }
    }
}

/// Turns spot offsets into ranges.
///
/// ```
/// use agv_core::sensors::{Triangulation, TriangulationParams};
///
/// let sensor = Triangulation::new(TriangulationParams::default())?;
/// let reading = sensor.range(0.0004)?;
/// assert!((reading.range - 2.0).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangulation {
    /// `f b`, the only combination that the model needs, in square metres.
    focal_baseline: f64,
    offset_sigma: f64,
}

impl Triangulation {
    /// Checks the parameters once, so that [`range`](Self::range) need not.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the first field that is not finite and positive.
    pub fn new(params: TriangulationParams) -> Result<Self, Error> {
        let baseline = check::positive("baseline", params.baseline)?;
        let focal_length = check::positive("focal_length", params.focal_length)?;
        let offset_sigma = check::positive("offset_sigma", params.offset_sigma)?;
        Ok(Self { focal_baseline: focal_length * baseline, offset_sigma })
    }

    /// Range for the spot at `offset` metres on the image plane.
    ///
    /// # Errors
    /// [`Error::NotPositive`] if `offset` is not finite and positive: zero is a point at infinity.
    pub fn range(&self, offset: f64) -> Result<RangeReading, Error> {
        let range = self.focal_baseline / check::positive("spot offset", offset)?;
        Ok(RangeReading { range, sigma: range * range / self.focal_baseline * self.offset_sigma })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn sensor() -> Triangulation {
        Triangulation::new(TriangulationParams::default()).unwrap()
    }

    proptest! {
        /// The stated sigma is the first-order propagation of the offset's: compare with a central difference.
        #[test]
        fn sigma_is_the_propagated_offset_noise(range in 0.05..20.0_f64) {
            let s = sensor();
            let offset = s.focal_baseline / range;
            let h = offset * 1e-6;
            let slope = (s.range(offset + h).unwrap().range - s.range(offset - h).unwrap().range) / (2.0 * h);
            assert_relative_eq!(s.range(offset).unwrap().sigma, slope.abs() * s.offset_sigma, max_relative = 1e-6);
        }
    }

    #[test]
    fn bad_readings_and_parameters_are_named() {
        for bad in [0.0, -1e-4, f64::NAN, f64::INFINITY] {
            assert!(matches!(sensor().range(bad), Err(Error::NotPositive { name: "spot offset", .. })), "{bad}");
            let good = TriangulationParams::default();
            for (name, params) in [
                ("baseline", TriangulationParams { baseline: bad, ..good }),
                ("focal_length", TriangulationParams { focal_length: bad, ..good }),
                ("offset_sigma", TriangulationParams { offset_sigma: bad, ..good }),
            ] {
                let error = Triangulation::new(params).unwrap_err();
                assert!(error.to_string().starts_with(name), "{error}");
            }
        }
    }
}
