//! Where the vehicle is, from the codes that one image shows.
//!
//! Each code whose place is known says a pose, `map_from_marker ∘ (base_from_marker)⁻¹`. Those that agree (a squared distance
//! within the gate) are fused by their information; one that contradicts the majority, a code that was moved or misread, is
//! left out. Without a majority there is no pose.

use super::{FusedPose, MarkerMap, fuse_poses, pose_distance};
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose},
    sensors::{MarkerObservation, PoseObservation},
};

/// Most markers of one image that are looked at; those beyond are left out.
const MOST: usize = 32;

/// Parameters of a [`MarkerLocalizer`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MarkerLocalizerParams {
    /// Squared distance by the covariances up to which two codes agree on the pose.
    pub gate: f64,
}

impl Default for MarkerLocalizerParams {
    /// All but one in ten thousand pairs of sound codes agree (chi-square of three degrees of freedom).
    fn default() -> Self {
        Self { gate: 21.1 }
    }
}

/// What the markers of an image say of the vehicle's pose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum MarkerFix {
    /// A pose.
    Located {
        /// The pose, by a sensor at the vehicle's origin, with the stamp and the sensor of the image.
        observation: PoseObservation<Se2>,
        /// How many codes it is made of.
        used: usize,
        /// How many codes contradict it.
        rejected: usize,
    },
    /// None of the markers is in the map.
    Unknown,
    /// The codes contradict each other, and no majority agrees.
    Contradictory,
}

impl MarkerFix {
    /// The pose, if there is one.
    pub const fn observation(&self) -> Option<&PoseObservation<Se2>> {
        match self {
            Self::Located { observation, .. } => Some(observation),
            _ => None,
        }
    }
}

/// Turns sightings of codes into a pose of the vehicle, which a Kalman filter takes as it is.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, UncertainPose};
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::sensors::MarkerObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::marker::{MarkerLocalizer, MarkerLocalizerParams, MarkerMap};
///
/// let map = MarkerMap::from_exact([(1, Se2::new(5.0, 0.0, 0.0)), (2, Se2::new(5.0, 0.2, 0.0))])?;
/// let localizer = MarkerLocalizer::new(map, MarkerLocalizerParams::default())?;
/// let see = |id, y| {
///     let pose = UncertainPose::new(Se2::new(0.1, y, 0.0), Matrix3::identity() * 1e-5)?;
///     Ok::<_, agv_core::Error>(MarkerObservation::new(Stamp::default(), id, pose))
/// };
/// let fix = localizer.locate(&[see(1, 0.0)?, see(2, 0.2)?, see(99, 0.4)?])?;
/// let observation = fix.observation().expect("two codes are in the map");
/// assert!(observation.map_from_base().mean().minus(&Se2::new(4.9, 0.0, 0.0)).norm() < 1e-9);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawLocalizer"))]
pub struct MarkerLocalizer {
    map: MarkerMap,
    params: MarkerLocalizerParams,
}

/// A localizer as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawLocalizer {
    map: MarkerMap,
    params: MarkerLocalizerParams,
}

#[cfg(feature = "serde")]
impl TryFrom<RawLocalizer> for MarkerLocalizer {
    type Error = Error;

    fn try_from(RawLocalizer { map, params }: RawLocalizer) -> Result<Self, Error> {
        Self::new(map, params)
    }
}

impl MarkerLocalizer {
    /// A localizer in a map of markers.
    ///
    /// # Errors
    /// A gate that is not positive.
    pub fn new(map: MarkerMap, params: MarkerLocalizerParams) -> Result<Self, Error> {
        check::in_range("gate", params.gate, f64::MIN_POSITIVE, f64::INFINITY)?;
        Ok(Self { map, params })
    }

    /// The map.
    pub const fn map(&self) -> &MarkerMap {
        &self.map
    }

    /// The map, to survey markers on the way.
    pub const fn map_mut(&mut self) -> &mut MarkerMap {
        &mut self.map
    }

