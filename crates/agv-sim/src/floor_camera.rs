//! A camera that looks down at codes on the floor.

use crate::noise::{Part, happens, normal, own_seed};
use crate::{Error, FloorCode, markers::finite_pose};
use agv_core::{
    check,
    compute::Seed,
    geometry::{LieGroup, Se2, UncertainPose},
    sensors::{MarkerObservation, SensorId},
    time::Stamp,
};
use nalgebra::{Matrix3, Vector3};

/// What a down-looking camera is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloorCameraParams {
    /// Which camera of the vehicle it is.
    pub sensor: SensorId,
    /// Where the optical axis meets the floor, and how the image is turned, on the vehicle.
    pub base_from_sensor: Se2,
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
            sensor: SensorId::default(),
            base_from_sensor: Se2::default(),
            radius: 0.15,
            position_sigma: 0.005,
            yaw_sigma: 0.5_f64.to_radians(),
            damaged: 0.0,
            missed: 0.0,
        }
    }
}

/// A camera that looks down at floor codes.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::time::Stamp;
/// use agv_sim::{FloorCamera, FloorCameraParams, FloorCode};
///
/// let codes = FloorCode::lattice(Se2::default(), 10, 10, 1.0)?;
/// let mut camera = FloorCamera::new(FloorCameraParams::default(), codes, Seed(1))?;
/// assert_eq!(camera.look(&Se2::new(3.05, 2.0, 0.4), Stamp::default())?[0].id(), 23);
/// assert!(camera.look(&Se2::new(3.5, 2.5, 0.4), Stamp::default())?.is_empty());
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FloorCamera {
    params: FloorCameraParams,
    codes: Vec<FloorCode>,
    seed: Seed,
    step: u64,
    seen: Vec<MarkerObservation<Se2>>,
}

