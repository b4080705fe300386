//! Cameras: one looks down at floor codes, one looks ahead at landmarks.

use crate::noise::{happens, normal};
use crate::{CodeSighting, Error, FloorCode, Landmark, LandmarkSighting, PlanarWorld};
use agv_core::{
    check,
    compute::Seed,
    geometry::{LieGroup, Se2, wrap_angle},
};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// What a down-looking camera is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloorCameraParams {
    /// Where the optical axis meets the floor, and how the image is turned, on the vehicle.
    pub base_from_camera: Se2,
    /// A code is seen if its centre is at most this far from the image's centre, in metres.
    pub radius: f64,
    /// Standard deviation of each coordinate of a measured position, in metres.
    pub position_sigma: f64,
    /// Standard deviation of a measured heading, in radians.
    pub yaw_sigma: f64,
    /// Share of the codes that are damaged and never read, from 0 to 1; which ones, the seed and their number decide.
    pub damaged: f64,
    /// Probability that a good code in view is not read this time.
    pub missed: f64,
}

impl Default for FloorCameraParams {
    /// The stand-in of the paper sheet for paper 001: seen within 0.15 m, 5 mm and 0.5°, every code good.
    fn default() -> Self {
        Self {
            base_from_camera: Se2::default(),
            radius: 0.15,
            position_sigma: 0.005,
            yaw_sigma: 0.5_f64.to_radians(),
            damaged: 0.0,
            missed: 0.0,
        }
    }
}

fn finite_pose(name: &'static str, pose: &Se2) -> Result<(), Error> {
    Ok(check::all_finite(name, &[pose.x(), pose.y(), pose.yaw()])?)
}

/// A camera that looks down at floor codes.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_sim::{FloorCamera, FloorCameraParams, FloorCode};
///
/// let codes = FloorCode::lattice(Se2::default(), 10, 10, 1.0)?;
/// let mut camera = FloorCamera::new(FloorCameraParams::default(), codes, Seed(1))?;
/// assert_eq!(camera.look(&Se2::new(3.05, 2.0, 0.4))?[0].id, 23);
/// assert!(camera.look(&Se2::new(3.5, 2.5, 0.4))?.is_empty());
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FloorCamera {
    params: FloorCameraParams,
    codes: Vec<FloorCode>,
    seed: Seed,
    step: u64,
    sightings: Vec<CodeSighting>,
}

impl FloorCamera {
    /// A camera over these codes.
    ///
    /// # Errors
    /// A parameter out of its range, or a code whose pose is not finite.
    pub fn new(params: FloorCameraParams, codes: Vec<FloorCode>, seed: Seed) -> Result<Self, Error> {
        finite_pose("base_from_camera", &params.base_from_camera)?;
        check::positive("radius", params.radius)?;
        check::non_negative("position_sigma", params.position_sigma)?;
        check::non_negative("yaw_sigma", params.yaw_sigma)?;
        check::in_range("damaged", params.damaged, 0.0, 1.0)?;
        check::in_range("missed", params.missed, 0.0, 1.0)?;
        codes.iter().try_for_each(|code| finite_pose("map_from_code", &code.map_from_code))?;
        let sightings = Vec::with_capacity(codes.len());
        Ok(Self { params, codes, seed, step: 0, sightings })
    }

    /// Ground truth: whether the code of this number can never be read.
    pub fn is_damaged(&self, id: u32) -> bool {
        // Not keyed by the step: a damaged code stays damaged.
        self.params.damaged > 0.0 && happens(self.params.damaged, &mut self.seed.derive(1).stream(0, u64::from(id)))
    }

    /// All codes, damaged or not.
    pub fn codes(&self) -> &[FloorCode] {
        &self.codes
    }

