//! The pose of a floor code from the three finder patterns of its image.
//!
//! The patterns' centres are the corners of a right isosceles triangle with legs of a known length `s` (paper 001, section
//! 3.1). In the code's frame, x along its top edge to the right and y towards the top,
//!
//! ```text
//! top left q1 = (-s/2, s/2)      top right q2 = (s/2, s/2)      bottom left q3 = (-s/2, -s/2)
//! ```
//!
//! On the floor (see [`FloorProjection`]) they are at `p1`, `p2`, `p3`, each with the covariance `Wᵢ⁻¹ = σ² Jᵢ Jᵢᵀ` of the
//! pixel noise. The centre is the middle of the diagonal `p2 p3`, the heading that of both legs; from there the pose `T` that
//! minimises `Σ |pᵢ - T qᵢ|²` weighted by `Wᵢ` is found by Gauss–Newton, and the Hessian's inverse is its covariance.

use super::{FloorProjection, rigid_fit::RigidFit};
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose},
    sensors::{CodeSighting, MarkerObservation, SensorId},
    time::Stamp,
};
use nalgebra::{Matrix2, Vector2};

/// Parameters of a [`CodeReader`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CodeReaderParams {
    /// Distance between the centres of neighbouring finder patterns, in metres: the printed edge less seven modules.
    pub finder_spacing: f64,
    /// Standard deviation of a finder pattern's centre along each axis of the image, in pixels.
    pub pixel_sigma: f64,
    /// How far a finder pattern may lie from where the fitted code has it, as a share of the spacing.
    pub shape_tolerance: f64,
    /// Which sensor of the vehicle the camera is.
    pub sensor: SensorId,
}

impl Default for CodeReaderParams {
    /// A code of version 1 (21 modules) printed 10 cm wide has its patterns 14 modules apart, 66.7 mm; decoders find
    /// centres to about half a pixel; 5 % of the spacing is a floor 5 % nearer or farther than the calibration says, or
    /// something else than a code.
    fn default() -> Self {
        Self { finder_spacing: 0.1 * 14.0 / 21.0, pixel_sigma: 0.5, shape_tolerance: 0.05, sensor: SensorId::default() }
    }
}

/// A code that was located.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CodeFit {
    /// Pose of the code on the vehicle, with the covariance that the pixel noise leaves.
    pub base_from_code: UncertainPose<Se2>,
    /// Weighted squared residual of the fit: chi-square of three degrees of freedom if pixel noise is all there is.
    pub chi_square: f64,
    /// Measured spacing over the printed one: a mean off 1 says that the camera's height or focal length is off as much.
    pub scale: f64,
}

/// Why three finder patterns are no code on the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum CodeRejection {
    /// A pattern is not on the floor: its ray misses the floor, or its pixel is not a number.
    OffFloor,
    /// The patterns run the other way round: a reflection, or patterns in the wrong order.
    Mirrored,
    /// They are not the corners of a right isosceles triangle of the printed size.
    Misshapen {
        /// Greatest distance of a pattern from where the fitted code has it, as a share of the spacing.
        residual: f64,
    },
    /// The code was found, but its number could not be read.
    Unread,
}

/// Locates floor codes in the image of a calibrated camera.
///
/// ```
/// use agv_core::{geometry::{LieGroup, Se2}, nalgebra::Vector2, sensors::{CodeSighting, PinholeCamera, PinholeParams}};
/// use agv_core::time::Stamp;
/// use agv_filters::marker::{CodeReader, CodeReaderParams, FloorProjection, looking_down};
///
/// let camera = PinholeCamera::new(PinholeParams::default())?;
/// let floor = FloorProjection::new(camera, looking_down(Vector2::new(0.2, 0.0), 0.3, 0.0))?;
/// let reader = CodeReader::new(floor, CodeReaderParams::default())?;
///
/// let base_from_code = Se2::new(0.22, 0.03, 0.4);
/// let finders = reader.places(&base_from_code).map(|place| floor.to_pixel(&place).expect("in sight"));
/// let seen = reader.observe(Stamp::default(), &CodeSighting { id: Some(7), finders }).expect("a code");
/// assert!(seen.base_from_marker().mean().minus(&base_from_code).norm() < 1e-9);
/// // Half a pixel is a quarter of a millimetre here.
/// assert!(seen.base_from_marker().position_deviation() < 0.0003);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawReader"))]
pub struct CodeReader {
    projection: FloorProjection,
    params: CodeReaderParams,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawReader {
    projection: FloorProjection,
    params: CodeReaderParams,
}

#[cfg(feature = "serde")]
impl TryFrom<RawReader> for CodeReader {
    type Error = Error;

    fn try_from(raw: RawReader) -> Result<Self, Error> {
        Self::new(raw.projection, raw.params)
    }
}

/// A place on the floor, and its Jacobian with respect to the pixel.
type OnFloor = (Vector2<f64>, Matrix2<f64>);

/// Twice the area of a triangle, positive if its corners run counter-clockwise.
pub(super) fn doubled_area([a, b, c]: &[Vector2<f64>; 3]) -> f64 {
    (b - a).perp(&(c - a))
}

impl CodeReader {
    /// A reader of codes of one size.
    ///
    /// # Errors
    /// A spacing or a pixel noise that is not positive, or a tolerance outside (0, 0.3], where a right angle is none any more.
    pub fn new(projection: FloorProjection, params: CodeReaderParams) -> Result<Self, Error> {
        check::positive("finder_spacing", params.finder_spacing)?;
        check::positive("pixel_sigma", params.pixel_sigma)?;
        check::positive("shape_tolerance", params.shape_tolerance)?;
        check::in_range("shape_tolerance", params.shape_tolerance, 0.0, 0.3)?;
        Ok(Self { projection, params })
    }

