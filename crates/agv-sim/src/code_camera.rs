//! A camera that takes pictures of floor codes: their finder patterns in pixels.
//!
//! Where [`FloorCamera`](crate::FloorCamera) draws the measured pose, this one draws the pixels, for whoever makes a pose of
//! them: through a real lens, from any mount, with codes that are dirty, torn off, or half out of the picture.

use crate::noise::{Part, happens, normal, own_seed};
use crate::{Error, FloorCode, markers::finite_pose};
use agv_core::{
    check,
    compute::Seed,
    geometry::{LieGroup, Se2, Se3},
    sensors::{CodeSighting, PinholeCamera, SensorId},
};
use nalgebra::{Vector2, Vector3};

/// What a camera for codes is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CodeCameraParams {
    /// Which camera of the vehicle it is.
    pub sensor: SensorId,
    /// Intrinsic calibration; what lies outside of the image is not seen.
    pub camera: PinholeCamera,
    /// Pose of the camera on the vehicle, whose plane z = 0 is the floor: z ahead along the optical axis, x to the right of the
    /// image, y down.
    pub base_from_camera: Se3,
    /// Distance between the centres of a code's neighbouring finder patterns, in metres.
    pub finder_spacing: f64,
    /// Standard deviation of a finder pattern's centre along each axis of the image, in pixels.
    pub pixel_sigma: f64,
    /// Share of the codes that are damaged: their finder patterns are seen, their number is not read; which ones, the seed and
    /// their number decide.
    pub damaged: f64,
    /// Share of the codes that are gone.
    pub gone: f64,
    /// Probability that a code in view is not found this time.
    pub missed: f64,
}

impl CodeCameraParams {
    /// A camera at this mount over good codes of 10 cm (21 modules, the finder patterns 14 modules apart), half a pixel of noise.
    pub fn new(camera: PinholeCamera, base_from_camera: Se3) -> Self {
        Self {
            sensor: SensorId::default(),
            camera,
            base_from_camera,
            finder_spacing: 0.1 * 14.0 / 21.0,
            pixel_sigma: 0.5,
            damaged: 0.0,
            gone: 0.0,
            missed: 0.0,
        }
    }
}

/// A camera over floor codes.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Se3, So3};
/// use agv_core::nalgebra::Vector3;
/// use agv_core::sensors::{PinholeCamera, PinholeParams};
/// use agv_sim::{CodeCamera, CodeCameraParams, FloorCode};
/// use std::f64::consts::PI;
///
/// let down = Se3::from_parts(Vector3::new(0.0, 0.0, 0.3), So3::from_roll_pitch_yaw(PI, 0.0, 0.0));
/// let params = CodeCameraParams::new(PinholeCamera::new(PinholeParams::default())?, down);
/// let mut camera = CodeCamera::new(params, FloorCode::lattice(Se2::default(), 10, 10, 1.0)?, Seed(1))?;
/// assert_eq!(camera.look(&Se2::new(3.02, 2.0, 0.4))?[0].id, Some(23));
/// assert!(camera.look(&Se2::new(3.5, 2.5, 0.4))?.is_empty());
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct CodeCamera {
    params: CodeCameraParams,
    codes: Vec<FloorCode>,
    seed: Seed,
    step: u64,
    seen: Vec<CodeSighting>,
}

impl CodeCamera {
    /// A camera over these codes.
    ///
    /// # Errors
    /// A parameter out of its range, or a code whose pose is not finite.
    pub fn new(params: CodeCameraParams, codes: Vec<FloorCode>, seed: Seed) -> Result<Self, Error> {
        if !params.base_from_camera.is_finite() {
            return Err(agv_core::Error::NotFinite { name: "base_from_camera", value: f64::NAN }.into());
        }
        check::positive("finder_spacing", params.finder_spacing)?;
        check::non_negative("pixel_sigma", params.pixel_sigma)?;
        for (name, share) in [("damaged", params.damaged), ("gone", params.gone), ("missed", params.missed)] {
            check::in_range(name, share, 0.0, 1.0)?;
        }
        codes.iter().try_for_each(|code| finite_pose("map_from_code", &code.map_from_code))?;
        let seed = own_seed(seed, Part::CodeCamera, params.sensor);
        let seen = Vec::with_capacity(codes.len());
        Ok(Self { params, codes, seed, step: 0, seen })
    }