    /// The pose that the markers of one image say together. O(markers) if they agree, O(markers²) if not; no allocation.
    ///
    /// # Errors
    /// [`Error::Singular`] if two exact sightings of exact markers are to be compared.
    pub fn locate(&self, markers: &[MarkerObservation<Se2>]) -> Result<MarkerFix, Error> {
        let mut poses = [UncertainPose::exact(Se2::default()); MOST];
        let known = markers.iter().filter_map(|marker| Some(marker.map_from_base(self.map.get(marker.id())?)));
        let count = poses.iter_mut().zip(known).map(|(slot, pose)| *slot = pose).count();
        let (poses, Some(first)) = (&poses[..count], markers.first()) else { return Ok(MarkerFix::Unknown) };
        let Some(mut best) = poses.first().map(|pose| (1, *pose)) else { return Ok(MarkerFix::Unknown) };
        for seed in poses.iter().filter(|_| count > 1) {
            let supported = self.with_support(seed, poses)?;
            if supported.0 > best.0 {
                best = supported;
            }
            if best.0 == count {
                break; // all agree
            }
        }
        let (used, pose) = best;
        if 2 * used <= count && count > 1 {
            return Ok(MarkerFix::Contradictory);
        }
        let observation = PoseObservation::new(first.stamp(), pose).with_sensor(first.sensor());
        Ok(MarkerFix::Located { observation, used, rejected: count - used })
    }

    /// Which marker an unread one is, as seen by a vehicle whose pose is believed to be about there: the only one of the map
    /// within the gate. None if there is none, or if the belief is too wide to tell several apart. O(map), no allocation.
    ///
    /// ```
    /// use agv_core::geometry::{Se2, UncertainPose};
    /// use agv_core::nalgebra::Matrix3;
    /// use agv_filters::marker::{MarkerLocalizer, MarkerLocalizerParams, MarkerMap};
    ///
    /// let map = MarkerMap::from_exact([(1, Se2::new(5.0, 0.0, 0.0)), (2, Se2::new(6.0, 0.0, 0.0))])?;
    /// let localizer = MarkerLocalizer::new(map, MarkerLocalizerParams::default())?;
    /// let belief = |sigma: f64| UncertainPose::new(Se2::new(5.03, 0.1, 0.02), Matrix3::identity() * (sigma * sigma));
    /// let seen = UncertainPose::new(Se2::new(0.0, -0.1, 0.0), Matrix3::identity() * 1e-6)?;
    /// assert_eq!(localizer.associate(&belief(0.05)?, &seen), Some(1));
    /// assert_eq!(localizer.associate(&belief(0.5)?, &seen), None);
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn associate(&self, map_from_base: &UncertainPose<Se2>, base_from_marker: &UncertainPose<Se2>) -> Option<u32> {
        let expected = map_from_base.compose(base_from_marker);
        let is_near =
            |pose: &UncertainPose<Se2>| pose_distance(&expected, pose).is_ok_and(|nis| nis <= self.params.gate);
        let mut near = self.map.iter().filter(|(_, pose)| is_near(pose)).map(|(id, _)| id);
        near.next().filter(|_| near.next().is_none())
    }

