//! A camera that looks ahead at landmarks.

use crate::noise::{Part, happens, normal, own_seed};
use crate::{Error, Landmark, PlanarWorld, markers::finite_pose};
use agv_core::{
    check,
    compute::Seed,
    geometry::{LieGroup, Se2, UncertainVector},
    sensors::{LandmarkObservation, SensorId},
    time::Stamp,
};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// What a forward camera is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrontCameraParams {
    /// Which camera of the vehicle it is.
    pub sensor: SensorId,
    /// Pose of the camera on the vehicle, its optical axis along x.
    pub base_from_sensor: Se2,
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
            sensor: SensorId::default(),
            base_from_sensor: Se2::default(),
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
/// use agv_core::time::Stamp;
/// use agv_sim::{FrontCamera, FrontCameraParams, Landmark, World2d};
///
/// let landmarks = vec![Landmark { id: 4, position: Vector2::new(5.0, 0.5) }];
/// let params = FrontCameraParams { missed: 0.0, ..Default::default() };
/// let mut camera = FrontCamera::new(params, landmarks, Seed(1))?;
/// let open = World2d::new(vec![])?;
/// let seen = camera.look(&open, &Se2::default(), Stamp::default())?[0];
/// assert!((seen.range() - 5.02).abs() < 0.5 && (seen.bearing() - 0.1).abs() < 0.05);
/// assert!(camera.look(&open, &Se2::new(0.0, 0.0, 3.0), Stamp::default())?.is_empty());
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FrontCamera {
    params: FrontCameraParams,
    landmarks: Vec<Landmark>,
    seed: Seed,
    step: u64,
    seen: Vec<LandmarkObservation>,
}

/// How far in front of a surface a landmark may be drawn and still count as on it, in metres.
const ON_SURFACE: f64 = 0.05;

impl FrontCamera {
    /// A camera for these landmarks.
    ///
    /// # Errors
    /// A parameter out of its range, or a landmark that is not finite.
    pub fn new(params: FrontCameraParams, landmarks: Vec<Landmark>, seed: Seed) -> Result<Self, Error> {
        finite_pose("base_from_sensor", &params.base_from_sensor)?;
        check::positive("field_of_view", params.field_of_view)?;
        check::in_range("field_of_view", params.field_of_view, 0.0, TAU)?;
        check::positive("range_max", params.range_max)?;
        check::in_range("range_min", params.range_min, 0.0, params.range_max)?;
        check::non_negative("relative_sigma", params.relative_sigma)?;
        check::non_negative("bearing_sigma", params.bearing_sigma)?;
        check::in_range("missed", params.missed, 0.0, 1.0)?;
        check::all_finite("landmark", landmarks.iter().flat_map(|l| l.position.iter()))?;
        let seed = own_seed(seed, Part::FrontCamera, params.sensor);
        let seen = Vec::with_capacity(landmarks.len());
        Ok(Self { params, landmarks, seed, step: 0, seen })
    }

    /// All landmarks.
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// What the camera is like.
    pub const fn params(&self) -> &FrontCameraParams {
        &self.params
    }

    /// What was seen last.
    pub fn last(&self) -> &[LandmarkObservation] {
        &self.seen
    }

    /// What is seen at `stamp` from `map_from_base` in this world, in the order of the landmarks. A landmark on the
    /// surface of an obstacle is not hidden by it. O(landmarks) rays at most; no allocation.
    ///
    /// # Errors
    /// A pose that is not finite; the camera is then as it was.
    pub fn look<W: PlanarWorld + ?Sized>(
        &mut self,
        world: &W,
        map_from_base: &Se2,
        stamp: Stamp,
    ) -> Result<&[LandmarkObservation], Error> {
        finite_pose("map_from_base", map_from_base)?;
        let params = self.params;
        let map_from_sensor = *map_from_base * params.base_from_sensor;
        let (eye, sensor_from_map) = (map_from_sensor.translation(), map_from_sensor.inverse());
        self.seen.clear();
        for (index, landmark) in self.landmarks.iter().enumerate() {
            let place: Vector2<f64> = sensor_from_map * landmark.position;
            let (range, bearing) = (place.norm(), place.y.atan2(place.x));
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
            let range = range * (1.0 + normal(params.relative_sigma, &mut stream));
            let measured = Vector2::new(range.max(0.0), bearing + normal(params.bearing_sigma, &mut stream));
            if !missed {
                // A camera knows the range that it measured, not the true one.
                let sigmas = Vector2::new(params.relative_sigma * measured.x, params.bearing_sigma);
                let reading = UncertainVector::from_sigmas(measured, &sigmas)?;
                let landmark = LandmarkObservation::new(stamp, Some(landmark.id), reading)?;
                self.seen.push(landmark.with_sensor(params.sensor).with_mount(params.base_from_sensor)?);
            }
        }
        self.step += 1;
        Ok(&self.seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Shape, World2d};

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
        let seen: Vec<u32> = camera
            .look(&pillar, &Se2::default(), Stamp::default())
            .unwrap()
            .iter()
            .filter_map(LandmarkObservation::id)
            .collect();
        assert_eq!(seen, [1, 2]);
        let sighting = camera.look(&pillar, &Se2::new(1.0, 0.0, 0.3), Stamp::default()).unwrap()[1];
        assert!(
            (sighting.range() - 20_f64.sqrt()).abs() < 1e-12
                && (sighting.bearing() - (0.5_f64.atan() - 0.3)).abs() < 1e-12
        );
    }

    #[test]
    fn landmark_noise_has_the_stated_size() {
        let mut camera = front(&[(4.0, 0.0)], FrontCameraParams { missed: 0.0, ..Default::default() });
        let open = World2d::new(vec![]).unwrap();
        let mut squares = 0.0;
        for _ in 0..5000 {
            let sighting = camera.look(&open, &Se2::default(), Stamp::default()).unwrap()[0];
            squares += ((sighting.range() - 4.0) / 0.08).powi(2) + (sighting.bearing() / 0.5_f64.to_radians()).powi(2);
        }
        assert!((squares - 10_000.0).abs() < 4.5 * 20_000_f64.sqrt(), "{squares}");
    }

    #[test]
    fn bad_cameras_and_poses_are_refused() {
        let nan = Se2::new(f64::NAN, 0.0, 0.0);
        let ahead = FrontCameraParams::default();
        for bad in [
            FrontCameraParams { base_from_sensor: nan, ..ahead },
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
        assert!(front(&[], ahead).look(&World2d::new(vec![]).unwrap(), &nan, Stamp::default()).is_err());
    }
}