    /// What the camera is like.
    pub const fn params(&self) -> &CodeCameraParams {
        &self.params
    }

    /// All codes, damaged and gone ones among them.
    pub fn codes(&self) -> &[FloorCode] {
        &self.codes
    }

    /// Ground truth: whether the number of this code can never be read.
    pub fn is_damaged(&self, id: u32) -> bool {
        self.has_fate(1, self.params.damaged, id)
    }

    /// Ground truth: whether this code is not there any more.
    pub fn is_gone(&self, id: u32) -> bool {
        self.has_fate(2, self.params.gone, id)
    }

    /// Not keyed by the step: what a code is, it stays.
    fn has_fate(&self, fate: u64, share: f64, id: u32) -> bool {
        share > 0.0 && happens(share, &mut self.seed.derive(fate).stream(0, u64::from(id)))
    }

    /// What was seen last.
    pub fn last(&self) -> &[CodeSighting] {
        &self.seen
    }

    /// What is seen from `map_from_base`, in the order of the codes: those whose three finder patterns are in the image.
    /// O(codes); no allocation.
    ///
    /// # Errors
    /// A pose that is not finite; the camera is then as it was.
    pub fn look(&mut self, map_from_base: &Se2) -> Result<&[CodeSighting], Error> {
        finite_pose("map_from_base", map_from_base)?;
        let params = self.params;
        let camera_from_map = (Se3::from(*map_from_base) * params.base_from_camera).inverse();
        let half = 0.5 * params.finder_spacing;
        let finders = [Vector2::new(-half, half), Vector2::new(half, half), Vector2::new(-half, -half)];
        self.seen.clear();
        for (index, code) in self.codes.iter().enumerate() {
            let place = code.map_from_code.translation() - map_from_base.translation();
            // Far from the vehicle there is no need to project.
            if place.norm() > FARTHEST || self.is_gone(code.id) {
                continue;
            }
            let mut stream = self.seed.stream(self.step, index as u64);
            if happens(params.missed, &mut stream) {
                continue;
            }
            let mut pixels = [Vector2::zeros(); 3];
            let is_in_image = pixels.iter_mut().zip(&finders).all(|(slot, finder)| {
                let place = code.map_from_code * *finder;
                let point = camera_from_map.act(&Vector3::new(place.x, place.y, 0.0));
                let pixel = params.camera.project(&point).filter(|pixel| params.camera.sees(pixel));
                pixel.map(|pixel| *slot = pixel).is_some()
            });
            if is_in_image {
                let noisy = pixels.map(|pixel| pixel.map(|axis| axis + normal(params.pixel_sigma, &mut stream)));
                let id = (!self.is_damaged(code.id)).then_some(code.id);
                self.seen.push(CodeSighting { id, finders: noisy });
            }
        }
        self.step += 1;
        Ok(&self.seen)
    }
}

