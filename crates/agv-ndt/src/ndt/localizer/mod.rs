//! Where is the vehicle in a 3D map: odometry predicts, and the normal distributions transform corrects.
//!
//! ```text
//! motions --> predict: belief, track of the last second
//! cloud ----> deskew along the track, into the base frame, thin out
//!               |-- belief narrow along what is observed: NDT from the predicted pose, unobserved directions held to it
//!               |-- wide: NDT from many starts, the best one of those that the belief allows, if no other comes up to it
//!               |     v
//!               |   information of the match, tempered --> fusion with the prediction
//!               |-- anywhere, contradicted: NDT from many starts, the best one if no other comes up to it, whatever was believed
//! ```
//!
//! The covariance of a match is not the inverse Hessian: neighbouring points share the errors of the cells that they meet, so only a
//! share of them counts, and no match is better than a floor. Along directions that the cloud does not fix, as along a corridor, the
//! match has no information: the estimate follows the odometry there, and its variance grows.
//!
//! That has a limit. Each cloud knows those directions to a milliradian or so, and what it says across them to 1.5 mm at best
//! (the default [`floor`](NdtLocalizerParams::floor)): a deviation along them beyond the ratio of the two, 1.5 m then, is seen, wrongly, in what is
//! across. Clouds that follow each other take a standard deviation of metres for smaller than it is. Read one of more than a metre as
//! "not known".

#[cfg(feature = "serde")]
mod checkpoint;
mod correct;
mod fusion;
mod matching;
mod params;
mod places;
mod search;
mod state;

pub use params::{DriftParams, NdtLocalizerParams, SearchParams};

use super::map::NdtMap;
use super::registration::NdtRegistration;
use crate::Error;
use crate::checks::finite_pose;
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3, UncertainPose},
    odometry::MotionIncrement,
    roles::{Alignment, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, StatusMonitor},
    sensors::{PointCloud, VoxelGrid},
};
use nalgebra::{Matrix6, Vector6};
use search::Search;
use state::State;

/// Localises a vehicle in space, in a map of normal distributions.
///
/// Clouds are deskewed along the motions of the last second, from wherever their stamps lie in them; predict up to the end of a sweep
/// before it is handed over. A cloud before the first motion is taken to be one of a vehicle at rest, and so
/// is one that is hardly older or newer than the step after which a clock that was set back went on.
///
/// A belief of [`PoseBelief::Anywhere`], one that is wide along what the cloud observes, or one that the clouds contradict is looked
/// for from many starts: at level poses on the map's floor, or at [places of one's own](Self::with_places), as those of the drive that
/// made the map. A place that another looks like is not decided on; drive on, and the next cloud may tell. A belief that is only wide
/// is corrected by what is found, within its gate; the other two are replaced.
///
/// An update allocates nothing once the buffers have met clouds of that size, a search aside; all is linear in the points of the
/// cloud. The estimate has the same bits for any number of threads.
///
/// ```
/// use agv_core::{geometry::{Se2, Se3}, nalgebra::{Matrix6, Vector3}, odometry::MotionIncrement, time::Stamp};
/// use agv_core::{roles::*, sensors::PointCloud};
/// use agv_ndt::ndt::{NdtLocalizer, NdtLocalizerParams, NdtMap};
///
/// // Floor and walls of a corner, mapped from its origin.
/// let sheet = |i: i32, a: f32, b: f32| [Vector3::new(a, b, 0.0), Vector3::new(a, -1.0, b), Vector3::new(8.0, a, b)][i as usize];
/// let points = |n: i32| (0..3 * n * n).map(move |i| sheet(i % 3, (i / 3 % n) as f32 * 8.0 / n as f32, (i / 3 / n) as f32 * 8.0 / n as f32));
/// let params = NdtLocalizerParams::default();
/// let mut map = NdtMap::new(params.ndt.voxels)?;
/// map.insert(&PointCloud::from_points(points(80)), &Se3::default());
///
/// // Half a metre on, by an odometry that is 5 cm off.
/// let mut localizer = NdtLocalizer::new(&map, params)?;
/// localizer.initialize(&PoseBelief::around(Se3::default(), Matrix6::identity() * 1e-4)?)?;
/// let start = Stamp::default();
/// let motion = MotionIncrement::between(start, &Se3::default(), start + 0.5, &Se2::new(0.55, 0.0, 0.0).into())?;
/// localizer.predict(&motion)?;
/// let seen = PointCloud::from_points(points(40).map(|p| p - Vector3::new(0.5, 0.0, 0.0))).with_stamp(start + 0.5);
/// assert!(matches!(localizer.update(&seen)?, UpdateOutcome::Applied(_)));
/// let x = localizer.estimate().ok_or("initialised above")?.map_from_base().translation().x;
/// assert!((x - 0.5).abs() < 0.02, "{x}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "checkpoint::RawLocalizer", into = "checkpoint::RawLocalizer")
)]
pub struct NdtLocalizer {
    params: NdtLocalizerParams,
    ndt: NdtRegistration,
    places: Vec<Se3>,
    state: Option<State>,
    monitor: StatusMonitor,
    alignment: Option<Alignment<Se3>>,
    thin: VoxelGrid,
    search: Search,
    /// The cloud deskewed, and what is left of it in the base frame.
    straight: PointCloud,
    thinned: PointCloud,
    /// Whether the cloud is of the last update, and not in the map yet.
    is_fresh: bool,
}