impl FloorCamera {
    /// A camera over these codes.
    ///
    /// # Errors
    /// A parameter out of its range, or a code whose pose is not finite.
    pub fn new(params: FloorCameraParams, codes: Vec<FloorCode>, seed: Seed) -> Result<Self, Error> {
        finite_pose("base_from_sensor", &params.base_from_sensor)?;
        check::positive("radius", params.radius)?;
        check::non_negative("position_sigma", params.position_sigma)?;
        check::non_negative("yaw_sigma", params.yaw_sigma)?;
        check::in_range("damaged", params.damaged, 0.0, 1.0)?;
        check::in_range("missed", params.missed, 0.0, 1.0)?;
        codes.iter().try_for_each(|code| finite_pose("map_from_code", &code.map_from_code))?;
        let seed = own_seed(seed, Part::FloorCamera, params.sensor);
        let seen = Vec::with_capacity(codes.len());
        Ok(Self { params, codes, seed, step: 0, seen })
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

    /// What the camera is like.
    pub const fn params(&self) -> &FloorCameraParams {
        &self.params
    }

    /// What was seen last.
    pub fn last(&self) -> &[MarkerObservation<Se2>] {
        &self.seen
    }

    /// What is seen at `stamp` from `map_from_base`, in the order of the codes. O(codes); no allocation.
    ///
    /// # Errors
    /// A pose that is not finite; the camera is then as it was.
    pub fn look(&mut self, map_from_base: &Se2, stamp: Stamp) -> Result<&[MarkerObservation<Se2>], Error> {
        finite_pose("map_from_base", map_from_base)?;
        let params = self.params;
        let map_from_sensor = *map_from_base * params.base_from_sensor;
        let sigmas = Vector3::new(params.position_sigma, params.position_sigma, params.yaw_sigma);
        let covariance = Matrix3::from_diagonal(&sigmas.component_mul(&sigmas));
        self.seen.clear();
        for (index, code) in self.codes.iter().enumerate() {
            let sensor_from_code = map_from_sensor.between(&code.map_from_code);
            if sensor_from_code.translation().norm() > params.radius || self.is_damaged(code.id) {
                continue;
            }
            // A stream per code: what else is in view does not change its noise.
            let mut stream = self.seed.stream(self.step, index as u64);
            let missed = happens(params.missed, &mut stream);
            let noisy = Se2::new(
                sensor_from_code.x() + normal(params.position_sigma, &mut stream),
                sensor_from_code.y() + normal(params.position_sigma, &mut stream),
                sensor_from_code.yaw() + normal(params.yaw_sigma, &mut stream),
            );
            if !missed {
                let pose = UncertainPose::new(noisy, covariance)?;
                let marker = MarkerObservation::new(stamp, code.id, pose).with_sensor(params.sensor);
                self.seen.push(marker.with_mount(params.base_from_sensor)?);
            }
        }
        self.step += 1;
        Ok(&self.seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floor(params: FloorCameraParams) -> FloorCamera {
        FloorCamera::new(params, FloorCode::lattice(Se2::default(), 40, 40, 0.5).unwrap(), Seed(2)).unwrap()
    }

    /// The measured pose has the spread that it states about the truth: chi-square over 3 * 1600 scores.
    #[test]
    fn code_noise_has_the_stated_size() {
        let mut camera = floor(FloorCameraParams { base_from_sensor: Se2::new(0.2, -0.1, 1.0), ..Default::default() });
        let mut squares = 0.0;
        for code in camera.codes().to_vec() {
            // The base stands so that the camera is 5 cm off the code's centre.
            let camera_in_map = code.map_from_code * Se2::new(0.03, 0.04, 0.8);
            let base = camera_in_map * camera.params.base_from_sensor.inverse();
            let sighting = camera.look(&base, Stamp::default()).unwrap()[0];
            assert_eq!((sighting.id(), sighting.base_from_sensor()), (code.id, camera.params.base_from_sensor));
            let truth = camera_in_map.between(&code.map_from_code);
            // By the covariance that the observation states, in the frame that it is stated in.
            let measured = sighting.sensor_from_marker();
            let error = measured.mean().minus(&truth);
            squares += error.dot(&(measured.covariance().try_inverse().unwrap() * error));
        }
        assert!((squares - 4800.0).abs() < 4.5 * 9600_f64.sqrt(), "{squares}");
    }

    #[test]
    fn damaged_codes_stay_damaged_and_missed_ones_do_not() {
        let mut camera = floor(FloorCameraParams { damaged: 0.2, missed: 0.5, ..Default::default() });
        let damaged = camera.codes().iter().filter(|c| camera.is_damaged(c.id)).count() as f64;
        assert!((damaged - 320.0).abs() < 4.5 * 256_f64.sqrt(), "{damaged}");
        for code in camera.codes().to_vec().into_iter().take(50) {
            let reads =
                (0..40).filter(|_| !camera.look(&code.map_from_code, Stamp::default()).unwrap().is_empty()).count();
            // A good code misses 40 times in a row with probability 1e-12.
            assert_eq!(reads == 0, camera.is_damaged(code.id));
        }
    }

    #[test]
    fn bad_cameras_and_poses_are_refused() {
        let nan = Se2::new(f64::NAN, 0.0, 0.0);
        let down = FloorCameraParams::default();
        for bad in [
            FloorCameraParams { base_from_sensor: nan, ..down },
            FloorCameraParams { radius: 0.0, ..down },
            FloorCameraParams { position_sigma: -1.0, ..down },
            FloorCameraParams { yaw_sigma: f64::NAN, ..down },
            FloorCameraParams { damaged: 1.1, ..down },
            FloorCameraParams { missed: -0.1, ..down },
        ] {
            assert!(FloorCamera::new(bad, vec![], Seed(0)).is_err(), "{bad:?}");
        }
        assert!(FloorCamera::new(down, vec![FloorCode { id: 0, map_from_code: nan }], Seed(0)).is_err());
        assert!(floor(down).look(&nan, Stamp::default()).is_err());
        assert!(FloorCode::lattice(nan, 1, 1, 1.0).is_err());
        assert!(FloorCode::lattice(Se2::default(), 1, 1, 0.0).is_err());
        assert!(FloorCode::lattice(Se2::default(), u32::MAX, u32::MAX, 1.0).is_err());
        assert_eq!(FloorCode::lattice(Se2::default(), 0, 5, 1.0), Ok(vec![]));
    }
}