    /// What is seen from `map_from_base`, in the order of the codes. O(codes).
    ///
    /// # Errors
    /// A pose that is not finite; the camera's random state is then as it was.
    pub fn look(&mut self, map_from_base: &Se2) -> Result<&[CodeSighting], Error> {
        finite_pose("map_from_base", map_from_base)?;
        let params = self.params;
        let map_from_camera = *map_from_base * params.base_from_camera;
        self.sightings.clear();
        for (index, code) in self.codes.iter().enumerate() {
            let camera_from_code = map_from_camera.between(&code.map_from_code);
            if camera_from_code.translation().norm() > params.radius || self.is_damaged(code.id) {
                continue;
            }
            // A stream per code: what else is in view does not change its noise.
            let mut stream = self.seed.stream(self.step, index as u64);
            let missed = happens(params.missed, &mut stream);
            let noisy = Se2::new(
                camera_from_code.x() + normal(params.position_sigma, &mut stream),
                camera_from_code.y() + normal(params.position_sigma, &mut stream),
                camera_from_code.yaw() + normal(params.yaw_sigma, &mut stream),
            );
            if !missed {
                self.sightings.push(CodeSighting { id: code.id, base_from_code: params.base_from_camera * noisy });
            }
        }
        self.step += 1;
        Ok(&self.sightings)
    }
}

/// What a forward camera is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrontCameraParams {
    /// Pose of the camera on the vehicle, its optical axis along x.
    pub base_from_camera: Se2,
    /// Angle of view, in radians, up to a full turn.
    pub field_of_view: f64,
    /// Least distance of a landmark that is recognised, in metres.
    pub range_min: f64,
    /// Greatest distance of a landmark that is recognised, in metres.
    pub range_max: f64,
    /// Standard deviation of a measured range as a share of the range.
    pub relative_sigma: f64,
    /// Standard deviation of a measured bearing, in radians.
    pub bearing_sigma: f64,
    /// Probability that a landmark in view is not recognised this time.
    pub missed: f64,
}

impl Default for FrontCameraParams {
    /// A 90° camera that recognises landmarks up to 8 m off: 2 % of range, 0.5°, one in twenty missed.
    fn default() -> Self {
        Self {
            base_from_camera: Se2::default(),
            field_of_view: 0.25 * TAU,
            range_min: 0.2,
            range_max: 8.0,
            relative_sigma: 0.02,
            bearing_sigma: 0.5_f64.to_radians(),
            missed: 0.05,
        }
    }
}

/// A camera that looks ahead at landmarks, which the world may hide.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{FrontCamera, FrontCameraParams, Landmark, World2d};
///
/// let landmarks = vec![Landmark { id: 4, position: Vector2::new(5.0, 0.5) }];
/// let params = FrontCameraParams { missed: 0.0, ..Default::default() };
/// let mut camera = FrontCamera::new(params, landmarks, Seed(1))?;
/// let open = World2d::new(vec![])?;
/// let sighting = camera.look(&open, &Se2::default())?[0];
/// assert!((sighting.range - 5.02).abs() < 0.5 && (sighting.bearing - 0.1).abs() < 0.05);
/// assert!(camera.look(&open, &Se2::new(0.0, 0.0, 3.0))?.is_empty());
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FrontCamera {
    params: FrontCameraParams,
    landmarks: Vec<Landmark>,
    seed: Seed,
    step: u64,
    sightings: Vec<LandmarkSighting>,
}

/// How far in front of a surface a landmark may be drawn and still count as on it, in metres.
const ON_SURFACE: f64 = 0.05;

impl FrontCamera {
    /// A camera for these landmarks.
    ///
    /// # Errors
    /// A parameter out of its range, or a landmark that is not finite.
    pub fn new(params: FrontCameraParams, landmarks: Vec<Landmark>, seed: Seed) -> Result<Self, Error> {
        finite_pose("base_from_camera", &params.base_from_camera)?;
        check::positive("field_of_view", params.field_of_view)?;
        check::in_range("field_of_view", params.field_of_view, 0.0, TAU)?;
        check::positive("range_max", params.range_max)?;
        check::in_range("range_min", params.range_min, 0.0, params.range_max)?;
        check::non_negative("relative_sigma", params.relative_sigma)?;
        check::non_negative("bearing_sigma", params.bearing_sigma)?;
        check::in_range("missed", params.missed, 0.0, 1.0)?;
        check::all_finite("landmark", landmarks.iter().flat_map(|l| l.position.iter()))?;
        let sightings = Vec::with_capacity(landmarks.len());
        Ok(Self { params, landmarks, seed, step: 0, sightings })
    }

