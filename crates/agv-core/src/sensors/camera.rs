//! A camera as a pinhole with a lens.
//!
//! ```text
//! (x, y) = (X / Z, Y / Z)        the ray, in the camera's frame: x to the right of the image, y down, z ahead
//! (u, v) = (fx x' + cx, fy y' + cy)        with the ray as the lens bends it (see [`LensDistortion`])
//! ```
//!
//! Paper 001, Eq. 10, in its right form: a ray alone has no depth, which must come from elsewhere, as from the floor that a
//! code lies on.

use super::lens::LensDistortion;
use crate::{Error, check};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

/// Intrinsic parameters of a [`PinholeCamera`], as calibration tools print them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PinholeParams {
    /// Focal length in pixels, along the image's two axes.
    pub focal_length: Vector2<f64>,
    /// Where the optical axis meets the image, in pixels; the centre of the first pixel is (0, 0).
    pub principal_point: Vector2<f64>,
    /// Columns and rows of the image, in pixels.
    pub image_size: Vector2<f64>,
    /// What the lens does.
    pub distortion: LensDistortion,
}

impl Default for PinholeParams {
    /// 640 by 480 pixels over 56° by 43°, without distortion: a usual industrial camera with a 6 mm lens.
    fn default() -> Self {
        Self {
            focal_length: Vector2::new(600.0, 600.0),
            principal_point: Vector2::new(319.5, 239.5),
            image_size: Vector2::new(640.0, 480.0),
            distortion: LensDistortion::default(),
        }
    }
}

/// A calibrated camera: points to pixels and pixels to rays.
///
/// ```
/// use agv_core::nalgebra::Vector3;
/// use agv_core::sensors::{PinholeCamera, PinholeParams};
///
/// let camera = PinholeCamera::new(PinholeParams::default())?;
/// let pixel = camera.project(&Vector3::new(0.1, -0.05, 0.5)).expect("in front of the camera");
/// assert!((pixel.x - 439.5).abs() < 1e-9 && (pixel.y - 179.5).abs() < 1e-9);
/// let ray = camera.ray(&pixel).expect("a pixel");
/// assert!((ray.x - 0.2).abs() < 1e-12 && (ray.y + 0.1).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "PinholeParams", into = "PinholeParams")
)]
pub struct PinholeCamera {
    params: PinholeParams,
    /// Tangent of the widest angle off the axis that the lens's polynomial is good for.
    widest: f64,
}

impl TryFrom<PinholeParams> for PinholeCamera {
    type Error = Error;

    fn try_from(params: PinholeParams) -> Result<Self, Error> {
        Self::new(params)
    }
}

impl From<PinholeCamera> for PinholeParams {
    fn from(camera: PinholeCamera) -> Self {
        camera.params
    }
}

impl PinholeCamera {
    /// A camera from its calibration.
    ///
    /// # Errors
    /// A focal length or a size that is not positive, or another number that is not finite.
    pub fn new(params: PinholeParams) -> Result<Self, Error> {
        for value in [params.focal_length.x, params.focal_length.y] {
            check::positive("focal_length", value)?;
        }
        for value in [params.image_size.x, params.image_size.y] {
            check::positive("image_size", value)?;
        }
        check::all_finite("principal_point", params.principal_point.iter())?;
        params.distortion.validate()?;
        Ok(Self { params, widest: params.distortion.monotone_radius() })
    }

    /// The calibration.
    pub const fn params(&self) -> &PinholeParams {
        &self.params
    }

    /// Whether a pixel lies in the image.
    pub fn sees(&self, pixel: &Vector2<f64>) -> bool {
        let size = self.params.image_size;
        (-0.5..=size.x - 0.5).contains(&pixel.x) && (-0.5..=size.y - 0.5).contains(&pixel.y)
    }

