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
//! match has no information: the estimate follows the odometry there, and its variance grows. Those directions are known to a milliradian
//! or so: a variance of metres along them is taken for smaller than it is after some clouds.

#[cfg(feature = "serde")]
mod checkpoint;
mod fusion;
mod params;
mod places;
mod search;

pub use params::{DriftParams, NdtLocalizerParams, SearchParams};

use super::map::NdtMap;
use super::registration::NdtRegistration;
use crate::Error;
use agv_core::{
    check,
    compute::Par,
    geometry::{LieGroup, Se3, UncertainPose},
    odometry::MotionIncrement,
    roles::{
        Alignment, AlignmentError, Correct, Doubt, LocalizationError, LocalizationStatus, Localizer, PoseBelief,
        PoseEstimate, Registration, SkipReason, StatusMonitor, UpdateOutcome, UpdateReport,
    },
    sensors::{Deskew, PointCloud, PoseTrack, SensorId, VoxelGrid},
    time::Stamp,
};
use fusion::{fuse, tempered};
use nalgebra::{Matrix6, Vector6};
use search::Search;

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
}

/// What an initialised localizer knows.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct State {
    belief: PoseEstimate<Se3>,
    /// Whether the vehicle may be anywhere in the map.
    anywhere: bool,
    /// Clouds in a row that did not fit.
    misses: u32,
    /// Poses in the odometry's frame at the ends of the last motions.
    track: Vec<(Stamp, Se3)>,
    /// The last cloud that each sensor had applied.
    applied: Vec<(SensorId, Stamp)>,
}

/// Deviations of a belief beyond which it is looked for from many starts: in metres, and in radians.
const WIDE: (f64, f64) = (1.0, 0.35);