impl NdtLocalizer {
    /// A localizer in this map.
    ///
    /// # Errors
    /// The first parameter that is out of its range, [`Error::MapMismatch`] if the map has other voxels, or a map without a voxel of
    /// enough points.
    pub fn new(map: &NdtMap, params: NdtLocalizerParams) -> Result<Self, Error> {
        params.validate()?;
        let mut ndt = NdtRegistration::new(params.ndt)?;
        ndt.set_map(map)?;
        Ok(Self {
            ndt,
            places: params.search.map_or_else(Vec::new, |search| places::places(map, search.spacing)),
            state: None,
            monitor: StatusMonitor::new(params.status)?,
            alignment: None,
            thin: VoxelGrid::new(params.leaf)?,
            search: Search::default(),
            straight: PointCloud::default(),
            thinned: PointCloud::default(),
            is_fresh: false,
            params,
        })
    }

    /// The same, with its loops spread over threads.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.ndt = self.ndt.with_parallelism(par);
        self
    }

    /// The same, looking for a vehicle that may be anywhere from these places and no others; their headings do not matter.
    ///
    /// # Errors
    /// A place that is not finite, or none at all.
    pub fn with_places(mut self, places: impl IntoIterator<Item = Se3>) -> Result<Self, Error> {
        let places: Vec<_> = places.into_iter().collect();
        check::at_least("places", places.len(), 1)?;
        for place in &places {
            finite_pose("place", place)?;
        }
        self.places = places;
        Ok(self)
    }

    /// Replaces the map by one of the same voxels, as a vehicle that maps while it drives does; belief and places stay.
    ///
    /// # Errors
    /// As [`new`](Self::new); the last map is then still there.
    pub fn set_map(&mut self, map: &NdtMap) -> Result<(), Error> {
        self.ndt.set_map(map)
    }

    /// Adds the last cloud to the map as [`straightened`](Self::straightened) has it, taken from `map_from_base`, and says how many
    /// points that are; belief and places stay. Linear in the points of the cloud, however large the map is.
    ///
    /// None after an update that did not take its cloud, as a duplicate or one from outside the history, nor a second time; nor from a
    /// localizer that was stored and loaded, before its first update: add the last cloud before it is stored.
    ///
    /// # Errors
    /// A pose that is not finite; the map is then as it was.
    pub fn insert_straightened(&mut self, map_from_base: &Se3) -> Result<usize, Error> {
        let map_from_sensor = map_from_base.compose(&self.straight.base_from_sensor());
        if !self.is_fresh {
            finite_pose("map_from_base", map_from_base)?;
            return Ok(0);
        }
        let inserted = self.ndt.insert(&self.straight, &map_from_sensor)?;
        self.is_fresh = false;
        Ok(inserted)
    }

    /// The map, with all else given up.
    #[must_use]
    pub fn into_map(self) -> NdtMap {
        self.ndt.into_map()
    }

    /// The map.
    pub const fn map(&self) -> &NdtMap {
        self.ndt.map()
    }

    /// The parameters.
    pub const fn params(&self) -> &NdtLocalizerParams {
        &self.params
    }

    /// Where a vehicle that may be anywhere is looked for.
    pub fn places(&self) -> &[Se3] {
        &self.places
    }

    /// How the last cloud with enough points met the map, applied or not: its unobserved directions are those that were held to the
    /// prediction, or to the start that led there if it was looked for from many. None before the first, and after a search without a
    /// verdict.
    pub const fn alignment(&self) -> Option<&Alignment<Se3>> {
        self.alignment.as_ref()
    }

    /// The last cloud that was within the history, deskewed: as if taken at once when the last motion ended, in the sensor frame of
    /// then. For mapping with it, or looking for obstacles.
    pub const fn straightened(&self) -> &PointCloud {
        &self.straight
    }
}

impl Localizer for NdtLocalizer {
    type Pose = Se3;

    /// Replaces the belief; one in [`PoseBelief::Anywhere`] needs a map that shows its floor, or places, and a search.
    fn initialize(&mut self, belief: &PoseBelief<Se3>) -> Result<(), LocalizationError> {
        let (pose, anywhere) = if let PoseBelief::Around(pose) = belief {
            (*pose, false)
        } else {
            check::at_least("search", usize::from(self.params.search.is_some()), 1)?;
            (places::spread_over(&self.places)?, true)
        };
        self.monitor.initialized(&pose);
        self.alignment = None;
        let belief = PoseEstimate::new(pose);
        self.state = Some(State { belief, anywhere, misses: 0, track: Vec::new(), applied: Vec::new() });
        Ok(())
    }

    fn predict(&mut self, odometry: &MotionIncrement<Se3>) -> Result<(), LocalizationError> {
        let state = self.state.as_mut().ok_or(LocalizationError::NotInitialized)?;
        let drift = &self.params.drift;
        let motion = odometry.start_from_end;
        let (driven, turned) = (motion.translation().norm(), motion.rotation().log().norm());
        let rest = drift.resting.powi(2) * odometry.dt().max(0.0);
        let position = drift.position.powi(2) * driven + rest;
        let attitude = drift.attitude.powi(2) * driven + drift.turning.powi(2) * turned + rest;
        let noise = Vector6::new(position, position, position, attitude, attitude, attitude);
        let step = UncertainPose::new(motion, odometry.covariance + Matrix6::from_diagonal(&noise))?;
        let belief = PoseEstimate { pose: state.belief.pose.compose(&step), stamp: Some(odometry.end) };
        UncertainPose::new(*belief.map_from_base(), *belief.covariance())?;
        state.remember(odometry, self.params.history);
        state.belief = belief;
        self.monitor.moved(&state.belief.pose);
        Ok(())
    }

    fn estimate(&self) -> Option<PoseEstimate<Se3>> {
        self.state.as_ref().map(|state| state.belief)
    }

    fn status(&self) -> LocalizationStatus {
        self.monitor.status()
    }
}

#[cfg(test)]
mod tests;