    /// Where a point of the camera's frame, in metres, is in the image or beyond its edges; none behind the camera or where
    /// the lens's polynomial means nothing.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.project_with_jacobian(point).map(|(pixel, _)| pixel)
    }

    /// [`project`](Self::project), with the Jacobian of the pixel with respect to the point.
    pub fn project_with_jacobian(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let depth = point.z;
        let ray = point.xy() / depth;
        let in_front = depth > 0.0 && ray.norm() <= self.widest; // false for NaN
        in_front.then(|| {
            let (bent, by_ray) = self.params.distortion.distort(&ray);
            let focal = self.params.focal_length;
            let by_point = Matrix2x3::new(1.0, 0.0, -ray.x, 0.0, 1.0, -ray.y) / depth;
            let pixel = focal.component_mul(&bent) + self.params.principal_point;
            (pixel, Matrix2::from_diagonal(&focal) * by_ray * by_point)
        })
    }

    /// The ray of a pixel, as `(X / Z, Y / Z)`; none for a pixel that no ray is seen at.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.ray_with_jacobian(pixel).map(|(ray, _)| ray)
    }

    /// [`ray`](Self::ray), with its Jacobian with respect to the pixel.
    pub fn ray_with_jacobian(&self, pixel: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let focal = self.params.focal_length;
        let bent = (pixel - self.params.principal_point).component_div(&focal);
        if !(bent.x.is_finite() && bent.y.is_finite()) {
            return None;
        }
        let (ray, by_ray) = self.params.distortion.straighten(&bent, self.widest)?;
        let by_bent = by_ray.try_inverse()?;
        Some((ray, by_bent * Matrix2::from_diagonal(&focal.map(|f| 1.0 / f))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn wide() -> PinholeCamera {
        let distortion = LensDistortion { radial: [-0.28, 0.07, 0.0], tangential: [4e-4, -2e-4] };
        let focal_length = Vector2::new(420.0, 424.0);
        PinholeCamera::new(PinholeParams { focal_length, distortion, ..Default::default() }).unwrap()
    }

    proptest! {
        #[test]
        fn pixels_and_points_are_each_others_inverse(x in -0.3..0.3_f64, y in -0.3..0.3_f64, z in 0.5..3.0_f64) {
            let point = Vector3::new(x, y, z);
            let (pixel, by_point) = wide().project_with_jacobian(&point).unwrap();
            let (ray, by_pixel) = wide().ray_with_jacobian(&pixel).unwrap();
            prop_assert!((ray * z - point.xy()).norm() < 1e-12);
            // Moving the point sideways by the ray's Jacobian moves the pixel by one.
            let sideways = by_pixel * z;
            prop_assert!((by_point.fixed_columns::<2>(0) * sideways - Matrix2::identity()).norm() < 1e-9);
            for (axis, column) in by_point.column_iter().enumerate() {
                let mut step = Vector3::zeros();
                step[axis] = 1e-6;
                let slope = (wide().project(&(point + step)).unwrap() - wide().project(&(point - step)).unwrap()) / 2e-6;
                prop_assert!((slope - column).norm() < 1e-4 * (1.0 + column.norm()));
            }
        }
    }

    #[test]
    fn what_cannot_be_seen_has_no_pixel() {
        let nan = f64::NAN;
        for point in
            [(0.0, 0.0, -1.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (nan, 0.0, 1.0), (0.0, 0.0, nan), (50.0, 0.0, 1.0)]
        {
            assert_eq!(wide().project(&Vector3::new(point.0, point.1, point.2)), None, "{point:?}");
        }
        for pixel in [(nan, 0.0), (0.0, f64::INFINITY), (1e9, 0.0)] {
            assert_eq!(wide().ray(&Vector2::new(pixel.0, pixel.1)), None, "{pixel:?}");
        }
        let inside = |u, v| wide().sees(&Vector2::new(u, v));
        assert!(
            inside(0.0, 0.0) && inside(639.4, 479.4) && !inside(640.0, 0.0) && !inside(0.0, -1.0) && !inside(nan, 0.0)
        );
    }

    #[test]
    fn bad_calibrations_are_named() {
        let good = PinholeParams::default();
        for (bad, name) in [
            (PinholeParams { focal_length: Vector2::new(0.0, 600.0), ..good }, "focal_length"),
            (PinholeParams { focal_length: Vector2::new(600.0, f64::NAN), ..good }, "focal_length"),
            (PinholeParams { image_size: Vector2::new(-1.0, 480.0), ..good }, "image_size"),
            (PinholeParams { principal_point: Vector2::new(f64::INFINITY, 0.0), ..good }, "principal_point"),
        ] {
            assert!(PinholeCamera::new(bad).unwrap_err().to_string().starts_with(name), "{bad:?}");
        }
        let distortion = LensDistortion { radial: [0.0; 3], tangential: [f64::NAN, 0.0] };
        assert!(PinholeCamera::new(PinholeParams { distortion, ..good }).is_err());
    }
}