/// Standard deviations of a wide belief within which it is looked for.
const WIDTHS: f64 = 3.0;

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
            check::all_finite("place", place.translation().iter())?;
            check::all_finite("place", place.rotation().matrix().iter())?;
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

    /// Deskews a cloud to the time of the belief, thins it out and brings it into the base frame; or says why not.
    fn take(&mut self, state: &State, cloud: &PointCloud) -> Result<(), SkipReason> {
        let (at, track) = (state.belief.stamp, &state.track);
        let moving = track.first().zip(at).filter(|_| track.len() > 1);
        if let Some((first, now)) = moving {
            let (age, slack) = (now - cloud.stamp(), self.params.extrapolation);
            if age > (now - first.0) + slack || age < -slack {
                return Err(SkipReason::OutsideHistory { age });
            }
            // A track of increasing times and finite poses is one.
            if let Ok(motion) = PoseTrack::new(track, now) {
                Deskew::cloud_into(cloud, &motion, &mut self.straight);
            }
        } else {
            // At rest, as far as is known; but a track of one pose says so of its own time alone.
            let age = at.filter(|_| !track.is_empty()).map_or(0.0, |now| now - cloud.stamp());
            if age.abs() > self.params.extrapolation {
                return Err(SkipReason::OutsideHistory { age });
            }
            self.straight.copy_from(cloud);
        }
        self.thin.filter_into(&self.straight, &mut self.thinned);
        let mount = self.thinned.base_from_sensor();
        self.thinned.transform(&mount);
        let (usable, needed) = (self.thinned.len(), self.params.min_points);
        if usable < needed { Err(SkipReason::TooFewReadings { usable, needed }) } else { Ok(()) }
    }

    /// What the thinned cloud makes of a belief; nothing is changed but the last alignment.
    fn match_cloud(&mut self, state: &State) -> Result<Match, LocalizationError> {
        // A belief that was never confirmed has nothing to lose: there the clouds count.
        let patience = u32::try_from(self.params.status.confirmations).unwrap_or(u32::MAX).max(1);
        let is_lost = matches!(self.monitor.status(), LocalizationStatus::Lost { doubt: Doubt::Unexplained { .. } });
        let contradicted = is_lost || state.misses >= patience;
        let Some(search) = self.params.search else { return self.follow(&state.belief.pose) };
        if state.anywhere || contradicted {
            let reach = search.radius * f64::from(state.misses.saturating_sub(patience).min(20)).exp2();
            let reach = reach.max(WIDTHS * state.belief.pose.position_deviation());
            return self.find(&state.belief.pose, if state.anywhere { f64::INFINITY } else { reach }, &search);
        }
        let followed = self.follow(&state.belief.pose)?;
        let unobserved = self.alignment.map_or_else(Matrix6::zeros, |found| found.unobserved);
        let is_believed = matches!(followed, Match::Fused { nis, .. } if nis <= self.params.gate);
        let (prior, all) = (&state.belief.pose, Matrix6::zeros());
        if !is_wide(prior, &all) || (is_believed && !is_wide(prior, &unobserved)) {
            return Ok(followed);
        }
        self.narrow(&state.belief.pose, &search)
    }

    /// The match from the predicted pose.
    fn follow(&mut self, belief: &UncertainPose<Se3>) -> Result<Match, LocalizationError> {
        let found = self.ndt.align(&self.thinned, belief.mean()).map_err(|error| refused(&error))?;
        self.alignment = Some(found);
        if !found.converged() {
            return Ok(Match::Unexplained);
        }
        fused(&self.params, belief, &found)
    }

    /// The match among those that a wide belief allows.
    fn narrow(&mut self, belief: &UncertainPose<Se3>, search: &SearchParams) -> Result<Match, LocalizationError> {
        let (radius, params) = (WIDTHS * belief.position_deviation(), &self.params);
        let allowed = |found: &Alignment<Se3>| matches!(fused(params, belief, found), Ok(Match::Fused { nis, .. }) if nis <= params.gate);
        let (places, around) = (&self.places, belief.mean());
        self.search
            .run(&mut self.ndt, &self.thinned, places, (around, radius), search, allowed)
            .map_err(|e| refused(&e))?;
        // Two that differ along what they do not observe are one: the belief says where along it.
        self.alignment = self.search.verdict(search.lead, true);
        self.alignment.map_or(Ok(Match::Unexplained), |found| fused(&self.params, belief, &found))
    }

    /// The match among all within `radius` metres, whatever was believed.
    fn find(
        &mut self,
        belief: &UncertainPose<Se3>,
        radius: f64,
        search: &SearchParams,
    ) -> Result<Match, LocalizationError> {
        let (places, around) = (&self.places, belief.mean());
        self.search
            .run(&mut self.ndt, &self.thinned, places, (around, radius), search, |_| true)
            .map_err(|e| refused(&e))?;
        self.alignment = self.search.verdict(search.lead, false);
        let Some(found) = self.alignment else { return Ok(Match::Unexplained) };
        let tempered = tempered(&found.information, self.params.independent, self.params.floor);
        // Along what the cloud does not fix, any of the places tried may be meant.
        let to = |place: &Se3, from: &Se3| (place.translation() - from.translation()).norm();
        let tried = places.iter().filter(|place| to(place, around) <= radius);
        let farthest = tried.map(|place| to(place, &found.target_from_source)).fold(search.radius, f64::max);
        let unknown = Matrix6::identity() * farthest.powi(-2);
        let singular = agv_core::Error::Singular { name: "covariance", row: 0, pivot: 0.0 };
        let covariance = (tempered + unknown).try_inverse().ok_or(singular)?;
        let pose = UncertainPose::new(found.target_from_source, (covariance + covariance.transpose()) * 0.5)?;
        Ok(Match::Found { pose, share: found.inlier_ratio })
    }
}

/// A belief corrected by a match.
fn fused(
    params: &NdtLocalizerParams,
    belief: &UncertainPose<Se3>,
    found: &Alignment<Se3>,
) -> Result<Match, LocalizationError> {
    let information = tempered(&found.information, params.independent, params.floor);
    let fused = fuse(belief, &found.target_from_source, &information)?;
    Ok(Match::Fused { pose: fused.pose, nis: fused.nis, share: found.inlier_ratio })
}

/// Whether a belief is wide along other directions than those of the projector `unobserved`.
fn is_wide(belief: &UncertainPose<Se3>, unobserved: &Matrix6<f64>) -> bool {
    let observed = Matrix6::identity() - unobserved;
    let variances = (observed * belief.covariance() * observed).diagonal();
    variances.fixed_rows::<3>(0).sum() > WIDE.0.powi(2) || variances.fixed_rows::<3>(3).sum() > WIDE.1.powi(2)
}

/// What a cloud says of a belief.
enum Match {
    /// Nothing: it fits nowhere, or in several places.
    Unexplained,
    /// Where the vehicle is, whatever was believed.
    Found { pose: UncertainPose<Se3>, share: f64 },
    /// The belief, corrected.
    Fused { pose: UncertainPose<Se3>, nis: f64, share: f64 },
}

