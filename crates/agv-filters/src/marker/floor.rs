//! Pixels of things that lie on the floor, as places on the floor.
//!
//! A pixel is a ray, and the ray has no depth (paper 001, Eq. 10, lacks it). For what lies on the floor the floor is the
//! depth: with the camera at `c` and its axes `R` in the base frame, whose plane z = 0 is the floor,
//!
//! ```text
//! d = R (x, y, 1)ᵀ,      p = c - (c_z / d_z) d          with (x, y) the ray of the pixel
//! ```
//!
//! For a camera that looks straight down from the height h that is `h (x, y)`, the paper's case. The mapping knows that the
//! floor is level: of the two poses of a tag that a single image of a small one leaves open (the flips of `AprilTag`'s issue
//! 71), only the one that lies on the floor is ever considered.

use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, Se3, So3},
    sensors::PinholeCamera,
};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Least sine of the angle at which a ray may meet the floor, and least height of the camera in metres: below, a pixel is
/// metres of floor.
const GRAZING: f64 = 0.02;

/// A calibrated camera on a vehicle, above a level floor.
///
/// ```
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::{PinholeCamera, PinholeParams};
/// use agv_filters::marker::{FloorProjection, looking_down};
///
/// let camera = PinholeCamera::new(PinholeParams::default())?;
/// // 30 cm above the floor, 20 cm ahead of the vehicle's middle.
/// let floor = FloorProjection::new(camera, looking_down(Vector2::new(0.2, 0.0), 0.3, 0.0))?;
/// let (place, by_pixel) = floor.to_floor(&Vector2::new(319.5, 219.5)).expect("a ray that meets the floor");
/// assert!((place - Vector2::new(0.21, 0.0)).norm() < 1e-12); // 20 pixels up in the image are 1 cm ahead
/// assert!((by_pixel.m12.abs() - 0.0005).abs() < 1e-12); // half a millimetre per pixel
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawProjection"))]
pub struct FloorProjection {
    camera: PinholeCamera,
    base_from_camera: Se3,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawProjection {
    camera: PinholeCamera,
    base_from_camera: Se3,
}

#[cfg(feature = "serde")]
impl TryFrom<RawProjection> for FloorProjection {
    type Error = Error;

    fn try_from(raw: RawProjection) -> Result<Self, Error> {
        Self::new(raw.camera, raw.base_from_camera)
    }
}

/// The mount of a camera that looks straight down from `height` metres above the point `place` of the base frame; the top of
/// its image is ahead, turned to the left by `yaw` radians.
pub fn looking_down(place: Vector2<f64>, height: f64, yaw: f64) -> Se3 {
    // x of the image to the right (-y of the base), y of the image backwards, z down.
    let down = So3::from_roll_pitch_yaw(PI, 0.0, yaw - FRAC_PI_2);
    Se3::from_parts(Vector3::new(place.x, place.y, height), down)
}

impl FloorProjection {
    /// A camera at `base_from_camera`, its z axis along the optical axis; z = 0 of the base frame is the floor.
    ///
    /// # Errors
    /// A mount that is not finite, or one that is less than 2 cm above the floor.
    pub fn new(camera: PinholeCamera, base_from_camera: Se3) -> Result<Self, Error> {
        if !base_from_camera.is_finite() {
            return Err(Error::NotFinite { name: "base_from_camera", value: f64::NAN });
        }
        check::in_range("height of the camera", base_from_camera.translation().z, GRAZING, 1e3)?;
        Ok(Self { camera, base_from_camera })
    }

    /// The camera.
    pub const fn camera(&self) -> &PinholeCamera {
        &self.camera
    }

    /// Where it sits.
    pub const fn base_from_camera(&self) -> &Se3 {
        &self.base_from_camera
    }

    /// Place on the floor of what is seen at a pixel, in the base frame in metres, and its Jacobian with respect to the
    /// pixel; none if the pixel's ray misses the floor or grazes it.
    pub fn to_floor(&self, pixel: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let (ray, by_pixel) = self.camera.ray_with_jacobian(pixel)?;
        let (eye, axes) = (self.base_from_camera.translation(), self.base_from_camera.rotation().matrix());
        let direction = axes * Vector3::new(ray.x, ray.y, 1.0);
        if direction.z > -GRAZING * direction.norm() {
            return None;
        }
        let depth = -eye.z / direction.z;
        let slope = direction.xy() / direction.z;
        let by_direction = Matrix2x3::new(1.0, 0.0, -slope.x, 0.0, 1.0, -slope.y) * depth;
        let by_ray = by_direction * axes.fixed_columns::<2>(0);
        Some((eye.xy() + direction.xy() * depth, by_ray * by_pixel))
    }