    /// All landmarks.
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// What is seen from `map_from_base` in this world, in the order of the landmarks. A landmark on the surface of an
    /// obstacle is not hidden by it. O(landmarks) rays at most.
    ///
    /// # Errors
    /// A pose that is not finite; the camera's random state is then as it was.
    pub fn look<W: PlanarWorld + ?Sized>(
        &mut self,
        world: &W,
        map_from_base: &Se2,
    ) -> Result<&[LandmarkSighting], Error> {
        finite_pose("map_from_base", map_from_base)?;
        let params = self.params;
        let map_from_camera = *map_from_base * params.base_from_camera;
        let (eye, camera_from_map) = (map_from_camera.translation(), map_from_camera.inverse());
        self.sightings.clear();
        for (index, landmark) in self.landmarks.iter().enumerate() {
            let seen: Vector2<f64> = camera_from_map * landmark.position;
            let (range, bearing) = (seen.norm(), seen.y.atan2(seen.x));
            let in_view =
                range >= params.range_min && range <= params.range_max && bearing.abs() <= 0.5 * params.field_of_view;
            // The ray ends short of the landmark, so that the wall that carries it does not count.
            let hidden =
                |reach: f64| reach > 0.0 && world.cast(&eye, &((landmark.position - eye) / range), reach).is_some();
            if !in_view || hidden(range - ON_SURFACE) {
                continue;
            }
            let mut stream = self.seed.stream(self.step, index as u64);
            let missed = happens(params.missed, &mut stream);
            let measured = range * (1.0 + normal(params.relative_sigma, &mut stream));
            let direction = wrap_angle(bearing + normal(params.bearing_sigma, &mut stream));
            if !missed {
                self.sightings.push(LandmarkSighting { id: landmark.id, range: measured, bearing: direction });
            }
        }
        self.step += 1;
        Ok(&self.sightings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Shape, World2d};

    fn floor(params: FloorCameraParams) -> FloorCamera {
        FloorCamera::new(params, FloorCode::lattice(Se2::default(), 40, 40, 0.5).unwrap(), Seed(2)).unwrap()
    }

    /// The pose that a sighting implies has the stated spread about the truth: chi-square over 3 * 1600 scores.
    #[test]
    fn code_noise_has_the_stated_size() {
        let mut camera = floor(FloorCameraParams { base_from_camera: Se2::new(0.2, -0.1, 1.0), ..Default::default() });
        let mut squares = 0.0;
        for code in camera.codes().to_vec() {
            // The base stands so that the camera is 5 cm off the code's centre.
            let camera_in_map = code.map_from_code * Se2::new(0.03, 0.04, 0.8);
            let base = camera_in_map * camera.params.base_from_camera.inverse();
            let sighting = camera.look(&base).unwrap()[0];
            assert_eq!(sighting.id, code.id);
            let truth = camera_in_map.between(&code.map_from_code);
            let error = camera.params.base_from_camera.between(&sighting.base_from_code);
            squares += ((error.translation() - truth.translation()) / 0.005).norm_squared();
            squares += (wrap_angle(error.yaw() - truth.yaw()) / 0.5_f64.to_radians()).powi(2);
        }
        assert!((squares - 4800.0).abs() < 4.5 * 9600_f64.sqrt(), "{squares}");
    }

    #[test]
    fn damaged_codes_stay_damaged_and_missed_ones_do_not() {
        let mut camera = floor(FloorCameraParams { damaged: 0.2, missed: 0.5, ..Default::default() });
        let damaged = camera.codes().iter().filter(|c| camera.is_damaged(c.id)).count() as f64;
        assert!((damaged - 320.0).abs() < 4.5 * 256_f64.sqrt(), "{damaged}");
        for code in camera.codes().to_vec().into_iter().take(50) {
            let reads = (0..40).filter(|_| !camera.look(&code.map_from_code).unwrap().is_empty()).count();
            // A good code misses 40 times in a row with probability 1e-12.
            assert_eq!(reads == 0, camera.is_damaged(code.id));
        }
    }

    fn front(landmarks: &[(f64, f64)], params: FrontCameraParams) -> FrontCamera {
        let landmark = |(id, &(x, y)): (usize, &(f64, f64))| Landmark { id: id as u32, position: Vector2::new(x, y) };
        FrontCamera::new(params, landmarks.iter().enumerate().map(landmark).collect(), Seed(2)).unwrap()
    }

    #[test]
    fn only_what_is_in_view_and_not_hidden_is_seen() {
        let ideal = FrontCameraParams { relative_sigma: 0.0, bearing_sigma: 0.0, missed: 0.0, ..Default::default() };
        let pillar = World2d::new(vec![Shape::Circle { center: Vector2::new(3.0, 0.0), radius: 0.5 }]).unwrap();
        // Behind the pillar, on it, in the clear, beyond the range, behind the back, out of the field of view, too near.
        let places = [(5.0, 0.0), (2.5, 0.0), (5.0, 2.0), (9.0, 3.0), (-3.0, 0.0), (1.0, 2.0), (0.1, 0.0)];
        let mut camera = front(&places, ideal);
        let seen: Vec<u32> = camera.look(&pillar, &Se2::default()).unwrap().iter().map(|s| s.id).collect();
        assert_eq!(seen, [1, 2]);
        let sighting = camera.look(&pillar, &Se2::new(1.0, 0.0, 0.3)).unwrap()[1];
        assert!(
            (sighting.range - 20_f64.sqrt()).abs() < 1e-12 && (sighting.bearing - (0.5_f64.atan() - 0.3)).abs() < 1e-12
        );
    }

    #[test]
    fn landmark_noise_has_the_stated_size() {
        let mut camera = front(&[(4.0, 0.0)], FrontCameraParams { missed: 0.0, ..Default::default() });
        let open = World2d::new(vec![]).unwrap();
        let mut squares = 0.0;
        for _ in 0..5000 {
            let sighting = camera.look(&open, &Se2::default()).unwrap()[0];
            squares += ((sighting.range - 4.0) / 0.08).powi(2) + (sighting.bearing / 0.5_f64.to_radians()).powi(2);
        }
        assert!((squares - 10_000.0).abs() < 4.5 * 20_000_f64.sqrt(), "{squares}");
    }

    #[test]
    fn bad_cameras_and_poses_are_refused() {
        let nan = Se2::new(f64::NAN, 0.0, 0.0);
        let down = FloorCameraParams::default();
        for bad in [
            FloorCameraParams { base_from_camera: nan, ..down },
            FloorCameraParams { radius: 0.0, ..down },
            FloorCameraParams { position_sigma: -1.0, ..down },
            FloorCameraParams { yaw_sigma: f64::NAN, ..down },
            FloorCameraParams { damaged: 1.1, ..down },
            FloorCameraParams { missed: -0.1, ..down },
        ] {
            assert!(FloorCamera::new(bad, vec![], Seed(0)).is_err(), "{bad:?}");
        }
        assert!(FloorCamera::new(down, vec![FloorCode { id: 0, map_from_code: nan }], Seed(0)).is_err());
        assert!(floor(down).look(&nan).is_err());
        let ahead = FrontCameraParams::default();
        for bad in [
            FrontCameraParams { base_from_camera: nan, ..ahead },
            FrontCameraParams { field_of_view: 7.0, ..ahead },
            FrontCameraParams { range_min: 9.0, ..ahead },
            FrontCameraParams { range_max: f64::NAN, ..ahead },
            FrontCameraParams { relative_sigma: -0.1, ..ahead },
            FrontCameraParams { bearing_sigma: f64::NAN, ..ahead },
            FrontCameraParams { missed: 2.0, ..ahead },
        ] {
            assert!(FrontCamera::new(bad, vec![], Seed(0)).is_err(), "{bad:?}");
        }
        let astray = Landmark { id: 0, position: Vector2::new(f64::NAN, 0.0) };
        assert!(FrontCamera::new(ahead, vec![astray], Seed(0)).is_err());
        assert!(front(&[], ahead).look(&World2d::new(vec![]).unwrap(), &nan).is_err());
        assert!(FloorCode::lattice(nan, 1, 1, 1.0).is_err());
        assert!(FloorCode::lattice(Se2::default(), 1, 1, 0.0).is_err());
        assert!(FloorCode::lattice(Se2::default(), u32::MAX, u32::MAX, 1.0).is_err());
        assert_eq!(FloorCode::lattice(Se2::default(), 0, 5, 1.0), Ok(vec![]));
    }
}