fn refused(error: &AlignmentError) -> LocalizationError {
    match error {
        AlignmentError::Invalid(error) => LocalizationError::Invalid(*error),
        // There is a target from the construction on.
        _ => LocalizationError::NotInitialized,
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
            (spread_over(&self.places)?, true)
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

impl Correct<PointCloud> for NdtLocalizer {
    /// The observation is compensated for the motion between its stamp and the end of the last motion.
    fn update(&mut self, cloud: &PointCloud) -> Result<UpdateOutcome, LocalizationError> {
        let mut state = self.state.take().ok_or(LocalizationError::NotInitialized)?;
        let outcome = self.correct(&mut state, cloud);
        self.state = Some(state);
        outcome
    }
}

impl NdtLocalizer {
    fn correct(&mut self, state: &mut State, cloud: &PointCloud) -> Result<UpdateOutcome, LocalizationError> {
        let observed = (cloud.sensor(), cloud.stamp());
        if state.applied.contains(&observed) {
            return Ok(UpdateOutcome::Skipped(SkipReason::Duplicate));
        }
        if let Err(reason) = self.take(state, cloud) {
            return Ok(UpdateOutcome::Skipped(reason));
        }
        let outcome = match self.match_cloud(state)? {
            Match::Unexplained => UpdateOutcome::Skipped(SkipReason::Unexplained),
            Match::Fused { nis, .. } if nis > self.params.gate => {
                UpdateOutcome::Skipped(SkipReason::Gated { nis, limit: self.params.gate })
            }
            Match::Fused { pose, nis, share } => {
                state.belief.pose = pose;
                let mut report = UpdateReport::explaining(share);
                report.nis = Some(nis);
                UpdateOutcome::Applied(report)
            }
            Match::Found { pose, share } => {
                state.belief.pose = pose;
                state.anywhere = false;
                self.monitor.initialized(&pose);
                UpdateOutcome::Applied(UpdateReport::explaining(share))
            }
        };
        if let UpdateOutcome::Applied(_) = outcome {
            state.applied.retain(|(sensor, _)| *sensor != observed.0);
            state.applied.push(observed);
            state.belief.stamp.get_or_insert(observed.1);
            state.misses = 0;
        } else {
            state.misses = state.misses.saturating_add(1);
        }
        self.monitor.updated(&state.belief.pose, &outcome);
        Ok(outcome)
    }
}

impl State {
    /// Adds the end of a motion to the track, and forgets what is older than `history` seconds.
    fn remember(&mut self, odometry: &MotionIncrement<Se3>, history: f64) {
        let last = self.track.last().copied();
        let (newest, odom_from_start) = last.unwrap_or((odometry.start, Se3::identity()));
        if odometry.end < odometry.start.max(newest) {
            // The clock stepped back: what was before lies in no order with it.
            self.track.clear();
            self.track.push((odometry.end, Se3::identity()));
            return;
        }
        if last.is_none() || odometry.start > newest {
            // The first motion, or one after a gap in which nothing is known to have moved.
            self.track.push((odometry.start, odom_from_start));
        }
        let odom_from_end = odom_from_start.compose(&odometry.start_from_end);
        match self.track.last_mut() {
            // No time has passed, but the vehicle has moved.
            Some((stamp, pose)) if *stamp == odometry.end => *pose = odom_from_end,
            _ => self.track.push((odometry.end, odom_from_end)),
        }
        let old = self.track.partition_point(|(stamp, _)| odometry.end - *stamp > history);
        // One before the history stays, so that all of it lies between two poses.
        self.track.drain(..old.saturating_sub(1));
    }
}

/// The belief that a vehicle is at any of the places, heading anywhere.
fn spread_over(places: &[Se3]) -> Result<UncertainPose<Se3>, LocalizationError> {
    check::at_least("places", places.len(), 1)?;
    let n = places.len() as f64;
    let mean = places.iter().map(Se3::translation).sum::<nalgebra::Vector3<f64>>() / n;
    let variance = places.iter().map(|p| (p.translation() - mean).norm_squared()).sum::<f64>() / n;
    let heading = std::f64::consts::PI.powi(2) / 3.0;
    let spread = Vector6::new(variance.max(1.0), variance.max(1.0), 0.01, 0.01, 0.01, heading);
    let pose = Se3::from_parts(mean, agv_core::geometry::So3::identity());
    Ok(UncertainPose::new(pose, Matrix6::from_diagonal(&spread))?)
}

#[cfg(test)]
mod tests;