    /// The parameters.
    pub const fn params(&self) -> &CodeReaderParams {
        &self.params
    }

    /// The camera above its floor.
    pub const fn projection(&self) -> &FloorProjection {
        &self.projection
    }

    /// Centres of the finder patterns in the code's frame, in metres: top left, top right, bottom left.
    pub fn finders(&self) -> [Vector2<f64>; 3] {
        let half = 0.5 * self.params.finder_spacing;
        [Vector2::new(-half, half), Vector2::new(half, half), Vector2::new(-half, -half)]
    }

    /// Where the finder patterns of a code are in the base frame, in metres.
    pub fn places(&self, base_from_code: &Se2) -> [Vector2<f64>; 3] {
        self.finders().map(|finder| *base_from_code * finder)
    }

    /// Brings three finder patterns of an image, found in any order, into the order of a [`CodeSighting`]: the corner is
    /// opposite the longest side, and the other two follow from the sense in which codes are printed. A mirrored code cannot be
    /// told by patterns without order.
    ///
    /// # Errors
    /// [`CodeRejection::OffFloor`].
    pub fn in_order(&self, pixels: &[Vector2<f64>; 3]) -> Result<[Vector2<f64>; 3], CodeRejection> {
        let floor = self.on_floor(pixels)?;
        let opposite = |i: usize| (floor[(i + 1) % 3].0 - floor[(i + 2) % 3].0).norm();
        let corner = (0..3).max_by(|&a, &b| opposite(a).total_cmp(&opposite(b))).unwrap_or(0);
        let turned = [corner, (corner + 1) % 3, (corner + 2) % 3];
        // Top left, top right, bottom left run clockwise seen from above.
        let clockwise = doubled_area(&turned.map(|i| floor[i].0)) < 0.0;
        Ok(if clockwise { turned } else { [turned[0], turned[2], turned[1]] }.map(|i| pixels[i]))
    }

    /// The pose of the code with these finder patterns, in a [`CodeSighting`]'s order.
    ///
    /// # Errors
    /// Why they are none.
    pub fn locate(&self, finders: &[Vector2<f64>; 3]) -> Result<CodeFit, CodeRejection> {
        let (floor, model, spacing) = (self.on_floor(finders)?, self.finders(), self.params.finder_spacing);
        let [corner, right, below] = floor.map(|(place, _)| place);
        if doubled_area(&[corner, right, below]) >= 0.0 {
            return Err(CodeRejection::Mirrored);
        }
        let (centre, along, down) = ((right + below) * 0.5, right - corner, below - corner);
        // Each leg has a say: the second one turned up by a right angle.
        let heading = along + Vector2::new(-down.y, down.x);
        let start = Se2::new(centre.x, centre.y, heading.y.atan2(heading.x));

        let mut fit = RigidFit::<3>::default();
        let variance = self.params.pixel_sigma * self.params.pixel_sigma;
        for ((place, by_pixel), model) in floor.iter().zip(&model) {
            let covariance: Matrix2<f64> = by_pixel * by_pixel.transpose() * variance;
            fit.add(*model, *place, &covariance).ok_or(CodeRejection::OffFloor)?;
        }
        let found = fit.solve(&start).ok_or(CodeRejection::OffFloor)?;
        let residual =
            |(place, model): (&OnFloor, &Vector2<f64>)| (place.0 - *found.pose.mean() * *model).norm() / spacing;
        let residual = floor.iter().zip(&model).map(residual).fold(0.0, f64::max);
        if residual.is_nan() || residual > self.params.shape_tolerance {
            return Err(CodeRejection::Misshapen { residual });
        }
        let scale = 0.5 * (along.norm() + down.norm()) / spacing;
        Ok(CodeFit { base_from_code: found.pose, chi_square: found.chi_square, scale })
    }

    /// What a filter takes: the code's number and its pose on the vehicle.
    ///
    /// # Errors
    /// Why it is none. A code that could not be read is [`CodeRejection::Unread`]; [`locate`](Self::locate) it, and let a
    /// [`TemplateLibrary`](super::TemplateLibrary) find its number.
    pub fn observe(&self, stamp: Stamp, sighting: &CodeSighting) -> Result<MarkerObservation<Se2>, CodeRejection> {
        let fit = self.locate(&sighting.finders)?;
        let id = sighting.id.ok_or(CodeRejection::Unread)?;
        Ok(MarkerObservation::new(stamp, id, fit.base_from_code).with_sensor(self.params.sensor))
    }

    fn on_floor(&self, pixels: &[Vector2<f64>; 3]) -> Result<[OnFloor; 3], CodeRejection> {
        let mut floor = [(Vector2::zeros(), Matrix2::identity()); 3];
        for (place, pixel) in floor.iter_mut().zip(pixels) {
            *place = self.projection.to_floor(pixel).ok_or(CodeRejection::OffFloor)?;
        }
        Ok(floor)
    }
}

#[cfg(test)]
mod tests;
