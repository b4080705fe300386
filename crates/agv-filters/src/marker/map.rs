//! Where the markers are: a map of codes by their numbers, stated by a plan or surveyed by a vehicle.
//!
//! A code that is seen from a known pose is entered at `map_from_base ∘ base_from_marker`; seen again, the two are fused by
//! their information. That is mapping with known poses: the errors of the vehicle's poses must be independent between the
//! sightings that are entered. Enter one sighting per pass, or the covariance shrinks by counting one error many times.

use super::fuse_poses;
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose, UncertainVector},
    sensors::MarkerObservation,
};
use nalgebra::Matrix2;
use std::collections::BTreeMap;

/// Poses of markers in the map, by their numbers.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_filters::marker::MarkerMap;
///
/// let map = MarkerMap::from_exact((0..10).map(|i| (i, Se2::new(f64::from(i), 0.0, 0.0))))?;
/// assert_eq!(map.get(7).expect("a marker").mean().x(), 7.0);
/// assert_eq!(map.get(10), None);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct MarkerMap {
    markers: BTreeMap<u32, UncertainPose<Se2>>,
}

/// What became of a sighting that was to be entered in a [`MarkerMap`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum SurveyOutcome {
    /// The marker was new.
    Added,
    /// It was known, and is known better now.
    Fused {
        /// Squared distance of the sighting from what was known, by the covariances.
        nis: f64,
    },
    /// It was known to be elsewhere, beyond the gate; the map is as it was.
    Contradicted {
        /// Squared distance of the sighting from what was known, by the covariances.
        nis: f64,
    },
}

impl MarkerMap {
    /// An empty map.
    pub const fn new() -> Self {
        Self { markers: BTreeMap::new() }
    }

    /// Markers whose poses are known, as from a plan; the last of several with one number counts.
    pub fn from_poses(markers: impl IntoIterator<Item = (u32, UncertainPose<Se2>)>) -> Self {
        Self { markers: markers.into_iter().collect() }
    }