    /// Pixel of a place on the floor, given in the base frame in metres; none if it is behind the camera or beyond what its
    /// lens shows. It need not lie in the image: ask [`PinholeCamera::sees`].
    pub fn to_pixel(&self, place: &Vector2<f64>) -> Option<Vector2<f64>> {
        self.camera.project(&self.base_from_camera.inverse().act(&Vector3::new(place.x, place.y, 0.0)))
    }

    /// Where the optical axis meets the floor, and how the image's top is turned, in the base frame: the pose of a
    /// [`MarkerObservation`](agv_core::sensors::MarkerObservation)'s planar sensor. None for a camera that looks level or up.
    pub fn base_from_image(&self) -> Option<Se2> {
        let (centre, by_pixel) = self.to_floor(&self.camera.params().principal_point)?;
        let ahead = -by_pixel.column(1);
        Some(Se2::new(centre.x, centre.y, ahead.y.atan2(ahead.x)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::sensors::{LensDistortion, PinholeParams};
    use proptest::prelude::*;

    fn tilted() -> FloorProjection {
        let distortion = LensDistortion { radial: [-0.2, 0.05, 0.0], tangential: [1e-4, 2e-4] };
        let camera = PinholeCamera::new(PinholeParams { distortion, ..Default::default() }).unwrap();
        // Down, and 30° up again towards the front.
        let tilt = So3::from_roll_pitch_yaw(0.0, -30_f64.to_radians(), 0.2);
        let mount = looking_down(Vector2::new(0.2, -0.05), 0.4, 0.1);
        FloorProjection::new(camera, Se3::from_parts(mount.translation(), tilt * mount.rotation())).unwrap()
    }

    proptest! {
        #[test]
        fn pixels_come_back(u in 0.0..640.0_f64, v in 0.0..480.0_f64) {
            let pixel = Vector2::new(u, v);
            let (place, by_pixel) = tilted().to_floor(&pixel).unwrap();
            prop_assert!((tilted().to_pixel(&place).unwrap() - pixel).norm() < 1e-8);
            for (column, step) in [Vector2::new(1e-4, 0.0), Vector2::new(0.0, 1e-4)].into_iter().enumerate() {
                let moved = |sign: f64| tilted().to_floor(&(pixel + step * sign)).unwrap().0;
                let slope = (moved(1.0) - moved(-1.0)) / 2e-4;
                prop_assert!((slope - by_pixel.column(column)).norm() < 1e-6 * by_pixel.norm());
            }
        }
    }

    #[test]
    fn a_camera_that_looks_down_has_its_image_under_it() {
        let camera = PinholeCamera::new(PinholeParams::default()).unwrap();
        let mount = looking_down(Vector2::new(0.3, 0.1), 0.5, 0.7);
        let image = FloorProjection::new(camera, mount).unwrap().base_from_image().unwrap();
        assert!(image.minus(&Se2::new(0.3, 0.1, 0.7)).norm() < 1e-12);
    }

    #[test]
    fn rays_that_miss_the_floor_have_no_place() {
        let camera = PinholeCamera::new(PinholeParams::default()).unwrap();
        // Level, ahead: x of the image to the right, y down.
        let ahead = So3::from_roll_pitch_yaw(-FRAC_PI_2, 0.0, -FRAC_PI_2);
        let level = FloorProjection::new(camera, Se3::from_parts(Vector3::new(0.0, 0.0, 0.5), ahead)).unwrap();
        assert_eq!(level.to_floor(&Vector2::new(319.5, 100.0)), None, "above the horizon");
        assert_eq!(level.to_floor(&Vector2::new(319.5, 240.0)), None, "grazing");
        let (place, _) = level.to_floor(&Vector2::new(319.5, 439.5)).unwrap();
        assert!((place - Vector2::new(1.5, 0.0)).norm() < 1e-9);
        assert_eq!(level.base_from_image(), None);
        assert_eq!(level.to_pixel(&Vector2::new(-1.0, 0.0)), None, "behind");
        assert_eq!(tilted().to_floor(&Vector2::new(f64::NAN, 0.0)), None);
    }

    #[test]
    fn bad_mounts_are_refused() {
        let camera = PinholeCamera::new(PinholeParams::default()).unwrap();
        for height in [0.0, -0.3, f64::NAN, f64::INFINITY] {
            assert!(FloorProjection::new(camera, looking_down(Vector2::zeros(), height, 0.0)).is_err(), "{height}");
        }
    }
}