    /// The poses that agree with one, itself among them, fused; and how many they are.
    fn with_support(
        &self,
        seed: &UncertainPose<Se2>,
        poses: &[UncertainPose<Se2>],
    ) -> Result<(usize, UncertainPose<Se2>), Error> {
        let mut fused = None::<(usize, UncertainPose<Se2>)>;
        for pose in poses {
            if std::ptr::eq(pose, seed) || pose_distance(seed, pose)? <= self.params.gate {
                fused = Some(match fused {
                    None => (1, *pose),
                    Some((used, sum)) => {
                        let FusedPose { pose, .. } = fuse_poses(&sum, pose)?;
                        (used + 1, pose)
                    }
                });
            }
        }
        Ok(fused.unwrap_or((1, *seed)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{compute::Seed, geometry::LieGroup, sensors::SensorId, time::Stamp};
    use nalgebra::{Matrix3, Vector3};
    use rand_distr::{Distribution, StandardNormal};

    const SIGMAS: Vector3<f64> = Vector3::new(0.005, 0.005, 0.01);

    fn localizer() -> MarkerLocalizer {
        let spread = Matrix3::identity() * 1e-6;
        let marker =
            |id: u32| (id, UncertainPose::new(Se2::new(0.2 * f64::from(id), 1.0, f64::from(id)), spread).unwrap());
        MarkerLocalizer::new(MarkerMap::from_poses((0..6).map(marker)), MarkerLocalizerParams::default()).unwrap()
    }

    fn see(id: u32, base_from_marker: Se2) -> MarkerObservation<Se2> {
        let spread = Matrix3::from_diagonal(&SIGMAS.component_mul(&SIGMAS));
        MarkerObservation::new(Stamp::from_seconds(3.0), id, UncertainPose::new(base_from_marker, spread).unwrap())
            .with_sensor(SensorId(4))
    }

    /// NEES over 2000 images of one to six codes in a map that errs, chi-square(3) within 4.5 deviations.
    #[test]
    fn the_pose_is_as_sure_as_it_says() {
        let (localizer, mut stream, images) = (localizer(), Seed(9).stream(0, 0), 2000_u32);
        let mut draw = |sigmas: &Vector3<f64>| {
            sigmas.map(|sigma| {
                let z: f64 = StandardNormal.sample(&mut stream);
                sigma * z
            })
        };
        let (truth, mut nees) = (Se2::new(0.4, 0.7, -2.0), 0.0);
        for image in 0..images {
            let seen: Vec<_> = (0..=image % 6)
                .map(|id| {
                    let lies = localizer.map().get(id).unwrap().mean().plus(&draw(&Vector3::repeat(1e-3)));
                    see(id, truth.between(&lies).plus(&draw(&SIGMAS)))
                })
                .collect();
            let fix = localizer.locate(&seen).unwrap();
            let MarkerFix::Located { observation, used, rejected } = fix else { panic!("{fix:?}") };
            assert_eq!((used + rejected, observation.sensor()), (seen.len(), SensorId(4)));
            let pose = observation.map_from_base();
            let error = pose.mean().minus(&truth);
            nees += error.dot(&(Se2::inverse_of(pose.covariance()).unwrap() * error));
        }
        let n = 3.0 * f64::from(images);
        assert!((nees - n).abs() < 4.5 * (2.0 * n).sqrt(), "{nees} {n}");
    }

    #[test]
    fn a_code_that_was_moved_is_outvoted() {
        let (localizer, truth) = (localizer(), Se2::new(0.4, 0.7, -2.0));
        let place = |id| truth.between(localizer.map().get(id).unwrap().mean());
        let moved = see(0, place(0) * Se2::new(0.1, 0.0, 0.0));
        let fix = localizer.locate(&[moved, see(1, place(1)), see(2, place(2))]).unwrap();
        let MarkerFix::Located { observation, used: 2, rejected: 1 } = fix else { panic!("{fix:?}") };
        assert!(observation.map_from_base().mean().minus(&truth).norm() < 1e-3);
        assert_eq!(observation.stamp(), Stamp::from_seconds(3.0));
        assert_eq!(localizer.locate(&[moved, see(1, place(1))]), Ok(MarkerFix::Contradictory));
        assert!(matches!(
            localizer.locate(&[see(1, place(1)), see(77, place(2))]),
            Ok(MarkerFix::Located { used: 1, .. })
        ));
    }

    #[test]
    fn what_is_not_in_the_map_says_nothing() {
        let localizer = localizer();
        assert_eq!(localizer.locate(&[]), Ok(MarkerFix::Unknown));
        assert_eq!(localizer.locate(&[see(77, Se2::default())]), Ok(MarkerFix::Unknown));
        let exact = MarkerMap::from_exact([(0, Se2::default())]).unwrap();
        let localizer = MarkerLocalizer::new(exact, MarkerLocalizerParams::default()).unwrap();
        let seen = MarkerObservation::new(Stamp::default(), 0, UncertainPose::exact(Se2::default()));
        assert!(localizer.locate(&[seen]).is_ok());
        assert!(localizer.locate(&[seen, seen]).is_err());
        for gate in [0.0, f64::NAN, -1.0] {
            assert!(MarkerLocalizer::new(MarkerMap::new(), MarkerLocalizerParams { gate }).is_err());
        }
    }
}