/// Distance beyond which no code is read whatever the camera, in metres.
const FARTHEST: f64 = 10.0;

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{geometry::So3, sensors::PinholeParams};
    use std::f64::consts::PI;

    fn params() -> CodeCameraParams {
        // 30 cm up, 20 cm ahead, the top of the image to the left.
        let down = Se3::from_parts(Vector3::new(0.2, 0.0, 0.3), So3::from_roll_pitch_yaw(PI, 0.0, 0.0));
        CodeCameraParams::new(PinholeCamera::new(PinholeParams::default()).unwrap(), down)
    }

    fn camera(params: CodeCameraParams) -> CodeCamera {
        CodeCamera::new(params, FloorCode::lattice(Se2::default(), 20, 20, 0.5).unwrap(), Seed(2)).unwrap()
    }

    /// Two thousand pixels per metre of floor, x of the image ahead and y to the right.
    #[test]
    fn patterns_are_where_a_ruler_says() {
        let mut camera = camera(CodeCameraParams { pixel_sigma: 0.0, ..params() });
        let base = Se2::new(1.5 - 0.2 - 0.01, 2.0 - 0.02, 0.0); // the code 1 cm ahead and 2 cm to the left of the axis
        let seen = camera.look(&base).unwrap();
        assert_eq!(seen.len(), 1);
        let half = 0.1 / 3.0;
        let expected = [(-half, half), (half, half), (-half, -half)]
            .map(|(x, y)| Vector2::new(319.5 + 2000.0 * (0.01 + x), 239.5 - 2000.0 * (0.02 + y)));
        for (pixel, expected) in seen[0].finders.iter().zip(expected) {
            assert!((pixel - expected).norm() < 1e-9, "{pixel} {expected}");
        }
    }

    /// Squared noise of 400 codes with six coordinates each: chi-square within 4.5 deviations.
    #[test]
    fn pixel_noise_has_the_stated_size() {
        let (mut noisy, mut exact) = (camera(params()), camera(CodeCameraParams { pixel_sigma: 0.0, ..params() }));
        let mut squares = 0.0;
        for code in noisy.codes().to_vec() {
            let base = code.map_from_code * Se2::new(-0.2, 0.0, 0.0);
            let (a, b) = (noisy.look(&base).unwrap()[0], exact.look(&base).unwrap()[0]);
            squares += a.finders.iter().zip(&b.finders).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / 0.25;
        }
        assert!((squares - 2400.0).abs() < 4.5 * 4800_f64.sqrt(), "{squares}");
    }

    #[test]
    fn damaged_codes_are_seen_unread_and_gone_ones_not_at_all() {
        let mut camera = camera(CodeCameraParams { damaged: 0.3, gone: 0.2, missed: 0.5, ..params() });
        let count = |is: &dyn Fn(u32) -> bool| camera.codes().iter().filter(|code| is(code.id)).count() as f64;
        let (damaged, gone) = (count(&|id| camera.is_damaged(id)), count(&|id| camera.is_gone(id)));
        assert!((damaged - 120.0).abs() < 4.5 * 84_f64.sqrt() && (gone - 80.0).abs() < 4.5 * 64_f64.sqrt());
        for code in camera.codes().to_vec().into_iter().take(60) {
            let base = code.map_from_code * Se2::new(-0.2, 0.0, 0.0);
            // A code that is there is missed 40 times in a row with probability 1e-12.
            let seen = (0..40).find_map(|_| camera.look(&base).unwrap().first().copied());
            assert_eq!(seen.is_none(), camera.is_gone(code.id));
            if let Some(seen) = seen {
                assert_eq!(seen.id, (!camera.is_damaged(code.id)).then_some(code.id));
            }
        }
    }

    #[test]
    fn codes_at_the_edge_of_the_image_are_left_out() {
        let mut camera = camera(CodeCameraParams { pixel_sigma: 0.0, ..params() });
        // The image is 32 cm by 24 cm, the code's patterns reach 3.3 cm from its centre.
        let mut sees = |ahead: f64| !camera.look(&Se2::new(1.5 - 0.2 - ahead, 2.0, 0.0)).unwrap().is_empty();
        assert!(sees(0.12) && sees(-0.12) && !sees(0.13) && !sees(-0.13));
    }

    #[test]
    fn bad_cameras_and_poses_are_refused() {
        let good = params();
        let nan = Se3::from_parts(Vector3::repeat(f64::NAN), So3::default());
        for bad in [
            CodeCameraParams { base_from_camera: nan, ..good },
            CodeCameraParams { finder_spacing: 0.0, ..good },
            CodeCameraParams { pixel_sigma: -1.0, ..good },
            CodeCameraParams { damaged: 1.1, ..good },
            CodeCameraParams { gone: f64::NAN, ..good },
            CodeCameraParams { missed: -0.1, ..good },
        ] {
            assert!(CodeCamera::new(bad, vec![], Seed(0)).is_err(), "{bad:?}");
        }
        let lost = FloorCode { id: 0, map_from_code: Se2::new(f64::NAN, 0.0, 0.0) };
        assert!(CodeCamera::new(good, vec![lost], Seed(0)).is_err());
        assert!(camera(good).look(&Se2::new(0.0, f64::INFINITY, 0.0)).is_err());
    }
}