    /// Markers whose poses are known exactly.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn from_exact(markers: impl IntoIterator<Item = (u32, Se2)>) -> Result<Self, Error> {
        let exact = |(id, pose): (u32, Se2)| {
            check::all_finite("map_from_marker", &[pose.x(), pose.y(), pose.yaw()])?;
            Ok((id, UncertainPose::exact(pose)))
        };
        Ok(Self { markers: markers.into_iter().map(exact).collect::<Result<_, Error>>()? })
    }

    /// The pose of the marker of this number. O(log n).
    pub fn get(&self, id: u32) -> Option<&UncertainPose<Se2>> {
        self.markers.get(&id)
    }

    /// The place of the marker of this number, as a landmark: its covariance in map axes.
    pub fn position(&self, id: u32) -> Option<UncertainVector<2>> {
        let marker = self.get(id)?;
        let (cos, sin) = (marker.mean().rotation().cos(), marker.mean().rotation().sin());
        let turn = Matrix2::new(cos, -sin, sin, cos);
        let spread = turn * marker.covariance().fixed_view::<2, 2>(0, 0) * turn.transpose();
        UncertainVector::new(marker.mean().translation(), (spread + spread.transpose()) * 0.5).ok()
    }

    /// All markers, by increasing number.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &UncertainPose<Se2>)> {
        self.markers.iter().map(|(&id, pose)| (id, pose))
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.markers.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.markers.is_empty()
    }

    /// Sets the pose of a marker, whatever was known, which is returned.
    pub fn insert(&mut self, id: u32, map_from_marker: UncertainPose<Se2>) -> Option<UncertainPose<Se2>> {
        self.markers.insert(id, map_from_marker)
    }

    /// Forgets a marker: one that was taken away.
    pub fn remove(&mut self, id: u32) -> Option<UncertainPose<Se2>> {
        self.markers.remove(&id)
    }

    /// Enters a marker that was seen from a pose with independent error, unless it lies beyond the `gate` (a squared distance by
    /// the covariances, 21.1 lets pass all but one of ten thousand good ones) from where it is known to be.
    ///
    /// # Errors
    /// A gate that is not positive; [`Error::Singular`] if the sighting and what is known are both exact. The map is then as
    /// it was.
    pub fn survey(
        &mut self,
        map_from_base: &UncertainPose<Se2>,
        sighting: &MarkerObservation<Se2>,
        gate: f64,
    ) -> Result<SurveyOutcome, Error> {
        check::in_range("gate", gate, f64::MIN_POSITIVE, f64::INFINITY)?;
        let seen = map_from_base.compose(&sighting.base_from_marker());
        let Some(known) = self.markers.get_mut(&sighting.id()) else {
            self.markers.insert(sighting.id(), seen);
            return Ok(SurveyOutcome::Added);
        };
        let fused = fuse_poses(known, &seen)?;
        if fused.nis > gate {
            return Ok(SurveyOutcome::Contradicted { nis: fused.nis });
        }
        *known = fused.pose;
        Ok(SurveyOutcome::Fused { nis: fused.nis })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{compute::Seed, geometry::LieGroup, time::Stamp};
    use nalgebra::{Matrix3, Vector3};
    use rand_distr::{Distribution, StandardNormal};

    fn drawn(mean: &Se2, sigmas: &Vector3<f64>, stream: &mut agv_core::compute::Stream) -> UncertainPose<Se2> {
        let error = sigmas.map(|sigma| {
            let z: f64 = StandardNormal.sample(stream);
            sigma * z
        });
        UncertainPose::new(mean.plus(&error), Matrix3::from_diagonal(&sigmas.component_mul(sigmas))).unwrap()
    }

    /// Ten passes over a code from poses with independent errors, 300 codes: NEES chi-square(3) within 4.5 deviations.
    #[test]
    fn surveyed_codes_are_as_sure_as_they_say() {
        let (mut stream, codes, mut nees) = (Seed(4).stream(0, 0), 300_u32, 0.0);
        let mut map = MarkerMap::new();
        let truth = |id: u32| Se2::new(f64::from(id), -1.0, 0.1 * f64::from(id));
        for id in 0..codes {
            for pass in 0..10 {
                let base = truth(id) * Se2::new(0.05, -0.03, f64::from(pass)).inverse();
                let known = drawn(&base, &Vector3::new(0.02, 0.03, 0.01), &mut stream);
                let seen = drawn(&base.between(&truth(id)), &Vector3::new(0.005, 0.005, 0.008), &mut stream);
                let outcome = map.survey(&known, &MarkerObservation::new(Stamp::default(), id, seen), 21.1).unwrap();
                assert_eq!(outcome == SurveyOutcome::Added, pass == 0);
            }
            let found = map.get(id).unwrap();
            assert!(found.position_deviation() < 0.036 / 3.0, "a third of a single sighting's");
            let error = found.mean().minus(&truth(id));
            nees += error.dot(&(Se2::inverse_of(found.covariance()).unwrap() * error));
        }
        assert_eq!(map.len(), codes as usize);
        assert!((nees - 900.0).abs() < 4.5 * 1800_f64.sqrt(), "{nees}");
    }

    #[test]
    fn a_code_that_was_moved_is_not_averaged() {
        let spread = Matrix3::identity() * 1e-4;
        let base = UncertainPose::new(Se2::default(), spread).unwrap();
        let seen =
            |x| MarkerObservation::new(Stamp::default(), 3, UncertainPose::new(Se2::new(x, 0.0, 0.0), spread).unwrap());
        let mut map = MarkerMap::new();
        map.survey(&base, &seen(0.1), 21.1).unwrap();
        let before = map.clone();
        assert!(matches!(map.survey(&base, &seen(0.5), 21.1), Ok(SurveyOutcome::Contradicted { nis }) if nis > 21.1));
        assert_eq!(map, before);
        assert_eq!(map.remove(3), before.get(3).copied());
        assert_eq!(map.survey(&base, &seen(0.5), 21.1), Ok(SurveyOutcome::Added));
        for gate in [0.0, -1.0, f64::NAN] {
            assert!(map.survey(&base, &seen(0.5), gate).is_err());
        }
        assert!(MarkerMap::from_exact([(0, Se2::new(f64::NAN, 0.0, 0.0))]).is_err());
    }

    #[test]
    fn places_are_told_in_map_axes() {
        let spread = Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 1.0));
        let turned = UncertainPose::new(Se2::new(1.0, 2.0, std::f64::consts::FRAC_PI_2), spread).unwrap();
        let place = MarkerMap::from_poses([(5, turned)]).position(5).unwrap();
        assert!((place.covariance() - Matrix2::new(1.0, 0.0, 0.0, 4.0)).norm() < 1e-12);
        assert_eq!(*place.mean(), turned.mean().translation());
    }
}
